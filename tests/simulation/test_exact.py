import numpy as np
import pytest

from lf_flame import Layer, Scene
from lf_flame.optics.ray_bundle import trapezoid_cdf
from lf_flame.simulation import exact
from lf_flame.simulation.exact import band_weights, integrate
from lf_flame.simulation.optical_pass import OpticalPass, blank_image
from lf_flame.simulation.slabs import slice_scene


@pytest.mark.parametrize(
    ("lenslet_mm", "pixel_mm"),
    [
        (0.3, 0.3),
        (0.0, 0.2),
        (0.2, 0.0),
        (0.0, 0.0),
        (1e-9, 3.0),
        (0.3, np.linspace(0, 0.9, 55).reshape(5, 11)),
    ],
)
def test_compiled_weights_are_differences_of_the_distribution(lenslet_mm, pixel_mm, rng):
    """Whichever box is wider, and where one has no width; 0 beside the cells."""
    edges = -1.3 + 0.07 * np.arange(40)
    centres = np.concatenate([rng.uniform(-3, 3, 50), edges[:3], [edges[0] - 0.3, edges[-1] + 0.3]])
    starts, weights = band_weights(edges, centres.reshape(5, 11), lenslet_mm, pixel_mm)
    near = edges[starts[..., None] + np.arange(weights.shape[2] + 1)]
    widths = np.broadcast_to(pixel_mm, (5, 11))[..., None]
    expected = np.diff(trapezoid_cdf(near - centres.reshape(5, 11, 1), lenslet_mm, widths), axis=2)
    np.testing.assert_allclose(weights, expected, rtol=0, atol=1e-16)
    beside = np.abs(centres - edges.mean()) > np.ptp(edges) / 2 + (lenslet_mm + widths.ravel()) / 2
    assert beside.any()
    assert not weights.reshape(55, -1)[beside].any()


def test_planes_are_integrated_together_as_far_as_their_lines_fit_in_memory(
    small_camera, rng, monkeypatch
):
    layers = [Layer(rng.random((6, 5)), depth, (1.5, 1.6)) for depth in (-9.0, 0.0, 4.0, 9.0, 15.0)]
    planes = slice_scene(Scene(layers), {}, absorption=False, dimming=set())
    optics, batches = OpticalPass(small_camera), []

    def image():
        out = blank_image(small_camera, "views", np.float64)
        integrate(planes, optics, "views", out)
        return out

    def counting(batch, *rest, whole=exact._integrate_batch):
        batches.append(len(batch))
        whole(batch, *rest)

    monkeypatch.setattr(exact, "_integrate_batch", counting)
    at_once = image()
    # Two planes of six lines of float64, seen by 5 x 30 columns of pixels.
    monkeypatch.setattr(exact, "LINES_BYTES", 2 * 6 * (5 * 30) * 8)
    np.testing.assert_allclose(image(), at_once, rtol=1e-12)
    assert batches == [5, 2, 2, 1]
