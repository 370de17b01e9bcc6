"""lf-flame camera: its numbers and its depth resolution."""

import re
from dataclasses import replace

import pytest
from builders import camera_toml
from programs import run

from lf_flame import PAPER_CAMERA
from lf_flame.optics.camera_report import camera_report


def test_the_papers_camera_is_the_default():
    said = run("camera", "--period", 1, "--period", 10, "--depth-mm", 10).output
    assert said.startswith("The paper's camera;")
    assert re.search(r"^10 +\+1\.17\d ", said, re.MULTILINE)
    # 1 mm / 0.239 rad, and 1 + 30 mm / 4.18 mm
    assert re.search(r"^1 +4\.18 +8\.2$", said, re.MULTILINE)
    assert re.search(r"^10 +41\.8 +1\.7$", said, re.MULTILINE)
    assert "0.2390 rad (13.6 degrees)" in said  # 2 atan(0.239 / 2)


def test_the_extent_in_depth_fits_a_near_camera(tmp_path):
    """A tenth of 40 mm, where the default of 30 mm would be nearly at the lens."""
    text = camera_toml(5, (48, 60)).replace("= 150.0", "= 18.0").replace("= 326.0", "= 40.0")
    (tmp_path / "camera.toml").write_text(text)
    assert "values in 4 mm of depth" in run("camera", tmp_path / "camera.toml").output


def test_periods_from_two_pixels_on_are_listed(tmp_path):
    """In the focal plane; finer detail that is asked for is refused."""
    text = (
        camera_toml(5, (48, 60)).replace("0.112", "0.5").replace("focal_mm = 0.4", "focal_mm = 2.0")
    )
    (tmp_path / "camera.toml").write_text(text)
    finest = 2 * 0.5 * 326 * (1 / 150 - 1 / 326)
    said = run("camera", tmp_path / "camera.toml").output
    table = said.partition("lateral period")[2]
    listed = re.findall(r"^([\d.]+) +[\d.]+ +[\d.]+$", table, re.MULTILINE)
    assert [float(x) for x in listed] == [float(f"{finest:.3g}"), 2, 5, 10]
    refused = run("camera", tmp_path / "camera.toml", "--period", 0.5)
    assert "--period must be at least 1.17 mm" in str(refused.exception)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, ""),
        ({"f_number": 150 / 77.0}, ""),
        # 277.84 mm * 0.112 / 0.4 = 77.80 mm match the lenslets: f/1.93.
        ({"f_number": 1.6}, "wider than the 77.80 mm that match the lenslets"),
        ({"f_number": 1.6}, "At f/1.93 or more"),
        ({"f_number": 8}, "lights 3.6 of the 15 pixels"),
    ],
)
def test_what_is_unlikely_in_a_camera_is_said(changes, words):
    said = camera_report(replace(PAPER_CAMERA, **changes), [0.0])
    assert words in said
    assert ("note:" in said) == bool(words)
