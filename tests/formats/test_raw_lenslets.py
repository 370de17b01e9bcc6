"""Raw lenslet images: grids found to a small part of a pixel, light and slopes kept."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from micro_images import nearest_lenslet
from scipy import ndimage

from lf_flame import InputError, LightField
from lf_flame.formats import read_light_field, read_raw
from lf_flame.formats.images import write_image
from lf_flame.formats.raw.lenslet_grid import LensletGrid, grid_from_pitch
from lf_flame.formats.raw.lenslet_search import estimate_grid
from lf_flame.formats.raw.reading import decode_raw
from lf_flame.refocus import all_in_focus, find_sharpest_slope, shift_and_sum
from lf_flame.refocus.focus_map import TRUSTED

MICROSCOPE = Path(__file__).parents[3] / "shared" / "lightfields" / "guv"


def lenslets_of(grid, shape):
    """For each pixel: row, place along the row and offset (down, along) from its lenslet."""
    y, x = np.indices(shape)
    z = (x - grid.x0 + 1j * (y - grid.y0)) * np.exp(-1j * grid.rotation)
    return nearest_lenslet(z.imag, z.real, grid.pitch, grid.row_pitch, grid.layout == "hexagonal")


def white_image(grid, shape, rng, radius=0.45, gap=0.05, noise=0.0, falloff=0.0, dead=0.0):
    """Round micro-images, darker towards the corners of the sensor, some of them dead."""
    row, place, down, along = lenslets_of(grid, shape)
    image = gap + (1 - gap) * np.clip(radius * grid.pitch - np.hypot(down, along) + 0.5, 0, 1)
    is_dead = rng.uniform(size=(500, 500)) < dead
    image[is_dead[row.astype(int) % 500, np.floor(place).astype(int) % 500]] = 0.02
    y, x = (np.linspace(-1, 1, n) for n in shape)
    image *= 1 - falloff * (y[:, None] ** 2 + x**2) / 2
    return image + noise * rng.standard_normal(shape)


def farthest(found, true, shape):
    """Largest distance of a found centre from the nearest true one, in pixels."""
    y, x = np.moveaxis(found.centres(shape), -1, 0)
    z = (x - true.x0 + 1j * (y - true.y0)) * np.exp(-1j * true.rotation)
    row = np.round(z.imag / true.row_pitch)
    shifted = (row % 2) / 2 if true.layout == "hexagonal" else 0
    place = np.round(z.real / true.pitch - shifted) + shifted
    return np.abs(z - place * true.pitch - 1j * row * true.row_pitch).max()


SPOILT = {"gap": 0.2, "noise": 0.06, "falloff": 0.6, "dead": 0.02}


@pytest.mark.parametrize(
    ("true", "look", "error"),
    [
        (LensletGrid(71.3, 18.6, 13.7, 0.031, "rectangular"), {"falloff": 0.4}, 0.01),
        (LensletGrid(71.3, 18.6, 13.7, -0.031, "hexagonal"), {"falloff": 0.4}, 0.01),
        (LensletGrid(20, 30, 14.3, 0.02, row_pitch=12.1), {"radius": 0.4}, 0.02),
        (LensletGrid(20, 30, 15.2, 0.02, "hexagonal"), {"radius": 0.2, "noise": 0.02}, 0.02),
        (LensletGrid(20, 30, 15.2, 0.02), {"radius": 0.5, "noise": 0.02}, 0.02),
        *(
            (LensletGrid(53, 8, 11.9, -0.045, layout), SPOILT, 0.05)
            for layout in ("rectangular", "hexagonal")
        ),
    ],
)
def test_grids_are_found_to_a_hundredth_of_a_pixel(true, look, error, rng):
    """In clean images; with rows closer than columns; of small or touching micro-images; spoilt."""
    found = estimate_grid(white_image(true, (401, 503), rng, **look))
    assert found.layout == true.layout
    assert found.row_pitch == pytest.approx(true.row_pitch, abs=0.002)
    assert farthest(found, true, (401, 503)) < error


@pytest.mark.slow
def test_kinds_of_white_images(rng):
    true, shape = LensletGrid(20, 30, 12.2, 0.02, "hexagonal"), (400, 421)
    white = np.clip(white_image(true, shape, rng, falloff=0.3), 0, 1)
    y, x = np.indices(shape)
    mosaic = np.where(y % 2 == x % 2, 1.0, 0.4) * white
    image_circle = np.where(np.hypot(y - 200, x - 210) < 170, white, 0)
    for image in (
        (255 * white).astype(np.uint8),
        np.clip(2 * white, 0, 1),  # saturated
        np.stack([white, 0.5 * white, 0.2 * white], axis=-1),
        1e-6 * white,
        mosaic,
        image_circle,
    ):
        assert farthest(estimate_grid(image), true, shape) < 0.02
    assert farthest(estimate_grid(white, 14, "hexagonal"), true, shape) < 0.02


@pytest.mark.slow
@given(
    pitch=st.floats(3, 20),
    row_pitch=st.floats(3, 20),
    rotation=st.floats(-0.7, 0.7),
    layout=st.sampled_from(["rectangular", "hexagonal"]),
    shape=st.tuples(st.integers(45, 120), st.integers(45, 120)),
)
@settings(max_examples=60, deadline=None)
def test_whole_micro_images_are_a_block_that_cannot_grow(pitch, row_pitch, rotation, layout, shape):
    grid = LensletGrid(17.3, 50.1, pitch, rotation, layout, row_pitch)
    rows, columns = grid.block(shape)

    def are_whole(row, column):
        y, x = grid.position(row, column)
        corners = np.array([(a, b) for a in (-0.5, 0.5) for b in (-0.5, 0.5)]) * grid.window
        return all(
            np.all((y + dy >= -1 - 1e-9) & (y + dy <= shape[0] + 1e-9))
            and np.all((x + dx >= -1 - 1e-9) & (x + dx <= shape[1] + 1e-9))
            for dy, dx in (grid.rotated(*corner) for corner in corners)
        )

    assert are_whole(rows[:, None], columns)
    assert not are_whole(rows[0] - 1, columns)
    assert not are_whole(rows[-1] + 1, columns)
    assert not are_whole(rows, columns[0] - 1)
    assert not are_whole(rows, columns[-1] + 1)
    assert grid.centres(shape).shape == (len(rows), len(columns), 2)


@pytest.mark.parametrize("layout", ["rectangular", "hexagonal"])
def test_a_stated_pitch_fills_the_image_evenly(layout):
    grid = grid_from_pitch((100, 131), 10, layout=layout)
    centres = grid.centres((100, 131))
    assert centres.shape[:2] == ((10, 13) if layout == "rectangular" else (11, 12))
    first, last = centres.min(axis=(0, 1)), centres.max(axis=(0, 1))
    np.testing.assert_allclose(first + last, (99, 130))


@pytest.mark.parametrize(
    ("dtype", "shape"), [(np.uint8, (30, 40)), (np.uint16, (30, 40)), (np.float32, (30, 40, 3))]
)
def test_the_exact_grid_gives_the_views_back(dtype, shape, rng):
    top = 1 if dtype is np.float32 else np.iinfo(dtype).max
    raw = (top * rng.uniform(size=shape)).astype(dtype)
    decoded = decode_raw(raw, grid_from_pitch(shape, 5)).views
    assert decoded.dtype == np.float32
    expected = raw.reshape(6, 5, 8, 5, *shape[2:])  # t, v, s, u
    expected = np.moveaxis(expected, (1, 3), (0, 1))
    np.testing.assert_allclose(decoded, expected, rtol=0, atol=6e-7 * top)


def test_light_is_kept(rng):
    """The parts of a micro-image hold all its light, and none of the neighbours'."""
    raw, grid = rng.uniform(size=(90, 120)), grid_from_pitch((90, 120), 15)
    for views in (14, 15):
        decoded = decode_raw(raw, grid, views).views
        expected = LightField.from_raw(raw, views=15).photograph
        np.testing.assert_allclose(decoded.mean(axis=(0, 1)), expected, rtol=1e-5)


def test_smooth_micro_images_are_averaged_over_parts():
    """Parts of 1.5 pixels in a grid that sits between pixels, against the closed form."""
    y, x = np.indices((90, 120))
    ky, kx = 0.31, 0.23
    pixel = np.sinc(ky / 2 / np.pi) * np.sinc(kx / 2 / np.pi)
    raw = pixel * np.cos(ky * y + kx * x)
    grid = LensletGrid(20.37, 31.81, 10.5)
    centres = grid.centres(raw.shape)
    decoded = decode_raw(raw, grid, views=7).views
    offset = 1.5 * (np.arange(7) - 3)
    phase = ky * (centres[..., 0] + offset[:, None, None, None])
    phase = phase + kx * (centres[..., 1] + offset[None, :, None, None])
    part = np.sinc(1.5 * ky / 2 / np.pi) * np.sinc(1.5 * kx / 2 / np.pi)
    away = np.abs(decoded - part * np.cos(phase))[..., 1:-1, 1:-1]  # off the image's border
    assert away[2:-2, 2:-2].max() < 6e-4
    # At the rim, where light goes on linearly for up to a pixel, it is off by its curvature.
    assert away.max() < ky**2


def test_the_views_asked_for():
    raw = np.ones((100, 100))
    for pitch, views in ((15, 15), (14.9996, 15), (14.3, 13), (16.0004, 15), (9.7, 9)):
        assert decode_raw(raw, LensletGrid(50, 50, pitch)).views.shape[:2] == (views, views)


@pytest.mark.parametrize(("rotation", "bayer"), [(0.004, "gbrg"), (-0.03, None), (0.4, "gbrg")])
def test_a_ramp_is_decoded_at_the_places_of_the_parts(rotation, bayer):
    """Interpolation keeps straight lines, so a pixel of a view is the ramp at its part's centre."""
    grid, shape = LensletGrid(101.3, 87.6, 10.4, rotation), (200, 220)
    y, x = np.indices(shape)
    views = decode_raw(3.0 * x - 5.0 * y, grid, bayer=bayer).views
    middle = (slice(3, -3),) * 2  # off the border, beyond which the image is constant
    centres = grid.centres(shape)[middle]
    part = 10.4 / 9 * (np.arange(9) - 4)
    turn = np.cos(rotation), np.sin(rotation)
    down = turn[0] * part[:, None] + turn[1] * part
    right = turn[0] * part - turn[1] * part[:, None]
    at_y, at_x = np.add.outer(down, centres[..., 0]), np.add.outer(right, centres[..., 1])
    found = views[(..., *middle, slice(None))[: 3 + (bayer is not None)]]
    expected = 3.0 * at_x - 5.0 * at_y
    away = found - (expected if bayer is None else expected[..., None])
    assert np.abs(away).max() < 4e-3  # 1/256 pixel is 0.02


def sampled_scene(grid, shape, slope, views):
    """Raw image of a smooth scene at a slope, in row distances per view, and the scene itself."""

    def scene(t, s):
        return 2 + np.sin(0.55 * t + 0.4) * np.cos(0.45 * s) + 0.5 * np.sin(0.3 * t - 0.5 * s)

    row, place, down, along = lenslets_of(grid, shape)
    view = grid.pitch / views  # pixels from view to view
    t = row - slope * down / view
    s = place * grid.pitch / grid.row_pitch - slope * along / view
    return scene(t, s), scene


@pytest.mark.parametrize("layout", ["rectangular", "hexagonal"])
def test_a_known_slope_is_decoded(layout):
    grid = LensletGrid(161.3, 149.6, 14.3, 0.03, layout)
    shape, views, slope = (301, 333), 13, 0.7
    raw, scene = sampled_scene(grid, shape, slope, views)
    decoded = decode_raw(raw, grid).views
    rows, columns = grid.block(shape)
    v = np.arange(views) - 6
    t = rows[:, None]
    if layout == "rectangular":
        s = columns.astype(float)
    else:
        width = decoded.shape[3]
        s = (columns[0] + 0.5) * grid.pitch / grid.row_pitch + np.arange(width)
        assert s[-1] <= columns[-1] * grid.pitch / grid.row_pitch < s[-1] + 1
    expected = scene(t - slope * v[:, None, None, None], s - slope * v[None, :, None, None])
    # At the rim an interpolation sees the next micro-image, and linear interpolation from lenslet
    # to lenslet is off by h^2 / 8 times the second derivative: 0.055 here.
    middle, inner = slice(2, -2), slice(3, -3)
    error = np.abs(decoded - expected)[inner, inner]
    assert error.max() < (0.01 if layout == "rectangular" else 0.06)
    assert find_sharpest_slope(decoded[middle, middle]).slope == pytest.approx(slope, abs=0.01)


def test_a_white_image_takes_out_falloff(rng):
    """In views whose pixels are lit in it; others get weight 0."""
    grid, shape = LensletGrid(160.2, 140.7, 14.3, 0.02), (290, 320)
    white = 300 * white_image(grid, shape, rng, falloff=0.8, gap=0.02)
    radius = np.hypot(*np.indices((13, 13)) - 6)
    level = np.median(decode_raw(white, grid).views[6, 6])
    with pytest.raises(InputError, match="The white image lights 0 of 1 views"):
        decode_raw(white, grid, 1, white * (white > 0.9 * white.max()))
    found = decode_raw(0.4 * white, grid, white=white)
    lit = found.weights > 0
    assert lit[radius < 4.6].all()
    assert not lit[radius > 6.5].any()
    assert found.valid is not None
    assert 0.9 < found.valid[lit].mean() < 1
    assert not found.views[~found.valid].any()
    np.testing.assert_allclose(found.filled[lit], 0.4 * level, rtol=3e-5)  # rounding of sums
    colour = np.stack([white, 2 * white, 0.5 * white], axis=-1)
    expected = np.broadcast_to(level * np.array([1, 2, 0.5]), (*found.views[lit].shape, 3))
    for flat in (colour, white):
        balanced = decode_raw(colour, grid, white=flat).filled
        np.testing.assert_allclose(balanced[lit], expected, rtol=3e-5)


def test_views_and_lenslets_that_are_dark_in_the_white_image():
    """A pixel is lit from half its micro-image's brightest on; a micro-image from 2.5 % on."""
    white = np.ones((5, 5, 5, 6))
    white[0], white[1, 0], white[1, 2] = 0.3, 0.48, 0.52
    white[:, :, 3, 3] *= 0.02
    raw = LightField(white).to_raw()
    grid = grid_from_pitch(raw.shape, 5)
    found = decode_raw(0.8 * raw, grid, 5, raw)
    expected = np.ones((5, 5))
    expected[0], expected[1, 0] = 0, 0
    np.testing.assert_array_equal(found.weights, expected)
    counts = found.weights > 0
    assert not found.valid[counts][:, 3, 3].any()
    known = np.delete(found.valid[counts].reshape(counts.sum(), -1), 3 * 6 + 3, axis=1)
    assert known.all()
    np.testing.assert_allclose(found.views[counts][:, :3], 0.8, rtol=1e-6)


BAYER = {"red": 0.52, "green": 1.0, "blue": 0.61}
"""Levels of a white wall in daylight behind a common sensor's colour filters."""

ORDERS = [("red", "green", "green", "blue"), ("green", "blue", "red", "green")]


def as_mosaic(image, order=ORDERS[0]):
    """Light of an image behind colour filters, in the order of the pixels of each 2 x 2."""
    y, x = np.indices(image.shape)
    return image * np.choose(2 * (y % 2) + x % 2, [BAYER[name] for name in order])


@pytest.mark.parametrize(
    ("pitch", "layout"), [(9, "rectangular"), (14, "hexagonal"), (14.29, "rectangular")]
)
def test_colour_mosaics_are_refused_and_grey_images_are_not(pitch, layout, rng):
    """Even pitches repeat in 2 x 2 pixels, as a mosaic does."""
    grid = LensletGrid(20.25, 30.5, pitch, 0, layout)
    white = white_image(grid, (200, 240), rng, noise=0.02)
    grey = white * (1 + 0.5 * ndimage.gaussian_filter(rng.standard_normal(white.shape), 1.5))
    decode_raw(grey, grid, white=white)
    for order in ORDERS:
        left = "rggb or bggr" if order[0] != "green" else "grbg or gbrg"
        with pytest.raises(InputError, match=rf"white image is a colour mosaic.*--bayer {left}"):
            decode_raw(as_mosaic(grey, order), grid, white=as_mosaic(white, order))
        with pytest.raises(InputError, match="raw image is a colour mosaic"):
            decode_raw(as_mosaic(grey, order), grid)


def test_mosaics_are_refused_above_a_black_level_and_as_lenslet_images(tmp_path, rng):
    grid, shape = grid_from_pitch((180, 180), 9), (180, 180)
    lit = as_mosaic(white_image(grid, shape, rng))
    with pytest.raises(InputError, match="raw image is a colour mosaic"):
        decode_raw(0.5 + 0.1 * lit, grid, dark=np.full(shape, 0.5))
    write_image(tmp_path / "raw.tif", lit.astype(np.float32))
    with pytest.raises(InputError, match="lenslet image is a colour mosaic"):
        read_light_field(tmp_path / "raw.tif", views=9)
    with pytest.raises(InputError, match="raw image is a colour mosaic"):
        read_raw(tmp_path / "raw.tif", pitch=9)
    read_light_field(tmp_path / "raw.tif", views=2)  # each colour a view, as a user may want


@pytest.mark.parametrize("kind", [np.float64, np.uint16])
def test_the_black_level_is_in_the_raw_and_in_the_white_image(kind, rng):
    """Black is 64 of 1023, and lenslets towards the corners get down to 0.3 of the light.

    The black level in the white image alone would make the corners 10 % too dark.
    """
    shape = (132, 132)
    grid = grid_from_pitch(shape, 11)
    y, x = (np.linspace(-1, 1, n) for n in shape)
    light = 900 * (1 - 0.35 * (y[:, None] ** 2 + x**2))
    black = 64 + rng.integers(-8, 8, shape)
    raw, white, dark = (
        np.rint(image).astype(kind) for image in (0.4 * light + black, light + black, black)
    )
    even = decode_raw(raw, grid, white=white, dark=dark).views
    np.testing.assert_allclose(even / even[5, 5, 5, 5], 1, rtol=0.01)
    assert even.mean() == pytest.approx(0.4 * np.median(light), rel=0.01)
    if kind is np.float64:
        in_colour = [np.stack([image, 2 * image], axis=-1) for image in (raw, white, dark)]
        coloured = decode_raw(in_colour[0], grid, white=in_colour[1], dark=in_colour[2]).views
        np.testing.assert_allclose(coloured[..., 1], 2 * even, rtol=1e-5)


@pytest.mark.slow
@pytest.mark.skipif(not MICROSCOPE.is_dir(), reason="no real raw image beside the checkout")
def test_a_real_raw_image_of_round_micro_images_has_a_map(caplog):
    """A fluorescent vesicle, translucent and faint: no pixel has one slope, and hardly one may be
    called certain. None is saturated, so that nothing is a lower bound."""
    raw, white = (MICROSCOPE / f"{name}.tif" for name in ("Lightfield", "Radiometry"))
    found, _ = read_raw(raw, white=white)
    assert found.weights is not None
    assert 0.3 < np.mean(found.weights > 0) < 0.9
    assert found.valid is not None
    assert (shift_and_sum(found, [-0.5, 0.0, 0.5]) > 0).all()
    assert "lower bounds" not in caplog.text
    made = all_in_focus(found, np.linspace(-1, 1, 33))
    assert np.isfinite(made.slope).all()
    assert np.mean(made.confidence >= TRUSTED) < 0.02


@pytest.mark.parametrize(("layout", "bayer"), [("rectangular", "gbrg"), ("hexagonal", None)])
def test_stuck_pixels_are_unknown(layout, bayer, rng):
    """What is known is as by the same sensor without them, and hardly anything else is unknown."""
    grid, shape = LensletGrid(33.4, 41.2, 14.3, 0.01, layout), (220, 240)
    white = 3000 * white_image(grid, shape, rng, falloff=0.6, gap=0.02)
    scene = 1 + 0.3 * ndimage.gaussian_filter(rng.standard_normal(shape), 3) / 0.1
    raw, dark = 0.5 * white * scene, 64 + 2 * rng.standard_normal(shape)
    if bayer:  # so that a neighbour of another colour would not do
        raw = as_mosaic(raw, ORDERS[1])
    whole = decode_raw(raw + dark, grid, white=white + dark, dark=dark, bayer=bayer)
    inside = ndimage.minimum_filter(white, 9) > 500  # off the rims
    bad = rng.permutation(np.argwhere(inside))[:40]
    hot, dead = bad[:20].T, bad[20:].T
    lit, flat, black = raw + dark, white + dark, dark.copy()
    for image in (lit, flat, black):
        image[*hot], image[*dead] = 9000.0, 64.0  # stuck
    counts, known = whole.weights > 0, whole.valid
    for images in ((lit, flat, black), (lit - dark, flat - dark, None)):
        found = decode_raw(images[0], grid, white=images[1], dark=images[2], bayer=bayer)
        away = np.abs(found.views - whole.views) > 0.1 * whole.views.mean()
        away = away.any(axis=4) if bayer else away
        assert away[counts[..., None, None] & known & found.valid].mean() < 3e-4
        lost = known & ~found.valid
        assert 0 < lost[counts].mean() < 0.09
