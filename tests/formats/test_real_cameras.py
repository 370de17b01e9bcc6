"""Other people's raw files, and siblings of each that are made here, pixel by pixel.

The real files lie beside the checkout, in shared/lightfields; without them their tests skip.
"""

import math
import re
from pathlib import Path

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner
from micro_images import Sensor, nearest_lenslet
from scipy.io import loadmat

from lf_flame import InputError, LightField
from lf_flame.commands.cli import commands
from lf_flame.formats import DecodePlan, decode_raw, estimate_grid, read_raw
from lf_flame.formats.images import read_image
from lf_flame.refocus import find_sharpest_slope

FILES = next(
    (p / "shared/lightfields" for p in Path(__file__).parents if (p / "shared").is_dir()), Path()
)


def real(name):
    return pytest.mark.skipif(
        not (FILES / name).is_dir(), reason=f"no real raw image {name} beside the checkout"
    )


SPOTS, RAW = (FILES / "opticstudio_hexagonal" / f"{n}.tif" for n in ("closed_aperture", "raw"))


def slope_of(light_field, counted=True, farthest=0.6):
    views = light_field.views if light_field.views.ndim == 4 else light_field.views[..., 1]
    weights = np.ones(views.shape[:2]) if light_field.weights is None else light_field.weights
    found = LightField(views, weights=weights * counted, valid=light_field.valid)
    return find_sharpest_slope(
        found, np.linspace(-farthest, farthest, round(80 * farthest) + 1)
    ).slope


@pytest.mark.slow
@pytest.mark.parametrize(
    ("breadth", "borders", "options"),
    [
        (1.0, 0, {}),
        (2.2, 5, {"columns": True}),
        (3.0, 4, {"hexagonal": False, "rotation": 0.006}),
        (5.0, 0, {"columns": True, "rotation": -0.004}),
    ],
)
def test_lenslets_are_found_by_spots_and_a_plane_has_its_slope(breadth, borders, options, tmp_path):
    sensor = Sensor((300, 320), 10.42, **options)
    for name, image in (("raw", sensor.plane(-0.09)), ("spots", sensor.spots(breadth, borders))):
        tifffile.imwrite(tmp_path / f"{name}.tif", np.rint(6e4 * image).astype(np.uint16))
    light_field, grid = read_raw(tmp_path / "raw.tif", lenslets=tmp_path / "spots.tif")
    assert grid.layout == ("hexagonal" if sensor.hexagonal else "rectangular")
    assert grid.columns == sensor.columns
    pitch, rotation, away = sensor.error(grid)
    assert (pitch < 5e-4, rotation < 5e-4, away < 0.1) == (True, True, True)
    if sensor.hexagonal:  # without a white image a square array counts the corners, too
        assert light_field.weights.sum() == 49
        assert slope_of(light_field, farthest=0.3) == pytest.approx(
            sensor.slope(-0.09, 9), rel=0.01
        )
    with pytest.raises(InputError, match="closed aperture .*--lenslets|does not fit the raw image"):
        read_raw(tmp_path / "raw.tif", tmp_path / "spots.tif")


def test_an_array_in_columns_is_decoded_upright():
    """The views of a scene that is brighter below, and of its transposed raw image."""
    sensor = Sensor((260, 300), 10.3)
    raw = sensor.pixels((1 + 0.02 * sensor.row - 0.1 * 0.02 * sensor.down) * sensor.lit(0))
    rows, columns = (
        decode_raw(image, estimate_grid(white), white=white)
        for image, white in (
            (raw, sensor.pixels(sensor.lit(0))),
            (raw.T, sensor.pixels(sensor.lit(0)).T),
        )
    )
    np.testing.assert_allclose(columns.views, rows.views.transpose(1, 0, 3, 2), atol=2e-3)
    middle = columns.views[4, 4]
    assert (middle[:, -3] > middle[:, 2] + 0.1).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pitch", "rotation", "slope", "pattern"),
    [(9.93, -0.0049, 0.12, "bggr"), (9.71, 0.003, -0.2, "grbg"), (10.21, 0.001, 0.07, "rggb")],
)
def test_a_mosaic_of_touching_micro_images_is_decoded_without_a_white_image(
    pitch, rotation, slope, pattern
):
    """Siblings of the Lytro F01's frames: slopes of inner and of outer views agree."""
    sensor = Sensor((440, 480), pitch, rotation)
    levels = np.array([{"r": 0.6, "g": 1.0, "b": 0.5}[colour] for colour in pattern])
    y, x = np.indices(sensor.shape)
    raw = sensor.plane(slope) * levels[2 * (y % 2) + x % 2]
    raw += np.random.default_rng(3).normal(0, 0.003, raw.shape)
    grid = estimate_grid(raw)
    assert (np.array(sensor.error(grid)) < (2e-4, 2e-4, 0.1)).all()
    found = decode_raw(raw, grid, bayer=pattern)
    assert found.weights.sum() == 49
    radius = np.hypot(*(np.indices((9, 9)) - 4))
    inner, outer = (slope_of(found, some, 0.35) for some in (radius < 2.5, radius > 2.5))
    assert inner == pytest.approx(sensor.slope(slope, 9), rel=0.02)
    assert outer == pytest.approx(inner, rel=0.02)


@pytest.mark.parametrize("columns", [False, True])
def test_few_large_lenslets_stand_as_they_do(columns):
    """Four by four of them: their rows are straight, or their columns."""
    sensor = Sensor((190, 200), 45.0, columns=columns, sub=2)
    grid = estimate_grid(sensor.pixels(sensor.lit()))
    assert (grid.layout, grid.columns) == ("hexagonal", columns)
    assert abs(grid.rotation) < 0.01
    assert grid.pitch == pytest.approx(45, rel=0.01)


@pytest.mark.slow
@real("lytro_f01_raw")
@pytest.mark.parametrize("number", [1, 2, 4])
def test_a_lytro_f01_is_decoded_by_its_own_frames(number):
    image = read_image(FILES / "lytro_f01_raw" / f"IMG_{number}.jpg")
    grid = estimate_grid(image)
    # The authors' centres, counted from 1, and rounded; every other row begins half a pitch later.
    centres = loadmat(FILES / "lytro_f01_raw" / "image_cords.mat")["image_cords"].astype(float) - 1
    row, column = np.indices(centres.shape[:2])
    design = np.stack([np.ones(row.size), (column + row % 2 / 2).ravel(), row.ravel()], axis=1)
    (y0, x0), (rise, pitch), (step, _) = np.linalg.lstsq(design, centres.reshape(-1, 2))[0]
    assert grid.pitch == pytest.approx(math.hypot(rise, pitch), rel=1e-4)
    assert grid.row_pitch == pytest.approx(step, rel=1.1e-4)
    assert grid.rotation == pytest.approx(math.atan2(rise, pitch), abs=2e-4)
    middle = centres[181, 155]
    z = (middle[1] - grid.x0 + 1j * (middle[0] - grid.y0)) * np.exp(-1j * grid.rotation)
    fitted = design[181 * 311 + 155] @ np.array([[y0, x0], [rise, pitch], [step, _]])
    z += (fitted[1] - middle[1] + 1j * (fitted[0] - middle[0])) * np.exp(-1j * grid.rotation)
    *_, down, along = nearest_lenslet(
        np.array([z.imag]), np.array([z.real]), grid.pitch, grid.row_pitch, hexagonal=True
    )
    assert np.hypot(down, along)[0] < 0.1
    with pytest.raises(InputError, match="raw image is a colour mosaic.*--bayer rggb or bggr"):
        decode_raw(image, grid)
    found = DecodePlan(grid, shape=image.shape, bayer="bggr").decode(image)
    assert found.views.shape == (9, 9, 379, 376, 3)
    assert found.weights.sum() >= 49


@pytest.mark.slow
@real("opticstudio_hexagonal")
def test_a_ray_tracers_raw_image_and_its_calibration():
    """Columns 10.42 pixels apart; two things at depths of their own, and no light beyond them."""
    light_field, grid = read_raw(RAW, lenslets=SPOTS)
    assert grid.describe().startswith("hexagonal lenslets in straight columns, pitch 10.41")
    assert grid.row_pitch == pytest.approx(9.02, abs=0.01)
    assert light_field.weights.sum() == 49
    left, right = (
        slope_of(
            LightField(light_field.views[:, :, :, side], weights=light_field.weights), farthest=2.0
        )
        for side in (np.s_[:28], np.s_[28:])
    )
    assert abs(left - right) > 0.1
    with pytest.raises(InputError, match="lights 1 of 81 views: .* closed aperture"):
        read_raw(RAW, SPOTS)


@pytest.mark.slow
@pytest.mark.parametrize("file", [pytest.param(RAW, marks=real("opticstudio_hexagonal")), None])
def test_info_takes_the_images_that_show_the_lenslets(file, tmp_path):
    spots = SPOTS
    if file is None:
        sensor = Sensor((300, 320), 11.2, columns=True)
        file, spots = tmp_path / "raw.tif", tmp_path / "spots.tif"
        tifffile.imwrite(file, sensor.plane(0.05).astype(np.float32))
        tifffile.imwrite(spots, sensor.spots(2.0).astype(np.float32))

    def told(*words):
        return CliRunner().invoke(commands, ["info", *map(str, words)], catch_exceptions=False)

    said = told(file, "--lenslets", spots).stdout
    assert "in straight columns" in said
    assert re.search(r"views +(9 x 9|11 x 11), of", said)
    assert f"next: lf-flame refocus {file} --lenslets {spots}" in said
    said = told(spots).stdout
    assert f"If this is such a picture, type: lf-flame refocus RAW.tif --lenslets {spots}" in said


def test_info_proposes_what_divides_the_sides_of_a_picture(tmp_path):
    """A rectified picture, 15 x 15 pixels to a lenslet, whose contents repeat every 14 or so."""
    y, x = np.indices((300, 450))
    down, along = np.fft.fftfreq(300)[:, None], np.fft.fftfreq(450)
    noise = np.fft.fft2(np.random.default_rng(1).normal(size=y.shape))
    waves = [np.exp(-(((np.abs(k) - 1 / 14.1) / 0.004) ** 2)) for k in (down, along)]
    band = waves[0] * (np.abs(along) < 0.02) + waves[1] * (np.abs(down) < 0.02)
    view = np.fft.ifft2(noise * band)
    fall = 1 - 0.2 * ((y % 15 - 7) ** 2 + (x % 15 - 7) ** 2) / 98
    picture = (1 + 0.2 * view.real / view.real.std()) * fall
    picture += np.random.default_rng(2).normal(0, 0.05, y.shape)
    tifffile.imwrite(tmp_path / "picture.tif", picture.clip(0).astype(np.float32))
    files = [tmp_path / "picture.tif", FILES / "microscope_worm" / "worm.tif"]
    for file in files[: 1 + files[1].exists()]:
        said = CliRunner().invoke(commands, ["info", str(file)]).stdout
        assert "14." not in said.replace(str(file), "")
        assert re.search(r"as in the camera's data sheet, which divides its .*\b15\b", said)
