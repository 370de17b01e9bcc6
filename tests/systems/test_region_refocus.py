import numpy as np
import pytest

from lf_flame import InputError, LightField
from lf_flame.scenes.dead_leaves import DeadLeaves
from lf_flame.systems.region_refocus import refocus_regions
from lf_flame.systems.sparse_unet import SparseUNet, build_unet


@pytest.fixture(scope="module")
def two_depths():
    """Views whose left half stands at slope 0.83 and whose right half at -0.61."""
    rng = np.random.default_rng(8)
    left, right = (
        DeadLeaves(slopes=(slope, slope)).draw((9, 9), (60, 120), rng).views
        for slope in (0.83, -0.61)
    )
    return np.concatenate([left[..., :60], right[..., 60:]], axis=-1)


REGIONS = [(16, 44, 10, 50), (16, 44, 70, 110)]


@pytest.mark.slow
@pytest.mark.parametrize("cross", [False, True])
def test_regions_at_two_depths_are_both_sharp_and_the_rest_is_not(two_depths, cross):
    image, slopes, found = refocus_regions(two_depths, REGIONS, cross=cross)
    assert [one.slope for one in found] == pytest.approx([0.83, -0.61], abs=0.02)
    assert all(0.5 < one.confidence <= 1 for one in found)
    for (t0, t1, s0, s1), one in zip(REGIONS, found, strict=True):
        np.testing.assert_allclose(slopes[t0:t1, s0:s1], one.slope)
    middle = two_depths[4, 4]
    for t0, t1, s0, s1 in REGIONS:
        inner = slice(t0 + 8, t1 - 8), slice(s0 + 8, s1 - 8)
        assert np.abs(image[inner] - middle[inner]).mean() < 0.03
    assert slopes[0, 60] == pytest.approx(-2.61, abs=0.1)  # four steps: 8 pixels
    assert np.abs(image[:3] - middle[:3]).mean() > 0.03


@pytest.mark.slow
@pytest.mark.parametrize("slopes", [(0.035, -0.018), (0.4, -0.3)])
def test_small_slopes_are_found_and_what_is_not_certain_is_refused(rng, slopes):
    """Two flames-like blobs at planted slopes; a region with both, and a bare one, have none."""
    views = np.zeros((9, 9, 60, 120))
    t, s = np.indices((60, 120))
    for v, u, k in np.ndindex(9, 9, 2):
        y, x = t - 30 - slopes[k] * (v - 4), s - (30, 90)[k] - slopes[k] * (u - 4)
        views[v, u] += np.exp(-(x**2) / 18 - y**2 / 160) * (1 + 0.5 * np.sin(0.8 * y + x))
    views += rng.normal(scale=1e-3, size=views.shape)
    found = refocus_regions(views, [(5, 55, 12, 48), (5, 55, 72, 108)])[2]
    assert [one.slope for one in found] == pytest.approx(slopes, abs=0.003)
    bare = "Region 5 55 56 64.*(too little texture|No slope is sharpest)"
    with pytest.raises(InputError, match=bare):
        refocus_regions(views, [(5, 55, 56, 64)])
    if slopes[0] > 0.1:
        with pytest.raises(InputError, match="has no certain slope .*: several slopes are sharp"):
            refocus_regions(views, [(0, 60, 0, 120)])


@pytest.mark.slow
@pytest.mark.parametrize("cross", [False, True])
def test_views_that_do_not_count_change_nothing(two_depths, cross, rng):
    """Whatever light they hold, of the cross too."""
    weights = np.ones((9, 9))
    weights[[0, 4, 8, 4], [4, 0, 4, 8]] = 0
    other = two_depths.copy()
    other[weights == 0] = rng.uniform(size=other[weights == 0].shape)
    (image, _, found), (same, _, same_found) = (
        refocus_regions(LightField(views, weights=weights), REGIONS[:1], cross=cross)
        for views in (two_depths, other)
    )
    np.testing.assert_allclose(image, same, atol=1e-5)
    assert found[0].slope == pytest.approx(same_found[0].slope, abs=1e-4)
    assert found[0].slope == pytest.approx(0.83, abs=0.05)


@pytest.mark.slow
def test_a_trained_unet_works_on_the_regions_image(two_depths):
    """A network whose last layer adds a tenth; it needs all views of the cross."""
    system = SparseUNet(build_unet())
    kernel, bias = system.model.layers[-2].get_weights()
    system.model.layers[-2].set_weights([0 * kernel, bias + 0.1])
    plain, _, _ = refocus_regions(two_depths, REGIONS[:1], cross=True)
    mended, _, _ = refocus_regions(two_depths, REGIONS[:1], unet=system)
    np.testing.assert_allclose(mended, np.clip(plain + 0.1, 0, 1), atol=1e-6)
    missing = LightField(two_depths, weights=np.arange(81).reshape(9, 9) != 36)
    with pytest.raises(InputError, match="needs the view in row 4, column 0"):
        refocus_regions(missing, REGIONS[:1], unet=system)
    coloured = np.stack([two_depths] * 3, axis=-1)
    assert refocus_regions(coloured, REGIONS[:1], unet=system)[0].shape == (60, 120, 3)
