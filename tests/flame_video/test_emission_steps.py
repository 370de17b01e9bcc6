"""Temperature of soot in a video in colour, against Planck's law written out here."""

import numpy as np
import pytest
import zarr
from click.testing import CliRunner

from lf_flame.calibration import read_lens
from lf_flame.commands.cli import commands
from lf_flame.tomography import ColourCalibration, SpectralResponses

ROWS, COLUMNS, NOISE = 24, 20, 0.002
CAMERA = f"""
[camera]
main_lens_focal_mm = 150.0
focus_distance_mm = 326.0
lenslet_focal_mm = 0.4
lenslet_pitch_mm = 0.112
views = 3
lenslets = [{ROWS}, {COLUMNS}]
"""
NM, GAINS = np.array([550.0, 650.0]), np.array([3.0, 2.0])
COLOURS = ColourCalibration(
    SpectralResponses.single(NM, ("green", "red")), GAINS, np.zeros(2), (1200.0, 2000.0)
)
PLANES = ((1, 12, 6, 1700.0), (0, 11, 13, 1900.0))
"""Slope, row and column of each glow, and its temperature in K."""


def glow(slope, row, column, kelvin):
    """Views of a smooth glow of soot, signal 1 at 650 nm and 1,800 K before the gains."""
    v, u, t, s = np.ogrid[-1:2, -1:2, :ROWS, :COLUMNS]
    shape = np.exp(-((t - slope * v - row) ** 2 + (s - slope * u - column) ** 2) / 8)
    planck = NM**-6 / np.expm1(14.387768775e6 / (NM * kelvin))
    return shape[..., None] * GAINS * planck / (650.0**-6 / np.expm1(14.387768775e6 / 1.17e6))


@pytest.fixture
def folder(tmp_path):
    """Camera, calibration, and three frames: the second is dark."""
    rng = np.random.default_rng(1)
    light = sum(glow(*plane) for plane in PLANES)
    (tmp_path / "video").mkdir()
    for number in range(3):
        views = light * (number != 1) + NOISE * rng.standard_normal(light.shape)
        np.save(tmp_path / "video" / f"{number}.npy", views.astype(np.float32))
    (tmp_path / "camera.toml").write_text(CAMERA)
    (tmp_path / "colours.toml").write_text(COLOURS.to_toml())
    return tmp_path


def run(*words):
    return CliRunner().invoke(commands, [str(word) for word in words])


@pytest.mark.slow
def test_temperatures_of_two_planes_come_back_and_faint_cells_have_none(folder):
    out, camera = folder / "out.zarr", read_lens(folder / "camera.toml")
    depths = [float(camera.slope_to_depth(slope)) for slope, *_ in PLANES]
    where = [word for depth in depths for word in ("--depth-mm", depth)]
    files = ["--camera", folder / "camera.toml", "--colours", folder / "colours.toml"]
    words = [*files, *where, "--noise", NOISE, "--workers", 1, "--out", out]
    steps = ["--steps", "emission,temperature"]
    done = run("process", folder / "video", *steps, *words)
    assert done.exit_code == 0, done.output
    assert "single wavelength" in done.output
    found = zarr.open_group(out, mode="r")
    kelvin, sigma = found["temperature"], found["temperature_sigma"]
    assert kelvin.metadata.dimension_names == ("time", "depth", "y", "x")
    assert kelvin.attrs["units"] == "K"
    emission = found["emission"]
    assert emission.metadata.dimension_names == ("time", "colour", "depth", "y", "x")
    assert emission.attrs["colours"] == ["green", "red"]
    assert found["emission_noise"].shape == (3, 2)
    for number in (0, 2):
        for plane, (_, row, column, truth) in enumerate(PLANES):
            box = (number, plane, slice(row - 1, row + 2), slice(column - 1, column + 2))
            # 1 % of the ratio of two colours would be 7 K at 1,700 K.
            assert np.mean(kelvin[box]) == pytest.approx(truth, abs=2)
            apart = (kelvin[box] - truth) / sigma[box]
            assert 0.3 < np.sqrt(np.mean(apart**2)) < 2
            assert np.isnan(kelvin[number, plane, :3]).mean() > 0.9
    assert np.isnan(kelvin[1]).all()
    assert "3 frames: 3 whole" in done.output
    gains = ColourCalibration(COLOURS.responses, GAINS * 1.001, np.zeros(2), (1200.0, 2000.0))
    (folder / "colours.toml").write_text(gains.to_toml())
    other = run("process", folder / "video", *steps, *words)
    assert "was made with other steps" in str(other.exception)


def test_a_calibration_goes_with_emission_and_channels(folder):
    words = ["--camera", folder / "camera.toml", "--colours", folder / "colours.toml"]
    words += ["--workers", 1, "--out", folder / "out.zarr"]
    done = run("process", folder / "video", "--steps", "height", *words)
    assert "--colours goes with the step emission" in str(done.exception)
    np.save(folder / "grey.npy", np.ones((3, 3, ROWS, COLUMNS), np.float32))
    steps = ["--steps", "emission", "--depth-mm", 0]
    done = run("process", folder / "grey.npy", *steps, *words[:-1], folder / "a" / "out.zarr")
    assert "must have a channel for each of the calibration's 2 colours" in str(done.exception)
