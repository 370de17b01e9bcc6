import numpy as np
import pytest

from lf_flame import LightField
from lf_flame.refocus import FocusMap
from lf_flame.scenes.dead_leaves import DeadLeaves
from lf_flame.systems.region_refocus import (
    most_common_slope,
    refocus_regions,
    search_region_slope,
)
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


LEFT, RIGHT = (10, 50, 10, 50), (10, 50, 70, 110)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("region", "slopes", "slope"),
    [
        (LEFT, (-2.0, 2.0), 0.83),
        (RIGHT, (-2.0, 2.0), -0.61),
        (RIGHT, (-0.7, 3.3), -0.61),  # in the outermost step of ten, which is divided again
        (LEFT, (-3.1, 0.9), 0.83),
    ],
)
def test_slope_of_a_region_is_found(two_depths, region, slopes, slope):
    found, likeness = search_region_slope(two_depths, region, slopes)
    assert found == pytest.approx(slope, abs=0.1)
    assert 0.9 < likeness <= 1
    _, out_of_reach = search_region_slope(two_depths, region, (slope - 3, slope - 2))
    assert out_of_reach < likeness - 0.1


@pytest.mark.slow
@pytest.mark.parametrize("cross", [False, True])
def test_regions_at_two_depths_are_both_sharp_and_the_rest_is_not(two_depths, cross):
    regions = [(16, 44, 10, 50), (16, 44, 70, 110)]
    image, slopes, found = refocus_regions(two_depths, regions, (-2.0, 2.0), cross=cross)
    assert [slope for slope, _ in found] == pytest.approx([0.83, -0.61], abs=0.1)
    assert all(0.5 < trust <= 1 for _, trust in found)
    for (t0, t1, s0, s1), (slope, _) in zip(regions, found, strict=True):
        np.testing.assert_allclose(slopes[t0:t1, s0:s1], slope)
    middle = two_depths[4, 4]
    inner = [(slice(t0 + 8, t1 - 8), slice(s0 + 8, s1 - 8)) for t0, t1, s0, s1 in regions]
    for region in inner:
        assert np.abs(image[region] - middle[region]).mean() < 0.03
    assert slopes[0, 60] == pytest.approx(-2.0, abs=0.1)
    assert np.abs(image[:3] - middle[:3]).mean() > 0.03


@pytest.mark.slow
@pytest.mark.parametrize("cross", [False, True])
def test_views_that_do_not_count_change_nothing(two_depths, cross, rng):
    """Whatever light they hold, of the cross too."""
    weights = np.ones((9, 9))
    weights[[0, 4, 8, 4], [4, 0, 4, 8]] = 0
    other = two_depths.copy()
    other[weights == 0] = rng.uniform(size=other[weights == 0].shape)
    (image, _, found), (same, _, same_found) = (
        refocus_regions(
            LightField(views, weights=weights), [(16, 44, 10, 50)], (-2.0, 2.0), cross=cross
        )
        for views in (two_depths, other)
    )
    np.testing.assert_array_equal(image, same)
    assert found == same_found
    assert found[0][0] == pytest.approx(0.83, abs=0.15)  # 13 views of the cross are left


def test_the_most_common_slope_is_not_the_mean():
    slopes = np.array([[0.5, 0.52, 0.49, 0.51], [3.0, 2.0, -1.0, 0.5]])
    confidence = np.array([[0.9, 0.3, 0.5, 0.9], [0.9, 0.9, 0.9, 0.1]])
    focus_map = FocusMap(slopes, confidence, slopes)
    assert most_common_slope(focus_map, (0, 2, 0, 4)) == pytest.approx(
        (np.mean([0.5, 0.52, 0.49, 0.51]), 7 / 8)
    )
    assert most_common_slope(focus_map, (1, 2, 3, 4)) == (0.5, 0.0)  # no pixel is certain


@pytest.mark.slow
def test_a_trained_unet_works_on_the_regions_image(two_depths):
    """A network whose last layer adds a tenth."""
    system = SparseUNet(build_unet())
    kernel, bias = system.model.layers[-2].get_weights()
    system.model.layers[-2].set_weights([0 * kernel, bias + 0.1])
    asked = two_depths, [(10, 50, 10, 50)], (-2.0, 2.0)
    plain, _, _ = refocus_regions(*asked, cross=True)
    mended, _, _ = refocus_regions(*asked, unet=system)
    np.testing.assert_allclose(mended, np.clip(plain + 0.1, 0, 1), atol=1e-6)
    coloured = np.stack([two_depths] * 3, axis=-1)
    mended, _, _ = refocus_regions(coloured, *asked[1:], unet=system)
    assert mended.shape == (60, 120, 3)
