"""The picture of the set-up is drawn by rays that a thin lens's own geometry gives."""

from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from lf_flame import PAPER_CAMERA
from lf_flame.commands.camera_figure import trace_to_array, trace_to_sensor
from lf_flame.commands.camera_table import camera_report
from lf_flame.commands.cli import commands


@pytest.mark.parametrize(("depth", "height"), [(20.0, -38.0), (0.0, 7.0), (-10.0, 7.0)])
def test_rays_run_towards_the_point_s_image(depth, height):
    """From the lens to the image at 1/f - 1/distance, and on to a lenslet's focal plane."""
    distance = 326.0 + depth
    image = 1 / (1 / 150.0 - 1 / distance)
    array = 150.0 * 326.0 / 176.0
    z, y = trace_to_array(PAPER_CAMERA, depth, height)
    np.testing.assert_allclose(z, [-distance, 0.0, array])
    np.testing.assert_allclose(y, [0.0, height, height * (1 - array / image)], atol=1e-9)
    z, y = trace_to_sensor(PAPER_CAMERA, depth, height)
    centre = 0.112 * round(y[1] / 0.112)
    assert y[1] == pytest.approx(height * (1 - array / image), abs=1e-9)
    assert y[2] == pytest.approx(centre - 0.4 * height / image, abs=1e-9)
    assert (z[0], z[2]) == (-0.4, 0.4)


@pytest.mark.slow
def test_the_command_writes_the_picture(tmp_path, drawn):
    result = CliRunner().invoke(commands, ["camera", "--figure", str(tmp_path / "camera.png")])
    assert result.exit_code == 0
    assert (tmp_path / "camera.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, ""),
        ({"f_number": 150 / 77.0}, ""),
        # 277.84 mm * 0.112 / 0.4 = 77.80 mm match the lenslets: f/1.93.
        ({"f_number": 1.6}, "wider than the 77.80 mm that match the lenslets"),
        ({"f_number": 1.6}, "From f/1.93 on"),
        ({"f_number": 8}, "lights 3.6 of the 15 pixels"),
    ],
)
def test_what_is_unlikely_in_a_camera_is_said(changes, words):
    said = camera_report(replace(PAPER_CAMERA, **changes), [0.0])
    assert words in said
    assert ("note:" in said) == bool(words)
