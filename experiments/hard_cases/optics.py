"""Conjugates at the focal length and at infinity, long chains, and bundles of any width."""

from fractions import Fraction
from functools import reduce

import numpy as np

from experiments.hard_cases.report import UNIT, Values, as_exact, hard_case
from lf_flame.optics.camera import PAPER_CAMERA
from lf_flame.optics.ray_bundle import chain, free_space, inverse, thin_lens, trace_footprint
from lf_flame.simulation.integration import trapezoid_cdf

CAMERA = PAPER_CAMERA
F, A0, I0 = CAMERA.main_lens_focal_mm, CAMERA.focus_distance_mm, CAMERA.image_distance_mm
DISTANCES = (1e-9, 1.0, F * (1 - 1e-12), F, F * (1 + 1e-12), 1e9, 1e300, np.inf)

# The camera in rational arithmetic, by the thin-lens equation.
EXACT_F, EXACT_A0 = Fraction(F), Fraction(A0)
EXACT_I0 = 1 / (1 / EXACT_F - 1 / EXACT_A0)
PITCH, LENSLET_F = Fraction(CAMERA.lenslet_pitch_mm), Fraction(CAMERA.lenslet_focal_mm)
STEP = (EXACT_I0 / LENSLET_F + 1) / CAMERA.views
"""View step over lenslet pitch."""


def exact_slope(depth: float) -> Fraction:
    """Slope of an object."""
    vergence = 0 if np.isinf(depth) else 1 / (EXACT_A0 + Fraction(depth))
    return STEP * (EXACT_I0 * (1 / EXACT_F - vergence) - 1)


def exact_vergence(slope: float) -> Fraction:
    """Reciprocal of the object distance: 0 at infinity, negative for a virtual object."""
    return 1 / EXACT_F - (1 + Fraction(slope) / STEP) / EXACT_I0


def textbook_image(focal: float, distance: float) -> np.float64:
    """Image distance by the thin-lens equation as textbooks solve it."""
    return np.float64(distance) * focal / (np.float64(distance) - focal)


def naive_slope(distance: float) -> np.float64:
    """Slope of an object by way of its image distance."""
    return CAMERA.view_step_mm / CAMERA.lenslet_pitch_mm * (I0 / textbook_image(F, distance) - 1)


@hard_case(
    "slope of an object at f(1 - 1e-12), at f, at infinity, and 1e-12 mm off focus",
    "image distance a f/(a - f)",
    "1/a0 - 1/(a0 + z)",
    16 * UNIT,
)
def conjugates() -> Values:
    depths = np.array([*(a - A0 for a in DISTANCES), -1e-6, 1e-12, 1e-9])
    exact = np.array([exact_slope(z) for z in depths])
    return Values(exact, [naive_slope(A0 + z) for z in depths], CAMERA.depth_to_slope(depths))


@hard_case("depth of a small slope", "i f/(i - f) - a0", "difference of reciprocals", 16 * UNIT)
def depth_of_slope() -> Values:
    slopes = (1e-12, -1e-9, 1e-6)
    exact = np.array([1 / exact_vergence(slope) - EXACT_A0 for slope in slopes])
    obvious = [textbook_image(F, I0 / (1 + slope / float(STEP))) - A0 for slope in slopes]
    return Values(exact, obvious, CAMERA.slope_to_depth(slopes))


@hard_case(
    "1/distance of slopes beyond that of infinity: virtual objects",
    "i f/(i - f)",
    "difference of reciprocals",
    16 * UNIT,
)
def beyond_infinity() -> Values:
    infinity = CAMERA.depth_to_slope(np.inf)
    slopes = [part * infinity for part in (-0.5, 0.5, 1 - 1e-12, 1, 1 + 1e-12, 1.5, 3, 30)]
    slopes.append(-float(STEP))  # an object at the focal length: its image is at infinity
    exact = np.array([A0 * exact_vergence(slope) for slope in slopes])
    ours = [A0 / (A0 + CAMERA.slope_to_depth(slope)) for slope in slopes]
    obvious = [A0 / textbook_image(F, I0 / (1 + slope / np.float64(STEP))) for slope in slopes]
    return Values(exact, obvious, ours, scale=max(abs(exact)))


@hard_case(
    "100 elements of an unstable chain, there and back",
    "divide by the determinant",
    "swap and negate: the determinant is 1",
    400 * UNIT,
)
def a_hundred_elements() -> Values:
    path = [free_space(700.0), thin_lens(150.0)] * 50
    (a, b), (c, d) = exact = reduce(lambda system, one: as_exact(one) @ system, path)
    system = chain(*path)
    determinant = system[0, 0] * system[1, 1] - system[0, 1] * system[1, 0]
    both = np.array([exact, [[d, -b], [-c, a]]])
    ours = np.array([system, inverse(system)])
    return Values(both, ours / determinant, ours)


def exact_bundle(depth: float, view: int, lenslet: int) -> tuple:
    """Centre, lenslet width and pixel width of a bundle on a layer by similar triangles, in mm.

    The ray through height y of the array and h of the main lens crosses the focal plane at
    ``-y a0 / i0``, the conjugate of y, and continues straight to the layer.
    """

    def on_layer(y, h):
        focused = y * EXACT_A0 / EXACT_I0
        return -focused - (focused + h) * Fraction(depth) / EXACT_A0

    y = (lenslet - Fraction(CAMERA.lenslets[0] - 1, 2)) * PITCH
    h = (view - Fraction(CAMERA.views - 1, 2)) * STEP * PITCH
    return -on_layer(y, -h), on_layer(PITCH, PITCH), on_layer(0, -STEP * PITCH)


@hard_case(
    "centres and widths of ray bundles, near the lens, at f, in focus, far away",
    "blur (i0 - i)/i, carried back by a/i0",
    "one product of matrices",
    8 * UNIT,
)
def bundles() -> Values:
    exact, obvious, ours = [], [], []
    focused = [z * 10.0**k for z in (-1, 0, 1) for k in (-9, -6, -3, 0, 2)]
    for depth in [*focused, 1e9, *(a - A0 for a in (1e-6, *DISTANCES[2:5]))]:
        found = trace_footprint(CAMERA, depth, 0)
        i = textbook_image(F, A0 + depth)
        blur = CAMERA.view_step_mm * (I0 - i) / i * (A0 + depth) / I0
        # Heights and tilts reach the layer over the sum of all distances, however signed.
        path = A0 + depth + I0 + (A0 + depth) * I0 / F
        scale = path * (CAMERA.field_mm(0)[0] + CAMERA.aperture_mm) / I0
        for place in ((0, 269), (7, 100)):
            widths = found.lenslet_width_mm, found.pixel_width_mm
            exact += [x / Fraction(scale) for x in exact_bundle(depth, *place)]
            ours += [x / scale for x in (found.centres_mm[place], *widths)]
            obvious += [x / scale for x in (found.centres_mm[place], widths[0], blur)]
    return Values(np.array(exact), obvious, ours, scale=1.0)


def ramps(x, wide, narrow):
    """Trapezoid's cumulative distribution as four ramps."""
    outer, inner = (wide + narrow) / 2, (wide - narrow) / 2
    signed = ((1, outer), (-1, inner), (-1, -inner), (1, -outer))
    return sum(sign * max(x + edge, 0 * x) ** 2 for sign, edge in signed) / (2 * wide * narrow)


def exact_share(x, width_a, width_b) -> Fraction:
    """Share of a trapezoid below x, of a box or a step where a width is 0."""
    x, wide, narrow = (Fraction(n) for n in (x, max(width_a, width_b), min(width_a, width_b)))
    if narrow > 0:
        return ramps(x, wide, narrow)
    if wide > 0:
        return min(max(x / wide + Fraction(1, 2), Fraction(0)), Fraction(1))
    return Fraction(int(np.sign(x)) + 1, 2)


@hard_case(
    "share of a bundle that is 1, 1e-4, ... 0 times as wide along one side",
    "four squared ramps over the width",
    "linear and quadratic part",
    4 * UNIT,
)
def narrow_bundles() -> Values:
    exact, obvious, ours = [], [], []
    narrow = 0.13 * np.array([1.0, 0.3, 1e-4, 1e-6, 1e-9, 1e-12, 0.0])
    for wide, other in [*((0.13, one) for one in narrow), (0.0, 0.13), (0.0, 0.0), (0.13, 1e-320)]:
        shoulder = (wide - other) / 2 + other * np.linspace(-0.1, 1.1, 25)
        x = np.sort([*-shoulder, *np.linspace(-0.13, 0.13, 21), *shoulder])
        exact.extend(exact_share(n, wide, other) for n in x)
        obvious.extend(ramps(n, np.float64(wide), other) for n in x)
        ours.extend(trapezoid_cdf(n, max(wide, other), min(wide, other)) for n in x)
    return Values(np.array(exact), obvious, ours, scale=1.0)
