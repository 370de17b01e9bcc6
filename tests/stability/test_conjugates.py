"""Conjugates at the focal length, at infinity and beyond it, and long chains of matrices.

Truth is rational arithmetic on the same float64 inputs. Each test also runs the formula that a
textbook would suggest, `naive` here, and shows that it fails what ours passes.
"""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from lf_flame import PAPER_CAMERA
from lf_flame.optics.ray_transfer import chain, free_space, thin_lens

UNIT = 2.0**-53
"""Unit roundoff of float64."""

STABLE, UNSTABLE = 310.0, 700.0
"""Spacings of lenses of 150 mm: |A + D| of a period is below 2, and above it."""

as_exact = np.frompyfunc(Fraction, 1, 1)


def build(elements):
    """Matrix of a path of ("space", d) and ("lens", f), as the package makes it."""
    return chain(*(free_space(x) if kind == "space" else thin_lens(x) for kind, x in elements))


def exact(elements):
    """The same matrix in rational arithmetic."""
    system = as_exact(np.eye(2))
    for kind, length in elements:
        element = as_exact(np.eye(2))
        if kind == "space":
            element[0, 1] = Fraction(length)
        elif np.isfinite(length):
            element[1, 0] = -1 / Fraction(length)
        system = element @ system
    return system


def rounding(elements):
    """Bound of the rounding of any product: unit roundoffs of the path with all signs dropped."""
    dropped = [(kind, abs(x) if kind == "space" else -abs(x)) for kind, x in elements]
    return 4 * len(elements) * UNIT * build(dropped)


def errors(system, truth):
    """Entries of a float matrix less the true ones; NaN and infinity stay what they are."""
    found = np.array(system, dtype=float)
    for index in zip(*np.nonzero(np.isfinite(found)), strict=True):
        found[index] = abs(float(Fraction(found[index]) - truth[index]))
    return found


def relative_error(system, truth):
    """Largest error of an entry, lengths measured in focal lengths of 150 mm."""
    scale = np.array([[1, 1 / 150], [150, 1]])
    return (errors(system, truth) * scale).max() / np.abs(truth * scale).max()


def determinant(system):
    """AD - BC, and |AD| + |BC|, whose rounding it carries."""
    (a, b), (c, d) = system
    return a * d - b * c, abs(a * d) + abs(b * c)


def textbook_image(focal, distance):
    """Image distance ``a f / (a - f)``: the naive formula of most tests here."""
    with np.errstate(all="ignore"):
        return np.float64(distance) * focal / (np.float64(distance) - focal)


class ExactCamera:
    """The conversions of a camera from the thin-lens equation, in rational arithmetic."""

    def __init__(self, camera):
        self.f, self.a0 = Fraction(camera.main_lens_focal_mm), Fraction(camera.focus_distance_mm)
        self.i0 = 1 / (1 / self.f - 1 / self.a0)
        lenslet = Fraction(camera.lenslet_focal_mm)
        self.step = (self.i0 / lenslet + 1) / camera.views  # view step over lenslet pitch

    def slope(self, depth):
        vergence = 0 if np.isinf(depth) else 1 / (self.a0 + Fraction(depth))
        return self.step * (self.i0 * (1 / self.f - vergence) - 1)

    def vergence(self, slope):
        """Reciprocal of the object distance: 0 at infinity, negative for a virtual object."""
        return 1 / self.f - (1 + Fraction(slope) / self.step) / self.i0


def test_alpha_goes_through_infinity_where_the_object_is_at_the_focal_length():
    """1 / alpha is what stays finite. Naive: depth by the thin-lens equation from ``alpha i0``."""
    camera, truth, allowed = PAPER_CAMERA, ExactCamera(PAPER_CAMERA), 16 * UNIT
    f, a0 = camera.main_lens_focal_mm, camera.focus_distance_mm
    for distance in (f * (1 - 1e-12), f, f * (1 + 1e-12), a0, 1e300, np.inf):
        slope = camera.depth_to_slope(distance - a0)
        alpha = camera.slope_to_alpha(slope)
        found = 0 if np.isinf(alpha) else 1 / Fraction(alpha)
        assert abs(found - 1 - truth.slope(distance - a0) / truth.step) <= allowed
        assert camera.alpha_to_slope(alpha) == pytest.approx(slope, rel=allowed, abs=allowed)
    depth = camera.slope_to_depth(camera.alpha_to_slope(np.inf))
    assert depth == pytest.approx(f - a0, rel=allowed)
    naive = textbook_image(f, np.inf * camera.image_distance_mm) - a0
    assert np.isnan(naive)


def test_depth_comes_back_from_the_slope_through_infinity_into_the_virtual():
    """Far out the reciprocal of the distance is compared: 0 at infinity, negative beyond it."""
    camera, truth, allowed = PAPER_CAMERA, ExactCamera(PAPER_CAMERA), 16 * UNIT
    a0, infinity = camera.focus_distance_mm, camera.depth_to_slope(np.inf)
    for part in (-0.5, 0.5, 1 - 1e-12, 1, 1 + 1e-12, 1.5, 3, 30):
        depth = camera.slope_to_depth(part * infinity)
        found = 0 if np.isinf(depth) else 1 / (Fraction(a0) + Fraction(depth))
        # the depth itself is a float64: near the lens that is what limits its reciprocal
        assert abs(found - truth.vergence(part * infinity)) <= allowed * max(1, part**2) / a0
        assert part == 1 or (depth < -a0) == (part > 1)


@pytest.mark.parametrize("lengths", [(0.1, 0.2), (33.0, 77.0), (12.7, 25.4)])
def test_afocal_is_a_matter_of_size_and_not_of_equality(lengths):
    """C of a telescope is 0 relative to its terms. Naive: ``C == 0``, else the focus is -1 / C."""
    f1, f2 = lengths
    path = [("lens", f1), ("space", f1 + f2), ("lens", f2)]
    power = build(path)[1, 0]
    assert abs(power) <= rounding(path)[1, 0]
    naive = np.inf if power == 0 else -1 / power
    assert np.isfinite(naive)


@pytest.mark.parametrize("spacing", [STABLE, UNSTABLE])
def test_a_hundred_elements_are_right_and_their_determinant_1_relative_to_its_terms(spacing):
    """Naive: ``abs(det - 1) < 1e-5`` refuses the unstable chain, a legal system."""
    path = [("space", spacing), ("lens", 150.0)] * 50
    allowed, (det, terms) = 4 * len(path) * UNIT, determinant(build(path))
    assert relative_error(build(path), exact(path)) <= allowed
    assert abs(det - 1) <= allowed * terms
    naive_passes = abs(det - 1) < 1e-5
    assert naive_passes == (spacing == STABLE)


def test_relative_determinant_still_finds_a_faulty_element():
    """One entry off by 1e-9 in a hundred elements. Naive: ``abs(det - 1) < 1e-5`` passes it."""
    relay = [("space", STABLE), ("lens", 150.0)]
    faulty = free_space(STABLE) * np.array([[1, 1], [1, 1 + 1e-9]])
    det, terms = determinant(chain(build(relay * 25), faulty, build(relay * 24)))
    assert abs(det - 1) > 1e3 * 100 * 4 * UNIT * terms
    assert abs(det - 1) < 1e-5


def test_matrices_in_other_units_are_similar():
    """B scales with the unit and C against it; A, D, the determinant and the slope stay.

    Naive: absolute bounds, ``abs(C) < 1e-5`` for "no power" and ``abs(B) < 1e-5`` for "imaging".
    One and the same lens, 10 um out of focus, has no power in um and is in focus in m.
    """
    depth, no_power, imaging = 0.01, {}, {}
    for unit, scale in (("mm", 1.0), ("um", 1e3), ("m", 1e-3)):
        camera = in_unit(PAPER_CAMERA, scale)
        system = camera.object_to_array(depth * scale)
        similar = PAPER_CAMERA.object_to_array(depth) * [[1, scale], [1 / scale, 1]]
        path = [("space", 326.0 * scale), ("lens", 150.0 * scale), ("space", 278.0 * scale)]
        assert np.all(abs(system - similar) <= rounding(path))
        slope = camera.depth_to_slope(depth * scale)
        assert slope == pytest.approx(PAPER_CAMERA.depth_to_slope(depth), rel=16 * UNIT)
        no_power[unit], imaging[unit] = abs(system[1, 0]) < 1e-5, abs(system[0, 1]) < 1e-5
    assert no_power == {"mm": False, "um": True, "m": False}
    assert imaging == {"mm": False, "um": False, "m": True}


def in_unit(camera, scale):
    names = ("main_lens_focal_mm", "focus_distance_mm", "lenslet_focal_mm", "lenslet_pitch_mm")
    return replace(camera, **{name: getattr(camera, name) * scale for name in names})


def test_a_unit_that_is_a_power_of_two_changes_no_digit():
    """Naive: "in focus where the image is within 1e-6 of the array" depends on the unit."""
    unit = 2.0**20
    other = in_unit(PAPER_CAMERA, unit)
    assert other.depth_to_slope(20.0 * unit) == PAPER_CAMERA.depth_to_slope(20.0)
    assert other.slope_to_depth(2.1) == PAPER_CAMERA.slope_to_depth(2.1) * unit
    naive = [
        abs(textbook_image(150.0 * u, (326.0 + 1e-6) * u) - camera.image_distance_mm) < 1e-6
        for u, camera in ((1.0, PAPER_CAMERA), (unit, other))
    ]
    assert naive == [True, False]


def test_a_lens_of_infinite_focal_length_is_not_there():
    """Naive: its image, which is the object itself, is infinity over infinity away."""
    path = [("space", 326.0), ("lens", np.inf), ("space", 277.0)]
    np.testing.assert_array_equal(build(path), free_space(326.0 + 277.0))
    assert np.all(errors(build(path), exact(path)) == 0)
    naive = textbook_image(np.inf, 326.0)
    assert np.isnan(naive)
