import numpy as np
import pytest

from lf_flame import Layer, Scene
from lf_flame.optics.ray_bundle import trapezoid_cdf
from lf_flame.simulation import exact
from lf_flame.simulation.exact import band_weights, integrate
from lf_flame.simulation.optical_pass import OpticalPass, blank_image
from lf_flame.simulation.slabs import slice_scene


@pytest.mark.parametrize("pixel_mm", [0.37, np.array([0.05, 0.37, 0.9, 0.0])])
def test_weights_are_the_shares_of_points_that_lie_in_the_cells(pixel_mm):
    """Of pixels of one width or of each its own, counted on a grid over lenslet and pixel."""
    edges, centres, lenslet_mm = np.linspace(-1.3, 1.7, 31), np.array([0.1, -0.52, 0.4, 0.333]), 0.3
    starts, weights = band_weights(edges, centres, lenslet_mm, pixel_mm)
    grid = (np.arange(1000) + 0.5) / 1000 - 0.5
    for centre, wide, start, band in zip(
        centres, np.broadcast_to(pixel_mm, 4), starts, weights, strict=True
    ):
        points = centre + np.add.outer(lenslet_mm * grid, wide * grid)
        counted, _ = np.histogram(points, edges)
        found = np.zeros(30)
        found[start : start + len(band)] = band
        np.testing.assert_allclose(found, counted / points.size, atol=2e-3)
        assert found.sum() == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize(
    ("lenslet_mm", "pixel_mm"), [(0.3, 0.3), (0.0, 0.2), (0.2, 0.0), (0.0, 0.0), (1e-9, 3.0)]
)
def test_compiled_weights_are_differences_of_the_distribution(lenslet_mm, pixel_mm, rng):
    """Whichever box is wider, and where one has no width; 0 beside the cells."""
    edges = -1.3 + 0.07 * np.arange(40)
    centres = np.concatenate([rng.uniform(-3, 3, 50), edges[:3], [edges[0] - 0.3, edges[-1] + 0.3]])
    starts, weights = band_weights(edges, centres.reshape(5, 11), lenslet_mm, pixel_mm)
    near = edges[starts[..., None] + np.arange(weights.shape[2] + 1)]
    expected = np.diff(
        trapezoid_cdf(near - centres.reshape(5, 11, 1), lenslet_mm, pixel_mm), axis=2
    )
    np.testing.assert_allclose(weights, expected, rtol=0, atol=1e-16)
    beside = np.abs(centres - edges.mean()) > np.ptp(edges) / 2 + (lenslet_mm + pixel_mm) / 2
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
