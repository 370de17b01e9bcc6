"""Diffraction at the main lens, on lenslets far wider than its pattern."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import special

from lf_flame import PAPER_CAMERA, Layer, Scene, render
from lf_flame.simulation.diffraction import blur_layer, blur_whole_lenslets, main_lens_share_leaving

CAMERA = replace(PAPER_CAMERA, views=3, lenslets=(16, 18), wavelength_nm=3000.0)
ONLY = {"main_lens_diffraction": True, "lenslet_diffraction": False}
ROUND = {"aperture_diameter_mm": CAMERA.aperture_mm}


def both(scene, camera, tolerance=1e-4):
    """Views with the main lens's diffraction and without."""
    return (
        render(scene, camera, tolerance, effects=ONLY | {"main_lens_diffraction": on}).views[1, 1]
        for on in (True, False)
    )


def share_beyond(spreads, round_aperture):
    """Light beyond a line: ``1 - 2 integral of T(f) sin(2 pi f t) / (pi f)``, T the transfer."""
    x, weight = special.roots_legendre(1000)
    q = (1 + x) / 2
    passed = 2 / np.pi * (np.arccos(q) - q * np.sqrt(1 - q**2)) if round_aperture else 1 - q
    return 1 - np.sin(2 * np.pi * q * spreads[..., None]) / (np.pi * q) @ (passed * weight)


@pytest.mark.slow
@pytest.mark.parametrize(("aperture", "shift"), [({}, 0.3), (ROUND, 0.0)], ids=["square", "round"])
def test_an_edge_in_the_focal_plane_bleeds_by_the_share_thrown_beyond_it(aperture, shift):
    """Along an edge inside a lenslet, anywhere: the pattern's integral from each point of it."""
    camera = replace(CAMERA, **aperture)
    forced = {"round_aperture": False, "f_number_mismatch": False} if aperture else {}
    pitch = camera.field_mm(0)[1] / 18  # of the lenslets, on the focal plane
    scene = Scene([Layer([[1.0]], 0.0, (100 * pitch, 100 * pitch), (0.0, (50 + shift) * pitch))])
    found = render(scene, camera, 1e-4, effects=ONLY | forced).views[1, 1, 8]
    # In lenslets from the edge; a point is lit by all that is thrown that far, from one side.
    places = np.arange(18)[:, None] - 8.5 - shift + (np.arange(400) + 0.5) / 400 - 0.5
    # The aperture is as wide beside its distance as a lenslet beside its focal length.
    spread = 0.003 * 0.4 / 0.112 / camera.lenslet_pitch_mm
    thrown = share_beyond(np.abs(places) / spread, bool(aperture))
    lit = np.where(places > 0, 1 - thrown / 2, thrown / 2).mean(axis=1)
    np.testing.assert_allclose(found, lit, atol=6e-4)


def test_light_from_beyond_the_field_comes_in(rng):
    """As of a layer that ends where the field does, and of one that goes on."""
    height, width = CAMERA.field_mm(0.0)
    inside, outside = (Layer(np.ones((1, 1)), 0.0, (height * k, width * k)) for k in (1.0, 3.0))
    ends, goes_on = (next(both(Scene([layer]), CAMERA)) for layer in (inside, outside))
    np.testing.assert_allclose(goes_on, 1, atol=2e-3)
    assert np.all(ends[0] < 0.98)
    # Of two neighbours beyond an edge one throws back what the other lost.
    dark = main_lens_share_leaving(replace(CAMERA, lenslets=(1, 1)))
    assert 1 - ends[8, 0] < dark


@pytest.mark.parametrize("changes", [ROUND, {"layout": "hexagonal"}], ids=["rays", "hexagonal"])
def test_the_rim_of_an_even_field_is_as_bright(changes):
    camera = replace(CAMERA, lenslets=(6, 7), wavelength_nm=550.0, **changes)
    found = render(Scene([Layer([[1.0]], 0.0, (30.0, 30.0))]), camera, effects=ONLY).views
    np.testing.assert_allclose(found[1, 1], 1, atol=5e-3)


def test_a_leaning_layer_still_shines_equally_in_all_directions():
    scene = Scene([Layer([[1.0]], 2.0, (8.0, 8.0), tilt_deg=(60, 0))])
    found = render(scene, replace(CAMERA, lenslets=(4, 4)), effects=ONLY).views
    np.testing.assert_allclose(found, 1, atol=5e-3)


def test_views_of_a_hexagonal_array_are_blurred_on_their_own_grid(rng):
    """As those of square lenslets with the same distances, behind the same aperture."""
    hexagonal = replace(CAMERA, layout="hexagonal", **ROUND)
    square = replace(CAMERA, lenslet_pitch_mm=hexagonal.grid_pitch_mm, **ROUND)
    views = rng.random((1, 1, 16, 18)).astype(np.float32)
    found, expected = (blur_whole_lenslets(views, camera) for camera in (hexagonal, square))
    np.testing.assert_allclose(found, expected, atol=1e-5)
    assert main_lens_share_leaving(hexagonal) == pytest.approx(main_lens_share_leaving(square))


@pytest.mark.parametrize("size", [(0.02, 0.02), (30.0, 0.5)])
@pytest.mark.parametrize("cells", [(1, 1), (40, 3)])
def test_all_light_is_kept_on_any_cells(rng, size, cells):
    layer = Layer(rng.random(cells), 5.0, size)
    blurred = blur_layer(layer, layer.texture, replace(CAMERA, lenslets=(650, 650)), 5.0)
    light = [
        one.texture.sum() * np.prod(one.size_mm) / one.texture.size for one in (layer, blurred)
    ]
    assert light[1] == pytest.approx(light[0], rel=5e-3)
    y, x = (
        blurred.texture.sum(axis=1 - axis)
        @ np.convolve(blurred.cell_edges_mm[axis], [0.5, 0.5], "valid")
        / blurred.texture.sum()
        for axis in (0, 1)
    )
    given = [
        layer.texture.sum(axis=1 - axis)
        @ np.convolve(layer.cell_edges_mm[axis], [0.5, 0.5], "valid")
        / layer.texture.sum()
        for axis in (0, 1)
    ]
    np.testing.assert_allclose([y, x], given, atol=5e-3)


@pytest.mark.parametrize("nm", [1e-9, pytest.param(1e4, marks=pytest.mark.slow)])
def test_hard_cases_stay_light(rng, nm, monkeypatch):
    """Patterns far smaller than a cell, and far wider than the field; cells of any size."""
    monkeypatch.setattr("lf_flame.simulation.diffraction.MOST_DARK", 128)  # cells, of 2048
    camera = replace(CAMERA, lenslets=(4, 5), wavelength_nm=nm, aperture_diameter_mm=0.5)
    for size in ((1e-3, 1e-3), (300.0, 200.0)):
        layer = Layer(rng.random((7, 9)), 3.0, size)
        blurred = blur_layer(layer, layer.texture, camera, 3.0)
        assert np.isfinite(blurred.texture).all()
        assert 0 <= blurred.texture.min() <= blurred.texture.max() <= layer.texture.max() + 1e-9
        assert blurred.texture.size < 2**25
