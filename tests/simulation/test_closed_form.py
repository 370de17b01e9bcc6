import numpy as np
import pytest

from lf_flame import InputError, Layer, Scene, render
from lf_flame.optics.ray_bundle import trace_footprint
from lf_flame.simulation.reference.closed_form import _crossings, _hidden, closed_form
from lf_flame.simulation.reference.forward import trace_forward


def glow(rng, depth, cells=(7, 5)):
    return Layer(rng.random(cells), depth, (2.4, 2.0), (0.3, -0.2))


def card(rng, depth, cells=(6, 8)):
    size, centre = (1.4, 1.8), (-0.1, 0.2)
    texture, coverage = rng.random(cells) * 0.1, rng.random(cells)
    return Layer(texture, depth, size, centre, opaque=True, coverage=coverage)


@pytest.mark.parametrize(("near", "far"), [(-10, 20), (0, 10), (-20, 0)])
def test_crossing_cells_have_the_share_that_a_fine_grid_counts(small_camera, rng, near, far):
    layers = card(rng, near), glow(rng, far)
    grid = (np.arange(700) + 0.5) / 700 - 0.5
    for axis in (0, 1):
        shares = _crossings(*layers, small_camera, axis)
        for pixel in rng.integers(0, len(shares), 6):
            places = []
            for layer in layers:
                bundle = trace_footprint(small_camera, layer.depth_mm, axis)
                at = bundle.centres_mm.ravel()[pixel] + np.add.outer(
                    bundle.lenslet_width_mm * grid, bundle.pixel_width_mm * grid
                )
                places.append(np.searchsorted(layer.cell_edges_mm(axis), at, side="right"))
            counted = np.zeros((shares.shape[1] + 2, shares.shape[2] + 2))
            np.add.at(counted, tuple(places), 1 / grid.size**2)
            np.testing.assert_allclose(shares[pixel], counted[1:-1, 1:-1], atol=2e-3)


def test_layers_that_add_are_those_of_the_exact_integrator(small_camera, rng):
    scene = Scene([glow(rng, 20.0), glow(rng, 0.0)])
    exact = render(scene, small_camera, effects={"defocus": True}).views
    np.testing.assert_allclose(closed_form(scene, small_camera), exact, rtol=2e-7, atol=1e-9)


@pytest.mark.slow
@pytest.mark.jit
def test_hidden_light_is_that_of_both_tracers(small_camera, rng):
    """Backward and forward rays know nothing of strips and their areas."""
    scene = Scene([glow(rng, 20.0), card(rng, -10.0), glow(rng, 40.0)])
    image = closed_form(scene, small_camera)
    traced = render(scene, small_camera, integrator="rays", rays=60).views
    forward = trace_forward(scene, small_camera, 2**21, "quasi")
    for other, allowed in ((traced, 1e-3), (forward, 0.02)):
        assert np.sqrt(np.mean((other - image) ** 2)) < allowed * image.max()
    assert forward.sum(dtype=float) == pytest.approx(image.sum(), rel=2e-4)
    bare = closed_form(Scene([scene.layers[0], scene.layers[2]]), small_camera)
    assert np.abs(image - bare).max() > 0.1


def test_a_card_over_all_hides_all(small_camera, rng):
    wide = Layer(np.zeros((1, 2)), -10.0, (30.0, 30.0), opaque=True)
    image = closed_form(Scene([glow(rng, 20.0), wide]), small_camera)
    np.testing.assert_allclose(image, 0, atol=1e-13)
    assert not closed_form(Scene([wide]), small_camera).any()


def test_a_card_of_nothing_but_holes_hides_nothing(small_camera, rng):
    holes = Layer(np.zeros((3, 4)), -10.0, (1.0, 1.0), opaque=True, coverage=np.zeros((3, 4)))
    light = glow(rng, 20.0)
    hidden = _hidden(holes, light, small_camera)
    np.testing.assert_array_equal(hidden, np.zeros((5 * 24, 5 * 30)))
    image, bare = (closed_form(Scene(layers), small_camera) for layers in ([light, holes], [light]))
    np.testing.assert_array_equal(image, bare)


def test_scenes_without_a_closed_form_are_refused(small_camera, rng):
    with pytest.raises(InputError, match="flat and do not absorb"):
        closed_form(Scene([Layer([[1.0]], 0.0, (1.0, 1.0), thickness_mm=1.0)]), small_camera)
    with pytest.raises(InputError, match="takes one opaque layer in front of a glow, got 2"):
        closed_form(Scene([card(rng, 0.0), card(rng, 5.0), glow(rng, 20.0)]), small_camera)
