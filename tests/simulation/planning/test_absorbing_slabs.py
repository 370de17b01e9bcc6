"""Thick layers that absorb, against radiative transfer integrated along rays."""

from dataclasses import replace
from itertools import pairwise, permutations

import numpy as np
import pytest

from lf_flame import PAPER_CAMERA, Layer, Scene, plan_effects, render
from lf_flame.simulation.planning.absorbing_slabs import AbsorbingSlabs, MatterSteps, _arriving
from lf_flame.simulation.planning.scene_bounds import bound_scene
from lf_flame.simulation.slabs import slab_edges, slice_scene

CAMERA = replace(PAPER_CAMERA, views=5, lenslets=(12, 14))
SQUARED = np.square(np.mgrid[-1:1:40j, -1:1:40j]).sum(axis=0)
FLAME = np.exp(-4 * SQUARED)
STEPS = 2000
"""Of the integration through a layer."""


def thick(texture, tau=50.0, size=1.0, depth=5.0, thickness=3.0):
    return Layer(texture, depth, (size, size), optical_thickness=tau, thickness_mm=thickness)


NOISE = np.random.default_rng(3).random((12, 12))
LAYERS = {
    "block": thick([[1.0]]),
    "block of cells": thick(np.ones((30, 30))),
    "flame": thick(FLAME, 50 * FLAME),
    "patchy flame": thick(NOISE**4, 50 * NOISE**4),
    "picture in haze": thick(NOISE),
    "clear in part": thick(NOISE, 50 * (NOISE > 0.5)),
    "thin flame": thick(FLAME, 0.5 * FLAME),
    "smoke": thick(np.zeros((40, 40)), 20 * FLAME),
}


def heights(camera, axis, pixel, depths, n=5):
    """Heights of a pixel's rays over some depths, (rays, depths), by the lenses' equations."""
    view, lenslet = pixel[axis], pixel[2 + axis]
    distance, focal = camera.image_distance_mm, camera.lenslet_focal_mm
    centre = -(lenslet - (camera.lenslets[axis] - 1) / 2) * camera.lenslet_pitch_mm
    chief = centre * (1 + focal / distance)
    places = (np.arange(n) + 0.5) / n - 0.5
    on_lenslet, on_pixel = (x.ravel() for x in np.meshgrid(places, places))
    at_lenslet = centre + on_lenslet * camera.lenslet_pitch_mm
    on_pixel = chief - (view - (camera.views - 1) / 2 + on_pixel) * camera.pixel_mm
    behind = (on_pixel - centre) / focal  # a lenslet's focal plane shows angles
    at_lens = at_lenslet - distance * behind
    before = behind + at_lens / camera.main_lens_focal_mm
    far = camera.focus_distance_mm + np.asarray(depths)
    return -(at_lens[:, None] - before[:, None] * far)


def cell_indices(layer, camera, axis, pixel, depths):
    places = heights(camera, axis, pixel, depths) - layer.centre_mm[axis] + layer.size_mm[axis] / 2
    cells = layer.texture.shape[axis]
    index = np.floor(places / layer.size_mm[axis] * cells).astype(int)
    return np.where((index < 0) | (index >= cells), cells, index)


def emerging(layer, camera, pixel, depths, emission, dimming, behind):
    """Mean over all rays of what emerges from sheets, front to back; dimming: their -log."""
    rows, columns = (cell_indices(layer, camera, a, pixel, depths) for a in (0, 1))
    total = np.zeros((len(rows), len(columns)))
    passed = np.zeros_like(total)
    for i in range(len(depths)):
        at = np.ix_(rows[:, i], columns[:, i])
        light, lost = (np.pad(x[i] if x.ndim == 3 else x, (0, 1))[at] for x in (emission, dimming))
        total += light * np.exp(-passed)
        passed += lost
    return (total + behind * np.exp(-passed)).mean()


def integrated(layer, camera, pixel, behind=0.0):
    """Emission times the transmission of all before it, in thin steps of equal depth."""
    places = (np.arange(STEPS) + 0.5) / STEPS - 0.5
    depths = layer.depth_mm + layer.thickness_mm * places
    tau = layer.optical_thickness / STEPS
    emission = layer.texture / STEPS * np.exp(-tau / 2)
    return emerging(layer, camera, pixel, depths, emission, tau, behind)


def sliced(layer, camera, pixel, slabs, behind=0.0):
    dimming = {"self_absorption"}
    planes = slice_scene(Scene([layer]), {layer: slabs}, absorption=True, dimming=dimming)
    assert len(planes) == slabs
    depths = [plane.depth_mm for plane in planes]
    assert depths == sorted(depths)
    emission = np.array([plane.emission for plane in planes])
    lost = np.array([-np.log(np.maximum(plane.transmission, 1e-300)) for plane in planes])
    return emerging(layer, camera, pixel, depths, emission, lost, behind)


PIXELS = [(4, 4, 5, 9), (0, 4, 3, 9), (0, 4, 6, 9), (0, 0, 3, 4)]


def test_slabs_of_a_clear_layer_are_equal():
    np.testing.assert_array_equal(slab_edges(thick(FLAME, 0.0), 12), np.arange(13) / 12)


@pytest.mark.parametrize("tau", [1e-9, 0.3, 50.0, 1e5])
def test_slabs_crowd_at_the_faces_as_they_say(tau):
    """The edges come back by the integral of their density, taken numerically."""
    edges = slab_edges(thick(FLAME, tau * FLAME), 24)
    assert (edges[0], edges[12], edges[-1]) == (0, 0.5, 1)
    np.testing.assert_allclose(edges + edges[::-1], 1, atol=1e-15)
    depths = np.concatenate([np.geomspace(1e-12, 0.5, 200_000)])
    thickest = tau * FLAME.max()
    crowded = np.exp(-thickest * depths / 2)
    share = np.cumsum((crowded[1:] + crowded[:-1]) / 2 * np.diff(depths))
    found = np.interp(edges[1:12], depths[1:], (depths[1:] + share / share[-1] / 2) / 2)
    np.testing.assert_allclose(found, np.arange(1, 12) / 24, rtol=1e-6)


@pytest.mark.parametrize("behind", [0.0, pytest.param(1.0, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", LAYERS)
def test_slabs_err_by_no_more_than_their_bound(name, behind):
    """At pixels that look past the borders of the layers, from the side."""
    layer = LAYERS[name]
    scene = [layer, *([Layer([[1.0]], 25.0, (9.0, 9.0))] if behind else [])]
    bound = AbsorbingSlabs(bound_scene(Scene(scene), CAMERA), layer).change
    for pixel in PIXELS[::2] if behind else PIXELS[1::2]:
        truth = integrated(layer, CAMERA, pixel, behind)
        for slabs in (4, 16):
            assert abs(sliced(layer, CAMERA, pixel, slabs, behind) - truth) <= bound(slabs)
    assert bound(256) <= bound(128) / 3  # the second order


@pytest.mark.parametrize("edges", [[0, 0.1, 0.9, 1], [0, 0.2, 0.3, 0.6, 1]])
def test_what_a_border_changes_fades_as_a_ray_through_it_does(edges):
    """A ray crosses the border somewhere in a slab, from the thin side or from the thick one."""
    least, most, edges = 3.0, 8.0, np.array(edges)
    one = np.ones((1, 1))

    def both(shown, passed):
        steps = MatterSteps(shown * one, passed * one, least * one, most * one, most * one)
        return float(steps.at_edges(edges).max()), float(steps.inside(edges).max())

    whole, part, widths = [], [], np.diff(edges)
    for low, high in pairwise(edges):
        ways = np.linspace(low, high, 1001)  # to the border, of the whole way
        orders = [a * ways + b * (1 - ways) for a, b in permutations((least, most))]
        whole.append(np.exp(-np.min(orders)))  # passes all matter
        part.append(np.exp(-least * low))  # comes from the border to the front
    fading = widths**2 * np.minimum(1, most * widths)
    expected = np.max(widths**2 * part), np.sum(fading * part)
    assert both(shown=1, passed=0) == pytest.approx(expected, rel=1e-9)
    expected = np.max(widths**2 * whole), np.sum(fading * whole)
    assert both(shown=0, passed=1) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("near", [(0, 0), (2, 1), (1, 3)])
def test_radiances_that_arrive_are_those_of_the_cells_around(near, rng):
    """Sources between those of all cells so near; more, where one of them glows and is clear."""
    emission, tau = rng.random((9, 11)), rng.uniform(0.5, 5, (9, 11))
    tau[:, 8:] = 0
    emission[:, 9:] = 0
    emission[:4, 8] = 0  # nothing; below it, clear glow
    low, high, through = _arriving(emission, tau, near, 0.4)
    for i, j in np.ndindex(emission.shape):
        around = (slice(max(i - near[0], 0), i + near[0] + 1),
                  slice(max(j - near[1], 0), j + near[1] + 1))  # fmt: skip
        light, matter = emission[around].ravel(), tau[around].ravel()
        sources = light[matter > 0] / matter[matter > 0]
        least, most = (sources.min(), sources.max()) if sources.size else (0, 0)
        if np.any(light[matter == 0] > 0):
            least, most = 0, 0.4 + emission.max()
        assert (low[i, j], high[i, j]) == pytest.approx((least, most), rel=1e-12)
        assert through[i, j] == max(high[i, j], 0.4)


@pytest.mark.parametrize("tolerance", [1e-2, pytest.param(1e-3, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ["block", "block of cells", "flame"])
def test_a_strongly_absorbing_layer_is_planned(name, tolerance):
    """Optical depth 50 over 3 mm, and at pixels of its rim the slabs are as good as asked for."""
    layer = LAYERS[name]
    plan = plan_effects(Scene([layer]), CAMERA, tolerance)
    assert plan.integrator == "rays"
    peak = 1 / 50
    for pixel in PIXELS[:2]:
        truth = integrated(layer, CAMERA, pixel)
        assert 0.01 * peak < truth <= peak
        error = abs(sliced(layer, CAMERA, pixel, plan.slabs[0]) - truth)
        assert error <= tolerance * peak / 3  # an eighth, and of these single rays


@pytest.mark.slow
def test_a_strongly_absorbing_flame_is_rendered():
    """Before a picture, against rays by the lenses' equations through both."""
    camera = replace(PAPER_CAMERA, views=3, lenslets=(5, 5))
    flame = thick(FLAME[::4, ::4], 50 * FLAME[::4, ::4], size=0.5, thickness=1.5)
    scene, tolerance = Scene([flame, Layer([[0.03]], 25.0, (9.0, 9.0))]), 0.05
    plan = plan_effects(scene, camera, tolerance)
    found = render(scene, camera, tolerance).views
    pixels = [(0, 0, 1, 2), (2, 0, 3, 4), (1, 1, 2, 2), (0, 2, 4, 0), (2, 2, 3, 0)]
    truth = np.array([integrated(flame, camera, pixel, 0.03) for pixel in pixels])
    assert plan.slabs[0] < 200
    assert np.ptp(truth) > 0.1 * truth.max()
    np.testing.assert_allclose([found[p] for p in pixels], truth, atol=0.03 * found.max())
