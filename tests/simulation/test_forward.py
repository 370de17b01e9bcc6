"""Forward and backward tracing share the matrices and nothing else: each checks the other."""

import math
from dataclasses import replace

import numpy as np
import pytest

from lf_flame import InputError, Layer, Scene, render
from lf_flame.simulation.reference import forward
from lf_flame.simulation.reference.forward import trace_forward

RAYS = 3_000_000


def two_tone(rng, depth, cells=(7, 5), size=(2.4, 2.0), centre=(0.3, -0.2), **options):
    """A layer whose cells are dark or of one brightness, without any symmetry."""
    return Layer(0.8 * (rng.random(cells) < 0.5), depth, size, centre, **options)


def backward(scene, camera, **options):
    plain = {"defocus": True, "self_absorption": True}
    return render(scene, camera, effects=plain, **options).views.astype(float)


def weight_of_a_ray(layer, camera, rays):
    """What a ray adds to the pixel it meets, from the areas alone."""
    distance = camera.focus_distance_mm + layer.depth_mm
    aperture = camera.view_step_mm * camera.views + camera.lenslet_pitch_mm
    bundle = camera.lenslet_pitch_mm * camera.pixel_mm * distance / camera.lenslet_focal_mm
    return math.prod(layer.size_mm) * (aperture / bundle) ** 2 / rays


def misfit(counts, expected, rays):
    """How many standard deviations binomial counts are off: their total, and their chi-squared.

    Pixels that expect too few for a chi-squared count as one.
    """
    total = (counts.sum() - expected.sum()) / math.sqrt(expected.sum())
    few = expected <= 5
    counts, expected = (
        np.append(values[~few], values[few].sum() + 1e-9) for values in (counts, expected)
    )
    squares = (counts - expected) ** 2 / (expected * (1 - expected / rays))
    return max(abs(total), abs(squares.mean() - 1) / math.sqrt(2 / squares.size))


def count_rays(scene, layer, camera, rays, sequence="random"):
    """Rays that each pixel got from the only layer of the scene that glows."""
    weight = 0.8 * weight_of_a_ray(layer, camera, rays)
    return trace_forward(scene, camera, rays, sequence, seed=1) / weight, weight


@pytest.mark.jit
@pytest.mark.parametrize(
    ("depth", "changes"),
    [
        (20.0, {}),
        (0.0, {"views": 4}),
        (-60.0, {}),
        (-10.0, {"pixel_pitch_mm": 0.02}),
        (10.0, {"main_lens_focal_mm": 90.0}),
    ],
    ids=str,
)
def test_each_pixel_counts_as_many_rays_as_the_closed_form_says(small_camera, rng, depth, changes):
    """Orientation, slope, scale, and the mean over each bundle, within counting statistics."""
    camera, layer = replace(small_camera, **changes), two_tone(rng, depth)
    counts, weight = count_rays(Scene([layer]), layer, camera, RAYS)
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-3)
    expected = backward(Scene([layer]), camera) / weight
    assert expected.sum() > 2e4
    assert misfit(counts, expected, RAYS) < 4
    assert not counts[expected < 1e-9].any()


@pytest.mark.slow
@pytest.mark.jit
def test_the_count_would_notice_small_mistakes(small_camera, rng):
    """A 25th of a lenslet aside; slope 1 % off; 0.3 % too bright; bundles 1 % too narrow."""
    layer, rays = two_tone(rng, 20.0), 30_000_000
    counts, weight = count_rays(Scene([layer]), layer, small_camera, rays)
    assert misfit(counts, backward(Scene([layer]), small_camera) / weight, rays) < 4
    for wrong_layer, wrong_camera in (
        (replace(layer, centre_mm=(0.305, -0.2)), small_camera),
        (replace(layer, depth_mm=20.2), small_camera),
        (replace(layer, texture=layer.texture * 1.003), small_camera),
        (layer, replace(small_camera, lenslet_focal_mm=0.403)),
    ):
        expected = backward(Scene([wrong_layer]), wrong_camera) / weight
        assert misfit(counts, expected, rays) > 5


@pytest.mark.slow
@pytest.mark.jit
def test_half_covered_and_absorbing_layers_dim_alike(small_camera, rng):
    """Glow before and behind a half-open screen and a hot gas, to a thousandth of the peak."""
    screen = Layer(
        rng.random((4, 5)), 0.0, (1.5, 1.6), opaque=True, coverage=rng.random((4, 5))
    )  # fmt: skip
    gas = Layer(rng.random((5, 4)), -10.0, (2.0, 1.5), optical_thickness=rng.random((5, 4)))
    scene = Scene([two_tone(rng, 20.0), screen, gas])
    traced = backward(scene, small_camera, integrator="rays", rays=60)
    image = trace_forward(scene, small_camera, 2**24, "quasi")
    assert np.sqrt(np.mean((image - traced) ** 2)) < 4e-3 * traced.max()
    assert image.sum(dtype=float) == pytest.approx(traced.sum(), rel=2e-4)


@pytest.mark.slow
@pytest.mark.jit
def test_a_uniform_field_gives_its_brightness(small_camera):
    wide, rays = Layer([[0.8]], 15.0, (8.0, 9.0)), 10_000_000
    image = trace_forward(Scene([wide]), small_camera, rays)
    counts = image / (0.8 * weight_of_a_ray(wide, small_camera, rays))
    assert image.mean() == pytest.approx(0.8, rel=5 / math.sqrt(counts.sum()))
    evenly = 1 / weight_of_a_ray(wide, small_camera, rays)
    assert misfit(counts, np.full(image.shape, evenly), rays) < 4
    for axes in ((1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)):  # to the edges of view and field
        sums = counts.sum(axis=axes)
        np.testing.assert_allclose(sums, sums.mean(), rtol=5 / math.sqrt(sums.mean()))


@pytest.mark.slow
@pytest.mark.jit
def test_the_error_falls_as_the_theory_says(small_camera, rng):
    scene = Scene([two_tone(rng, 20.0)])
    exact = backward(scene, small_camera)
    errors = {
        sequence: [
            np.sqrt(np.mean((trace_forward(scene, small_camera, n, sequence) - exact) ** 2))
            for n in (2**16, 2**18, 2**20, 2**22)
        ]
        for sequence in ("random", "quasi")
    }
    for coarse, fine in zip(errors["random"][:-1], errors["random"][1:], strict=True):
        assert fine / coarse == pytest.approx(0.5, rel=0.05)
    assert errors["quasi"][-1] / errors["quasi"][0] < (2**6) ** -0.6
    assert errors["quasi"][-1] < errors["random"][-1] / 3


def test_same_seed_same_bits(small_camera, rng):
    scene = Scene([two_tone(rng, 20.0), two_tone(rng, -10.0)])
    for sequence in ("random", "quasi"):
        one, same, other = (
            trace_forward(scene, small_camera, 5000, sequence, seed=s) for s in (3, 3, 4)
        )
        np.testing.assert_array_equal(one, same)
        assert np.any(one != other)
        assert one.dtype == np.float32
        assert one.shape == (5, 5, 24, 30)


@pytest.mark.parametrize("sequence", ["random", "quasi"])
def test_numbers_are_uniform_and_chunks_go_on(monkeypatch, sequence):
    def draw():
        return np.concatenate(list(forward._draw(np.random.default_rng(2), 1000, sequence)))

    whole = draw()
    monkeypatch.setattr(forward, "CHUNK", 300)
    np.testing.assert_allclose(draw(), whole, atol=1e-12)
    assert whole.min() >= 0
    assert whole.max() < 1
    for column in whole.T:
        np.testing.assert_allclose(np.histogram(column, 10, (0, 1))[0], 100, atol=40)


@pytest.mark.parametrize(("height", "pixel"), [(0.31, 6), (-0.31, 2), (0.02, 4)])
def test_a_ray_behind_a_lenslet_goes_on_by_its_matrix(height, pixel):
    """A ray along the axis has come half as near to it at half the focal length.

    Of one lenslet of 1 mm; nine pixels of 0.1 mm.
    """
    halfway = np.array([[0.5, 5.0], [-0.1, 0.5]])  # a lens of 10 mm, and 5 mm behind it
    found = forward.catch(height, 0.0, (-np.eye(2), halfway), (1.0, 1.0, 0.1), 1, 9)
    assert found == (0, pixel)


@pytest.mark.jit
def test_the_compiled_kernel_equals_its_python(small_camera, rng, monkeypatch):
    card = Layer([[0.0]], -10.0, (1.0, 1.0), (0.2, 0.1), opaque=True)
    scene = Scene([two_tone(rng, 20.0), card])
    compiled = trace_forward(scene, small_camera, 3000)
    for name in ("splat", "catch", "passes"):
        monkeypatch.setattr(forward, name, getattr(forward, name).py_func)
    np.testing.assert_array_equal(compiled, trace_forward(scene, small_camera, 3000))


def test_a_dark_scene_is_dark(small_camera):
    dark = Scene([Layer([[0.0]], 0.0, (1.0, 1.0))])
    assert not trace_forward(dark, small_camera, 100).any()


@pytest.mark.parametrize(
    ("layer", "options", "message"),
    [
        (Layer([[1.0]], 0.0, (1.0, 1.0)), {"rays": 0}, "rays must be at least 1"),
        (Layer([[1.0]], 0.0, (1.0, 1.0)), {"rays": 9, "sequence": "sobol"}, "got 9 and 'sobol'"),
        (Layer([[1.0]], 0.0, (1.0, 1.0), thickness_mm=2.0), {"rays": 9}, "got a thick one"),
        (Layer([[0.0]], -400.0, (1.0, 1.0)), {"rays": 9}, "in front of the main lens"),
    ],
)
def test_what_cannot_be_traced_is_refused(small_camera, layer, options, message):
    with pytest.raises(InputError, match=message):
        trace_forward(Scene([layer]), small_camera, **options)
