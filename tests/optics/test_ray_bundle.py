import numpy as np
import pytest

from lf_flame.optics.camera import PAPER_CAMERA
from lf_flame.optics.ray_bundle import chain, free_space, inverse, object_to_array, thin_lens


def test_lens_equation_is_where_b_vanishes():
    f, a = 150.0, 326.0
    image = 1 / (1 / f - 1 / a)
    system = chain(free_space(a), thin_lens(f), free_space(image))
    assert system[0, 1] == pytest.approx(0, abs=1e-11)
    assert system[0, 0] == pytest.approx(-image / a, rel=1e-13)


def test_parallel_rays_meet_at_the_focal_point():
    system = chain(thin_lens(150.0), free_space(150.0))
    heights = system @ np.array([[-3.0, 0.0, 7.0], [0.01, 0.01, 0.01]])
    np.testing.assert_allclose(heights[0], 150 * 0.01, atol=1e-13)


def test_inverse_undoes_even_an_afocal_system():
    telescope = chain(thin_lens(100.0), free_space(150.0), thin_lens(50.0))
    assert telescope[1, 0] == pytest.approx(0, abs=1e-15)
    np.testing.assert_allclose(inverse(telescope) @ telescope, np.eye(2), atol=1e-13)


@pytest.mark.parametrize("depth", [-150.0, 0.0, 12.5, 400.0])
@pytest.mark.parametrize("focal", [150.0, 149.0, 160.0])
def test_light_of_another_colour_goes_through_a_lens_of_another_power(depth, focal):
    """Free space, thin lens and free space, element by element; the array stays in place."""
    a, i0 = PAPER_CAMERA.focus_distance_mm + depth, PAPER_CAMERA.image_distance_mm
    expected = [[1 - i0 / focal, a + i0 - a * i0 / focal], [-1 / focal, 1 - a / focal]]
    found = object_to_array(PAPER_CAMERA, depth, focal)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * a)
