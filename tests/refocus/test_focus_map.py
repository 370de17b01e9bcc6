from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import binary_erosion, gaussian_filter, map_coordinates

from lf_flame import PAPER_CAMERA, Layer, Scene, render
from lf_flame._common.threads import one_thread
from lf_flame.refocus import shift_and_sum
from lf_flame.refocus.focus_map import TRUSTED, all_in_focus

CAMERA = replace(PAPER_CAMERA, views=7, lenslets=(60, 80))
SLOPES = np.arange(-3.0, 3.01, 0.1)
LYTRO = Path(__file__).parents[3] / "shared" / "lightfields" / "lytro_2067"


def psnr(image, reference):
    return -10 * np.log10(np.mean((np.asarray(image, float) - reference) ** 2))


def noise(rng, size_mm, cell_mm=0.15):
    return rng.uniform(size=[int(np.ceil(length / cell_mm)) for length in size_mm])


def planted(rng, depths):
    """A far wall with opaque, textured squares before it; returns views and the true slopes."""
    wall = [1.3 * side for side in CAMERA.field_mm(depths[0])]
    layers = [Layer(noise(rng, wall), depths[0], wall, opaque=True)]
    slopes = np.full(CAMERA.lenslets, CAMERA.depth_to_slope(depths[0]))
    for k, depth in enumerate(depths[1:]):
        field = np.array(CAMERA.field_mm(depth))
        size, centre = field * (0.5, 0.35), field * (0.1 - 0.2 * k, -0.22 + 0.44 * k)
        layers.append(Layer(noise(rng, size), depth, size, centre, opaque=True))
        inside = [
            np.abs(field[axis] * ((np.arange(n) + 0.5) / n - 0.5) - centre[axis]) < size[axis] / 2
            for axis, n in enumerate(CAMERA.lenslets)
        ]
        slopes[np.ix_(*inside)] = CAMERA.depth_to_slope(depth)
    return render(Scene(layers), CAMERA, tolerance=0.05).views, slopes


def away_from_outlines(slopes, lenslets):
    """Pixels whose surroundings have the same slope."""
    return np.any(
        [binary_erosion(slopes == s, iterations=lenslets) for s in np.unique(slopes)], axis=0
    )


@pytest.mark.slow
@pytest.mark.parametrize("depths", [(10.0, -10.0), (8.0, -4.0, -9.0)])
def test_planted_surfaces_are_found_and_put_in_focus(depths, rng):
    views, slopes = planted(rng, depths)
    found = all_in_focus(views, SLOPES)
    error = np.abs(found.slope - slopes)
    inside = away_from_outlines(slopes, 8)
    assert error[inside].max() < 0.05
    assert np.median(error[inside]) < 0.003  # a 30th of the step
    assert found.confidence[inside].mean() > 2 * found.confidence[error > 0.2].mean()
    slices = shift_and_sum(views, SLOPES)
    assert psnr(found.all_in_focus, views[3, 3]) > 2 + max(psnr(i, views[3, 3]) for i in slices)


def test_the_dark_around_a_blob_without_noise_is_not_certain():
    """Its tail falls below the rounding of a sensor, but never to 0."""
    steps = 0.6 * (np.arange(7) - 3)
    t, s = (np.exp(-(((np.arange(n) - n / 2) - steps[:, None]) ** 2) / 50) for n in (60, 80))
    views = (t[:, None, :, None] * s[None, :, None, :]).astype(np.float32)
    found = all_in_focus(views, np.linspace(-2, 2, 21))
    certain, dark = found.confidence >= TRUSTED, views[3, 3] < 1e-4
    assert certain[dark].mean() < 0.1 < 0.9 < certain[views[3, 3] > 0.1].mean()


def bare_and_faint(rng):
    """A faint wall at 2.2 with a bare patch, and a bright card at -1.6 without texture."""
    depths = [float(CAMERA.slope_to_depth(slope)) for slope in (2.2, -1.6)]
    wall = np.array([1.3 * side for side in CAMERA.field_mm(depths[0])])
    cells = 0.3 + 0.15 * (noise(rng, wall, 0.3) - 0.5)
    rows, columns = cells.shape
    cells[int(0.3 * rows) : int(0.7 * rows), int(0.15 * columns) : int(0.4 * columns)] = 0.3
    field = np.array(CAMERA.field_mm(depths[1]))
    size, centre = field * (0.4, 0.3), field * (0.0, 0.2)
    layers = [
        Layer(cells, depths[0], wall, opaque=True),
        Layer(np.full((1, 1), 0.9), depths[1], size, centre, opaque=True),
    ]
    slopes = np.full(CAMERA.lenslets, 2.2)
    slopes[18:42, 44:68] = -1.6  # 0.4 of 60 rows about their middle; 0.3 of 80 columns about 56
    return render(Scene(layers), CAMERA, integrator="rays", rays=4).views, slopes


@pytest.mark.slow
def test_beside_outlines_and_without_texture_most_slopes_are_right(rng):
    views, slopes = bare_and_faint(rng)
    found = all_in_focus(views, SLOPES)
    wrong = np.abs(found.slope - slopes) > 0.07
    certain = found.confidence >= TRUSTED
    assert wrong.mean() < 0.05
    assert wrong[certain].mean() < 0.03
    assert certain.mean() > 0.45
    assert not wrong[20:40, 46:66].any()  # the card: its outline alone has a slope


@pytest.mark.slow
def test_noise_alone_is_not_certain(rng):
    views = 0.5 + 0.05 * rng.standard_normal((7, 7, 60, 80))
    found = all_in_focus(views.astype(np.float32), SLOPES)
    assert np.mean(found.confidence >= TRUSTED) < 0.01


@pytest.mark.slow
def test_a_tilted_plane_is_not_cut_into_steps(rng):
    """Views of a plane whose slope grows by 0.02 from lenslet to lenslet, from its own picture."""
    truth = np.tile(0.02 * (np.arange(80) - 39.5), (60, 1))
    picture = gaussian_filter(rng.uniform(size=(80, 240)), 1.0)
    columns = np.arange(80.0)
    views = np.empty((7, 7, 60, 80), np.float32)
    for v, u in np.ndindex(7, 7):
        # what the middle view has at x, view u has at x + slope(x) u
        x = (columns + 0.02 * 39.5 * (u - 3)) / (1 + 0.02 * (u - 3))
        y = np.arange(60.0)[:, None] - (v - 3) * np.interp(x, columns, truth[0])
        at = [np.broadcast_to(y, (60, 80)) + 10, np.broadcast_to(x, (60, 80)) + 80]
        views[v, u] = map_coordinates(picture, at, order=3, mode="reflect")
    found = all_in_focus(views, SLOPES)
    inside = (slice(10, -10), slice(12, -12))
    assert np.abs(found.slope - truth)[inside].max() < 0.1
    assert np.median(np.abs(found.slope - truth)[inside]) < 0.007


def test_an_even_number_of_views_and_colour(rng):
    picture = rng.uniform(size=(48, 48, 3))
    views = np.empty((4, 4, 48, 48, 3), np.float32)
    for v, u in np.ndindex(4, 4):  # a slope of 2 moves views that are half a step off by whole ones
        views[v, u] = np.roll(picture, (2 * v - 3, 2 * u - 3), axis=(0, 1))
    found = all_in_focus(views, np.arange(1.0, 3.01, 0.1))
    inside = (slice(10, -10), slice(10, -10))
    np.testing.assert_allclose(found.slope[inside], 2.0, atol=0.002)
    assert found.all_in_focus.shape == (48, 48, 3)
    assert psnr(found.all_in_focus[inside], picture[inside]) > 30


@pytest.mark.slow
@pytest.mark.skipif(not LYTRO.is_dir(), reason="no Lytro example light field beside the checkout")
def test_a_real_light_field_agrees_with_a_learned_disparity():
    """EPINET's disparity is positive for what is near: minus the slope."""
    from imageio.v3 import imread

    header, pixels = (LYTRO / "epinet_output_2067.pfm").read_bytes().split(b"-1\n", 1)
    width, height = (int(n) for n in header.split()[1:3])
    disparity = np.frombuffer(pixels, "<f4").reshape(height, width)[::-1]
    cut = (slice(100, 280), slice(100, 300))
    views = np.empty((9, 9, 180, 200), np.uint8)
    for v, u in np.ndindex(9, 9):
        green = imread(LYTRO / f"2067_{v + 1:02d}_{u + 1:02d}.png")[..., 1]
        views[v, u] = green[11:-11, 11:-11][cut]
    found = all_in_focus(views, np.arange(-1.8, 0.61, 0.1))
    trusted = found.confidence > 0.2
    assert trusted.mean() > 0.5
    slope, learned = found.slope[trusted], disparity[cut][trusted]
    assert np.corrcoef(slope, learned)[0, 1] < -0.98
    assert np.median(np.abs(slope + learned)) < 0.03
    assert np.mean(np.abs(found.slope + disparity[cut]) > 0.07) < 0.1
    slices = shift_and_sum(views, np.arange(-1.8, 0.61, 0.1)) / 255
    middle = views[4, 4] / 255
    assert psnr(found.all_in_focus / 255, middle) > 2 + max(psnr(i, middle) for i in slices)


@pytest.mark.jit
def test_brightness_and_threads_change_no_bit_of_a_map(rng):
    views = rng.random((3, 3, 30, 40), np.float32)
    found = all_in_focus(views, np.linspace(-1, 1, 9))
    with one_thread():
        bright = all_in_focus(2**100 * views, np.linspace(-1, 1, 9))
    np.testing.assert_array_equal(bright.slope, found.slope)
    np.testing.assert_array_equal(bright.confidence, found.confidence)
    np.testing.assert_array_equal(bright.all_in_focus, 2**100 * found.all_in_focus)
