"""What a user's own type checker sees of the public names."""

import importlib.util
import os
import re
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
    PAPER_CAMERA,
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
card = Layer(
    texture=np.zeros((2, 2)), depth_mm=-5.0, size_mm=np.array([0.2, 0.2]), centre_mm=[0.0, 0.1],
    opaque=True, coverage=[[1, 0], [1, 1]],
)
scene = Scene([replace(flame, depth_mm=12.0, size_mm=(0.6, 0.6)), card])
layer_size = card.size_mm
optical_thickness = flame.optical_thickness
image_distance = PAPER_CAMERA.image_distance_mm
slope = camera.depth_to_slope(10.0)
slopes = camera.depth_to_slope(np.arange(3.0))
size = camera.field_mm(10.0)
plan = plan_effects(scene, camera)
light_field = render(scene, camera)
cut: LightField = LightField.from_raw(light_field.to_raw(), views=camera.views)
try:
    refocused = shift_and_sum(light_field, slope)
except InputError as error:
    print(error)
"""

REVEALED = {
    "image_distance": "float",
    "slope": "float",
    "slopes": r"numpy\.ndarray\[.*\]",
    "size": "tuple[float, float]",
    "layer_size": "tuple[float, float]",
    "optical_thickness": r"numpy\.ndarray\[.*\]",
    "plan": "lf_flame.simulation.planning.plan.EffectPlan",
    "light_field": "lf_flame.lightfield.LightField",
    "light_field.views": r"numpy\.ndarray\[.*\]",
    "refocused": r"numpy\.ndarray\[.*\]",
}
"""Types of what `RIGHT` has made."""

WRONG = {
    "lf_flame.PlenopticCamera(views='fifteen', lenslets=(8, 8))": "views",
    "lf_flame.PlenopticCamera(views=15, lenslets=8)": "lenslets",
    "lf_flame.PAPER_CAMERA.depth_to_slope('10 mm')": "depth_to_slope",
    "lf_flame.Scene([1.0])": "Layer",
    "lf_flame.Layer([[1.0]], '10 mm', (1.0, 1.0))": 'Argument 2 to "Layer"',
    "lf_flame.Layer([[1.0]], 10.0, (1.0, 1.0), optical_thickness=None)": "optical_thickness",
    "lf_flame.render([], lf_flame.PAPER_CAMERA)": "render",
    "lf_flame.read_light_field(15)": "read_light_field",
    "lf_flame.refocus.shift_and_sum(None, 0.0)": "shift_and_sum",
    "lf_flame.fourier_refocus": "fourier_refocus",
}
"""What must be reported, and a word of the report."""


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """Lines that mypy reports of right.py, revealed.py and wrong.py."""
    if importlib.util.find_spec("mypy") is None:
        pytest.skip("mypy is not installed")
    folder = tmp_path_factory.mktemp("types")
    (folder / "right.py").write_text(RIGHT)
    reveals = "".join(f"reveal_type(right.{name})\n" for name in REVEALED)
    (folder / "revealed.py").write_text(f"import right\n{reveals}")
    (folder / "wrong.py").write_text("\n".join(["import lf_flame", *WRONG]))
    # Of the package itself nothing is to be reported here: an installed one is not checked either.
    options = ["--strict", "--ignore-missing-imports", "--follow-imports=silent"]
    form = ["--no-pretty", "--no-color-output", "--no-error-summary", "--hide-error-context"]
    options += ["--config-file=", f"--cache-dir={ROOT / '.mypy_cache' / 'strict'}"]
    done = subprocess.run(
        [sys.executable, "-m", "mypy", *options, *form, "right.py", "revealed.py", "wrong.py"],
        cwd=folder,
        env=os.environ | {"MYPYPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode in (0, 1), done.stdout + done.stderr
    return done.stdout.splitlines()


def test_right_calls_pass_a_strict_check_and_each_wrong_one_is_reported(report):
    errors = [line for line in report if "error:" in line]
    assert not [line for line in errors if not line.startswith("wrong.py")]
    for number, (call, word) in enumerate(WRONG.items(), 2):
        said = [line for line in errors if line.startswith(f"wrong.py:{number}:")]
        assert any(word in line for line in said), call


def test_types_are_those_that_the_documentation_states(report):
    found = [re.sub(r"builtins\.|\.\.\.", "", line) for line in report if "Revealed" in line]
    found = [re.search('Revealed type is "(.*)"', line)[1].lower() for line in found]
    assert len(found) == len(REVEALED), report
    for (name, wanted), seen in zip(REVEALED.items(), found, strict=True):
        pattern = wanted if "ndarray" in wanted else re.escape(wanted)
        assert re.fullmatch(pattern.lower(), seen), f"{name} is {seen}"
