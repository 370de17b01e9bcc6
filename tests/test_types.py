"""What a user's own type checker sees of the public names."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

pytestmark = pytest.mark.slow

RIGHT = """
from dataclasses import replace
from pathlib import Path

import numpy as np

from lf_flame import (
    InputError,
    Layer,
    LightField,
    PlenopticCamera,
    Scene,
    Sensor,
    plan_effects,
    read_light_field,
    render,
)
from lf_flame.refocus import find_sharpest_slope, shift_and_sum


def refocus(path: Path) -> np.ndarray:
    light_field = read_light_field(path, views=15)
    return shift_and_sum(light_field, [0.0, find_sharpest_slope(light_field).slope])


camera = PlenopticCamera(
    main_lens_focal_mm=150.0,
    focus_distance_mm=326.0,
    lenslet_focal_mm=0.4,
    lenslet_pitch_mm=0.112,
    views=5,
    lenslets=(24, 30),
    sensor=Sensor(exposure_e=1000.0),
)
flame = Layer(texture=[[0.0, 1.0]], depth_mm=10.0, size_mm=(0.5, 0.5), optical_thickness=0.1)
scene = Scene([replace(flame, depth_mm=12.0, size_mm=(0.6, 0.6))])
thickness: np.ndarray = flame.optical_thickness
slope: float = camera.depth_to_slope(10.0)
slopes: np.ndarray = camera.depth_to_slope(np.arange(3.0))
size: tuple[float, float] = camera.field_mm(10.0)
plan = plan_effects(scene, camera)
light_field: LightField = render(scene, camera)
cut: LightField = LightField.from_raw(light_field.to_raw(), views=camera.views)
try:
    refocused: np.ndarray = shift_and_sum(light_field, slope)
except InputError as error:
    print(error)
"""

WRONG = {
    "lf_flame.PlenopticCamera(views='fifteen', lenslets=(8, 8))": "views",
    "lf_flame.PAPER_CAMERA.depth_to_slope('10 mm')": "depth_to_slope",
    "lf_flame.Scene([1.0])": "Layer",
    "lf_flame.render([], lf_flame.PAPER_CAMERA)": "render",
    "lf_flame.fourier_refocus": "fourier_refocus",
}
"""Calls that must be reported, and a word of the report."""

# Errors in the package itself are not reported, as where it is installed. No public name has a type
# of another package than NumPy, and reading the others takes three times as long.
SETTINGS = """
[mypy]
follow_imports = skip
[mypy-lf_flame.*,numpy.*]
follow_imports = silent
"""


def test_right_calls_pass_a_strict_check_and_each_wrong_one_is_reported(tmp_path):
    pytest.importorskip("mypy")
    (tmp_path / "right.py").write_text(RIGHT)
    (tmp_path / "wrong.py").write_text("\n".join(["import lf_flame", *WRONG]))
    (tmp_path / "mypy.ini").write_text(SETTINGS)
    options = ["--strict", "--ignore-missing-imports", "--config-file=mypy.ini", "--no-pretty",
               "--no-color-output", "--no-error-summary",
               f"--cache-dir={ROOT / '.mypy_cache' / 'strict'}"]  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-m", "mypy", *options, "right.py", "wrong.py"],
        cwd=tmp_path,
        env=os.environ | {"MYPYPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    errors = [line for line in done.stdout.splitlines() if "error:" in line]
    assert not [line for line in errors if not line.startswith("wrong.py")], done.stdout
    for number, (call, word) in enumerate(WRONG.items(), 2):
        said = [line for line in errors if line.startswith(f"wrong.py:{number}:")]
        assert any(word in line for line in said), call
