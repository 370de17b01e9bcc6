"""Light fields larger than memory, in bands of rows, beside the whole in memory."""

import numpy as np
import pytest

from lf_flame import InputError, LazyLightField, LightField
from lf_flame.refocus import (
    all_in_focus,
    find_sharpest_slope,
    find_slope_range,
    refocus,
    refocus_surface,
)


def waves(shape, rng, channels=None):
    """Views of a surface of two slopes, as numbers of any kind of texture."""
    v, u, t, s = shape
    texture = rng.uniform(0.1, 0.9, size=(t + 40, s + 40, *([channels] if channels else [])))
    views = np.empty((v, u, t, s, *texture.shape[2:]), np.float32)
    for a, b in np.ndindex(v, u):
        down, right = a - (v - 1) // 2, b - (u - 1) // 2
        views[a, b] = texture[20 - down :, 20 - right :][:t, :s]
        views[a, b, :, s // 2 :] = texture[20 + down :, 20 + right :][:t, s // 2 : s]
    return views


@pytest.fixture
def few_rows(monkeypatch):
    """A memory limit that leaves room for some 24 rows of the views of these tests."""

    def limit(views, rows=24):
        row = 4 * views.size / views.shape[2]
        monkeypatch.setenv("LF_FLAME_MEMORY_GB", repr(rows * 8 * row / 1e9))
        return LazyLightField(views)

    return limit


@pytest.mark.parametrize("interpolation", ["linear", "nearest", "cubic"])
def test_images_of_bands_are_those_of_the_whole(few_rows, interpolation, rng):
    views = waves((5, 4, 83, 40), rng, 3)
    weights = rng.uniform(size=(5, 4))
    lazy = few_rows(views)
    assert len(lazy.plan(4)) > 3
    options = {"weights": weights, "interpolation": interpolation}
    for slopes in (0.77, [-1.3, 0.0, 2.4], [30.0]):
        whole = refocus(views, slopes, **options)
        np.testing.assert_allclose(refocus(lazy, slopes, **options), whole, atol=1e-6, rtol=0)
    surface = rng.uniform(-2, 2, size=(2, 83, 40))
    for maps in (surface, surface[1]):
        whole = refocus_surface(views, maps, **options)
        found = refocus_surface(lazy, maps, **options)
        np.testing.assert_allclose(found, whole, atol=1e-6, rtol=0)


@pytest.mark.slow
@pytest.mark.parametrize(("views", "fall"), [((5, 5), 0.2), ((4, 4), 0.0)])
def test_slope_maps_of_bands_are_those_of_the_whole(few_rows, views, fall, rng):
    """Also where views fall off in brightness downward, and where no view is the central one."""
    light = waves((*views, 90, 60), rng)
    steps = np.arange(views[0]) - (views[0] - 1) / 2
    light *= 1 - fall * np.multiply.outer(
        np.hypot(*np.meshgrid(steps, steps)), np.mgrid[:90, :60][0] / 90
    )
    slopes = np.linspace(-2, 2, 17)
    whole, lazy = all_in_focus(light, slopes), few_rows(light)
    assert len(lazy.plan(8)) > 3
    found = all_in_focus(lazy, slopes)
    for name in ("slope", "confidence", "all_in_focus"):
        np.testing.assert_allclose(getattr(found, name), getattr(whole, name), atol=1e-6)
    expected = np.where(np.arange(60) < 30, 1, -1)
    assert np.median(np.abs(found.slope - expected)) < 0.05


def test_weights_of_views_count_once(few_rows, rng):
    views = waves((3, 3, 60, 40), rng)
    weights = rng.uniform(0.1, 1, size=(3, 3))
    lazy = few_rows(views).rearranged(weights=weights)
    light_field, slopes = LightField(views, weights=weights), np.linspace(-2, 2, 9)
    np.testing.assert_allclose(refocus(lazy, 1.0), refocus(light_field, 1.0), atol=1e-6)
    found, whole = all_in_focus(lazy, slopes), all_in_focus(light_field, slopes)
    np.testing.assert_allclose(found.all_in_focus, whole.all_in_focus, atol=1e-6)


def test_the_range_of_slopes_is_that_of_the_whole(few_rows, rng):
    views = waves((3, 3, 390, 50), rng)  # blocks of 2 x 2, across the ends of bands
    assert find_slope_range(few_rows(views, 25)) == find_slope_range(views)


def test_what_cannot_be_done_in_bands_is_refused(few_rows, rng):
    lazy = few_rows(waves((3, 3, 60, 40), rng))
    with pytest.raises(InputError, match="needs the whole light field in memory"):
        find_sharpest_slope(lazy)
    with pytest.raises(InputError, match="needs the whole light field in memory"):
        refocus(lazy, 1.0, interpolation="sinc")
    with pytest.raises(InputError, match="60 x 40 lenslets"):
        refocus_surface(lazy, np.ones((59, 40)))
    with pytest.raises(InputError, match="finite"):
        refocus(lazy, np.nan)
    with pytest.raises(InputError, match="GB of memory"):
        refocus(few_rows(np.ones((9, 9, 1000, 40), np.float32), 1), 100.0)
