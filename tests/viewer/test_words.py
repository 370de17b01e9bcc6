"""The copied command, as the page's own script makes it."""

import json
import shlex
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import lf_flame.viewer
from lf_flame import LightField
from lf_flame.calibration import CameraLaw
from lf_flame.viewer.exhibit import Exhibit

WORDS = Path(lf_flame.viewer.__file__).parent / "static" / "words.js"
STATE = {"slope": 0.5, "shape": "square", "width": 1, "ring": 0, "centre": [0, 0], "gain": 1,
         "gamma": 1}  # fmt: skip


@pytest.mark.parametrize(
    ("source", "named"),
    [("-x", "./-x"), ("--out", "./--out"), ("a b's.npy", "a b's.npy"), ("/a/-x", "/a/-x")],
)
def test_a_copied_command_takes_no_name_for_an_option(tmp_path, source, named):
    if not (node := shutil.which("node")):
        pytest.skip("there is no node")
    shutil.copy(WORDS, tmp_path / "words.mjs")
    metadata = json.dumps({"source": source, "reading": {"white": "-w"}, "making": {}})
    (tmp_path / "call.mjs").write_text(
        'import { command } from "./words.mjs";\n'
        f"console.log(command({metadata}, {json.dumps(STATE)}));\n"
    )
    said = subprocess.run([node, tmp_path / "call.mjs"], capture_output=True, text=True, check=True)
    words = shlex.split(said.stdout)
    assert words == ["lf-flame", "refocus", named, "--white=-w", "--slope", "0.5"]


@pytest.mark.parametrize(
    ("slope", "depth"),
    [(2 - 800 / 410, 10.0), (2 - 800 / 360, -40.0), (2 - 800 / 500, None), (2.5, None)],
)
def test_depths_of_a_calibration_are_from_its_own_zero_and_within_its_range(tmp_path, slope, depth):
    """A lens 400 mm before the zero; JSON writes NaN as null."""
    if not (node := shutil.which("node")):
        pytest.skip("there is no node")
    law = CameraLaw(
        slope_at_infinity=2.0, slope_mm=-800.0, slope_centre_mm=-400.0, scale=0.002,
        scale_centre_mm=-400.0, depth_range_mm=(-50.0, 50.0), views=3, lenslets=(8, 8),
    )  # fmt: skip
    exhibit = Exhibit(LightField(np.ones((3, 3, 8, 8))), "flat", (-1.0, 1.0), 0.0, law)
    camera = json.dumps(exhibit.describe_served()["camera"])
    shutil.copy(WORDS, tmp_path / "words.mjs")
    (tmp_path / "call.mjs").write_text(
        'import { depthOf } from "./words.mjs";\n'
        f"console.log(JSON.stringify(depthOf({camera}, {slope})));\n"
    )
    said = subprocess.run([node, tmp_path / "call.mjs"], capture_output=True, text=True, check=True)
    assert json.loads(said.stdout) == (None if depth is None else pytest.approx(depth, abs=1e-6))
