"""The slope of sharpest focus: planted ones are found, and how sure the search says it is."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from skimage.io import imread

from experiments.paper.evaluation import slope_report
from lf_flame import LightField
from lf_flame._common.arrays import centred
from lf_flame.datasets.config import read_config
from lf_flame.refocus import (
    all_in_focus,
    aperture_weights,
    find_sharpest_slope,
    fourier_refocus,
    shift_and_sum,
)  # fmt: skip
from lf_flame.refocus.search import find_sharpest_slopes
from lf_flame.scenes.flames import draw_wrinkles, flame_texture

DATA = Path(__file__).parents[2] / "data_gen"
LYTRO = Path(__file__).parents[3] / "shared" / "lightfields" / "lytro_2067"


def band_limited(rng, size, cutoff):
    """Gaussian noise below a spatial frequency, in cycles per lenslet, about 1/2."""
    k = np.hypot(np.fft.fftfreq(size[0])[:, None], np.fft.rfftfreq(size[1])[None, :])
    noise = np.fft.irfft2(np.fft.rfft2(rng.normal(size=size)) * np.exp(-((k / cutoff) ** 2)), size)
    return 0.5 + 0.2 * noise / noise.std()


def blob(rng, size):
    t, s = (centred(n)[:, None] + rng.uniform(-3, 3) for n in size)
    return np.exp(-(t**2 + s.T**2) / (2 * (0.1 * min(size)) ** 2))


def flame(rng, size):
    """A flame in the middle of a dark image."""
    texture = flame_texture(0.6 * size[0], 0.05 * size[1], draw_wrinkles(rng), 0.3, 0.04, 1.0)
    image = np.zeros(size)
    t, s = ((n - m) // 2 for n, m in zip(size, texture.shape, strict=True))
    image[t : t + texture.shape[0], s : s + texture.shape[1]] = texture
    return image


TEXTURES = {
    "white noise": lambda rng, size: rng.uniform(size=size),
    "texture": lambda rng, size: band_limited(rng, size, 0.12),
    "clouds": lambda rng, size: band_limited(rng, size, 0.04),
    "blob": blob,
    "flame": flame,
}


def planted(texture, slope, views):
    """Views of a layer at a slope, displaced exactly, by its spectrum."""
    down, across = np.fft.fftfreq(texture.shape[0]), np.fft.rfftfreq(texture.shape[1])
    phase_factors = (
        np.exp(-2j * np.pi * slope * centred(n)[:, None] * k)
        for n, k in zip(views, (down, across), strict=True)
    )
    down, across = phase_factors
    spectra = np.fft.rfft2(texture) * down[:, None, :, None] * across[None, :, None, :]
    return np.fft.irfft2(spectra, texture.shape)


def seen(texture, slope, views, size):
    """Planted views through a window, so that light comes in and leaves at its edges."""
    t, s = ((n - m) // 2 for n, m in zip(texture.shape, size, strict=True))
    return planted(texture, slope, views)[:, :, t : t + size[0], s : s + size[1]]


@pytest.mark.parametrize("views", [(3, 3), (4, 6), pytest.param((9, 9), marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", TEXTURES)
def test_planted_slopes_are_found(kind, views, rng):
    """Within 0.01, on the whole image, with noise of one per cent."""
    slope = rng.uniform(-2.5, 2.5)
    light_field = seen(TEXTURES[kind](rng, (96, 104)), slope, views, (56, 64))
    light_field = light_field + 0.01 * rng.normal(size=light_field.shape)
    assert find_sharpest_slope(light_field).slope == pytest.approx(slope, abs=0.01)


@pytest.mark.slow
def test_light_that_enters_at_the_edges_does_not_move_the_peak(rng):
    """Naive: the gradient energy alone; where fewer views see a lenslet, they blur its image."""
    slope, slopes = 2.2, np.linspace(-3, 3, 241)
    light_field = seen(band_limited(rng, (96, 104), 0.04), slope, (9, 9), (56, 64))
    naive = np.square(np.gradient(fourier_refocus(light_field, slopes), axis=(1, 2)))
    naive = slopes[naive.sum(axis=(0, 2, 3)).argmax()]
    assert find_sharpest_slope(light_field).slope == pytest.approx(slope, abs=0.002)
    assert abs(naive - slope) > 0.02


@pytest.mark.parametrize("slope", [-2.02, -0.98, 0.03, 0.5, 1.04])
def test_whole_slopes_do_not_draw_the_peak(slope, rng):
    """Naive: gradient energy over bilinear shifts, which soften all but whole slopes."""
    light_field = planted(rng.uniform(size=(64, 64)), slope, (3, 3))
    light_field += 0.1 * rng.normal(size=light_field.shape)
    assert find_sharpest_slope(light_field).slope == pytest.approx(slope, abs=0.01)
    slopes = np.linspace(-3, 3, 301)
    stack = shift_and_sum(light_field, slopes)[:, 8:-8, 8:-8]
    naive = slopes[np.square(np.gradient(stack, axis=(1, 2))).sum(axis=(0, 2, 3)).argmax()]
    assert abs(naive - slope) > 0.015


@pytest.mark.slow
def test_regions_smaller_than_the_object(rng):
    light_field = planted(band_limited(rng, (96, 96), 0.1), -1.63, (7, 7))
    for region in ((0, 30, 0, 30), (40, 60, 33, 61), (70, 96, 10, 40)):
        found = find_sharpest_slope(light_field, region=region)
        assert found.slope == pytest.approx(-1.63, abs=0.01)
        assert found.region == region


@pytest.mark.slow
def test_wide_steps_are_filled_in(rng):
    """Between slopes 0.5 apart the peak of 15 views would fall through."""
    light_field = planted(rng.uniform(size=(64, 64)), 1.23, (15, 3))
    slopes = np.arange(-2.5, 2.6, 0.5)
    found = find_sharpest_slope(light_field, slopes)
    assert found.slope == pytest.approx(1.23, abs=0.002)
    np.testing.assert_array_equal(found.slopes, slopes)
    fine = find_sharpest_slope(light_field, np.linspace(-2.5, 2.5, 101))
    np.testing.assert_allclose(found.sharpness, fine.sharpness[::10], rtol=1e-4)


@pytest.mark.slow
def test_default_range_widens_until_the_peak_is_inside(rng):
    for texture in (rng.uniform(size=(128, 128)), band_limited(rng, (128, 128), 0.03)):
        found = find_sharpest_slope(planted(texture, -5.37, (5, 5)))
        assert found.slope == pytest.approx(-5.37, abs=0.01)
        assert found.slopes[0] < -5.37
        steps = np.diff(found.slopes)
        np.testing.assert_allclose(steps, steps[0], rtol=1e-9)


def test_a_clear_peak_in_strong_noise_does_not_widen_the_range(rng):
    """81 views share less than a half of their energy, but far more than 3 / 81."""
    light_field = planted(band_limited(rng, (64, 64), 0.12), 1.4, (9, 9))
    light_field += 0.5 * rng.normal(size=light_field.shape)
    found = find_sharpest_slope(light_field)
    assert found.slope == pytest.approx(1.4, abs=0.02)
    assert found.slopes[-1] == pytest.approx(3.0, abs=0.1)


def test_confidence_is_low_in_noise_alone(rng):
    views = rng.normal(size=(5, 5, 64, 64))
    assert 0 <= find_sharpest_slope(views).confidence < 0.35


@pytest.mark.slow
def test_views_count_by_their_weights_in_search_and_map(rng):
    """Light of rim views comes from a tenth nearer to the centre, as where they are partly lit."""
    texture = band_limited(rng, (64, 72), 0.15)
    views, inner = (planted(texture, slope, (7, 7)) for slope in (0.9 * 0.6, 0.6))
    views[1:-1, 1:-1] = inner[1:-1, 1:-1]
    lit = np.pad(np.ones((5, 5)), 1, constant_values=0.005)
    slopes, middle = np.linspace(-1, 1.5, 33), np.s_[8:-8, 8:-8]
    for weights, off in ((lit, (0.0, 0.003)), (np.ones((7, 7)), (0.02, 0.1))):
        light_field = LightField(views, weights=weights)
        found = find_sharpest_slope(light_field).slope
        mapped = np.median(all_in_focus(light_field, slopes).slope[middle])
        for slope in (found, mapped):
            assert off[0] - 1e-3 <= 1 - slope / 0.6 <= off[1]


@pytest.mark.slow
@pytest.mark.parametrize("around", [0.4, 3.0])
def test_confidence_does_not_depend_on_the_range_of_the_search(around, rng):
    """Of a broad blob, whose curve is still high at the ends of a narrow range, and of two."""
    broad = planted(blob(rng, (96, 96)), 0.5, (5, 5))
    two = np.concatenate([planted(band_limited(rng, (64, 64), 0.1), slope, (5, 5))[..., :32]
                          for slope in (0.8, -0.9)], axis=-1)  # fmt: skip
    for views, low, high in ((broad, 0.3, 0.8), (two, 0.0, 0.1)):
        slope = find_sharpest_slope(views).slope
        narrow = find_sharpest_slope(views, slope + around * np.linspace(-1, 1, 21))
        assert low <= narrow.confidence <= high
        assert narrow.confidence == pytest.approx(
            find_sharpest_slope(views, slope + np.linspace(-2, 2, 41)).confidence, abs=0.03
        )


@pytest.mark.slow
@pytest.mark.parametrize("apart", [0.6, 4.5])
@pytest.mark.parametrize("how", ["beside", "before"])
def test_confidence_is_low_where_two_slopes_are_sharp(how, apart, rng):
    """Beside each other, or one seen through the other, with peaks apart or merged into one."""
    near, far = (
        planted(band_limited(rng, (64, 96), 0.1), slope, (9, 9))
        for slope in (-apart / 2, apart / 2)
    )
    views = near + far if how == "before" else np.concatenate([near[..., :48], far[..., 48:]], -1)
    views += rng.normal(scale=0.01, size=views.shape)
    found = find_sharpest_slope(views)
    assert (found.confidence < 0.2, found.doubt) == (True, "several slopes are sharp")
    assert find_sharpest_slope(near).confidence > 0.9
    ring = aperture_weights((9, 9), 1.0, ring=0.5)  # without the middle third
    noisy = near + rng.normal(scale=0.1 * near.std(), size=near.shape)
    assert find_sharpest_slope(noisy, weights=ring).confidence > 0.8


def test_a_texture_that_repeats_fits_several_slopes():
    """Of a period of 5 lenslets: slopes 5 apart show the same."""
    t, s = np.indices((80, 90))
    pattern = np.sin(2 * np.pi * t / 5) + np.sin(2 * np.pi * s / 5)
    found = find_sharpest_slope(planted(pattern, 0.3, (5, 5)), np.linspace(-1, 1, 21))
    assert found.slope == pytest.approx(0.3, abs=0.005)
    assert (found.confidence < 0.1, found.doubt) == (True, "the texture repeats")
    with_rim = find_sharpest_slope(planted(pattern, 0.3, (5, 5))[:, :, 3:-3, 3:-3])
    assert with_rim.doubt == "the texture repeats"


def test_confidence_is_low_without_parallax(rng):
    """Three views of a broad blob change little over the slopes searched."""
    size = (96, 96)
    t, s = (centred(n) for n in size)
    broad = np.exp(-(t[:, None] ** 2 + s**2) / (2 * 12.0**2))
    found = find_sharpest_slope(planted(broad, 0.4, (3, 3)), np.linspace(-2, 2, 41))
    assert found.slope == pytest.approx(0.4, abs=0.001)
    assert found.confidence < 0.3
    assert found.doubt == "less than one pixel of parallax between the outer views"


def test_the_sharpness_of_a_wave_is_its_mean_squared_gradient():
    """Of ``a sin(2 pi k s)`` behind a Gaussian low-pass of 0.15 cycles, in closed form."""
    a, k = 0.3, 0.1
    wave = 0.5 + a * np.sin(2 * np.pi * k * np.arange(120))
    views = np.broadcast_to(wave, (3, 3, 80, 120))
    found = find_sharpest_slope(views, np.linspace(-1, 1, 21), region=(20, 60, 40, 80))
    expected = (a * 2 * np.pi * k) ** 2 / 2 * np.exp(-((k / 0.15) ** 2))
    assert found.sharpness.max() == pytest.approx(expected, rel=1e-3)


def side_by_side(rng):
    """Two layers, left and right, and nothing below them."""
    views = np.zeros((5, 5, 80, 80))
    for slope, columns in ((1.3, slice(0, 40)), (-0.6, slice(40, 80))):
        views[:, :, :40, columns] = planted(rng.uniform(size=(40, 40)), slope, (5, 5))
    return views


def test_tiles_find_a_slope_each_and_none_in_the_dark(rng):
    found = find_sharpest_slopes(side_by_side(rng), (4, 4), np.ones((5, 5)))
    slopes = np.array([search.slope for search in found]).reshape(4, 4)
    confidence = np.array([search.confidence for search in found]).reshape(4, 4)
    np.testing.assert_allclose(slopes[0], [1.3, 1.3, -0.6, -0.6], atol=0.01)
    assert np.all(confidence[0] > 0.7)
    assert np.all(np.isnan(slopes[3]))
    assert np.all(confidence[3] == 0)
    assert found[6].region == (20, 40, 40, 60)
    assert all(search.sharpness.shape == search.slopes.shape for search in found)


@pytest.mark.slow
@pytest.mark.skipif(
    not LYTRO.exists(), reason="the example light fields are not beside the checkout"
)
def test_a_real_light_field_is_sharpest_where_bilinear_refocusing_says():
    """A flower before a wall: between whole slopes both agree, and tell the two apart."""
    views = np.array(
        [[imread(LYTRO / f"2067_{v:02}_{u:02}.png")[..., :3] for u in range(1, 10)]
         for v in range(1, 10)]
    )  # fmt: skip
    regions = {"near": (200, 240, 110, 160), "far": (0, 60, 200, 300)}
    slopes = np.linspace(-2, 1, 61)
    found = [find_sharpest_slope(views, slopes, region=region) for region in regions.values()]
    for (t0, t1, s0, s1), search in zip(regions.values(), found, strict=True):
        patch = views[:, :, max(t0 - 8, 0) : t1 + 8, s0 - 8 : s1 + 8].mean(axis=4)
        stack = shift_and_sum(patch, slopes)[:, 8:-8, 8:-8]
        plain = np.square(np.gradient(stack, axis=(1, 2))).sum(axis=(0, 2, 3))
        assert search.slope == pytest.approx(slopes[plain.argmax()], abs=0.1)
        assert search.confidence > 0.6
    assert found[0].slope < found[1].slope - 0.5


@pytest.mark.slow
def test_report_of_slopes_finds_the_geometry_of_both_kinds_of_scene(tmp_path):
    configs = [read_config(DATA / f"{kind}.toml") for kind in ("shapes", "flames")]
    coarse = []
    for config in configs:
        pitch, focal = config.camera.lenslet_pitch_mm, config.camera.lenslet_focal_mm
        camera = replace(config.camera, lenslet_pitch_mm=3 * pitch, lenslet_focal_mm=3 * focal,
                         lenslets=(90, 180), views=5)  # fmt: skip
        coarse.append(replace(config, image=(90, 180), camera=camera))
    text = slope_report(coarse, tmp_path)
    names = {"slopes.csv", "slopes.json", "slopes.md", "figure5.png", "figure6.png"}
    assert {path.name for path in tmp_path.iterdir()} == names
    assert text == (tmp_path / "slopes.md").read_text()
    found = json.loads((tmp_path / "slopes.json").read_text())["data_sets"]
    for config, record in zip(coarse, found, strict=True):
        geometry = config.camera.depth_to_slope(config.depths_mm)
        np.testing.assert_allclose(record["slopes"], geometry, atol=0.03)  # coarse lenslets


@pytest.mark.slow
def test_the_slope_is_the_same_to_the_last_bit_for_any_number_of_threads(tmp_path):
    """In processes of their own: BLAS takes its number of threads when it is loaded."""
    code = (
        "import numpy as np; from lf_flame.scenes.dead_leaves import DeadLeaves;"
        "from lf_flame.refocus import find_sharpest_slope;"
        "lf = DeadLeaves(slopes=(0.4, 0.6)).draw((5, 5), (60, 50), np.random.default_rng(2));"
        "found = find_sharpest_slope(lf); print(found.slope.hex(), found.sharpness.tobytes().hex())"
    )
    found = set()
    for threads in ("1", "2"):
        environment = os.environ | dict.fromkeys(
            ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), threads
        )
        command = [sys.executable, "-c", code]
        found.add(subprocess.run(command, env=environment, capture_output=True, check=True).stdout)
    assert len(found) == 1
