"""Conjugates at the focal length and at infinity, long chains, and bundles of any width."""

from dataclasses import replace
from fractions import Fraction

import numpy as np

from experiments.hard_cases.case import UNIT, Values, as_exact, hard_case
from lf_flame import PAPER_CAMERA
from lf_flame._common.arrays import centred
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.ray_bundle import trace_footprint, trapezoid_cdf
from lf_flame.optics.ray_transfer import chain, free_space, inverse, thin_lens

CAMERA = PAPER_CAMERA
F, A0, I0 = CAMERA.main_lens_focal_mm, CAMERA.focus_distance_mm, CAMERA.image_distance_mm


def textbook_image(focal: float, distance: float) -> np.float64:
    """Image distance by the thin-lens equation as textbooks solve it."""
    return np.float64(distance) * focal / (np.float64(distance) - focal)


class ExactCamera:
    """Conversions of a camera from the thin-lens equation, in rational arithmetic."""

    def __init__(self, camera: PlenopticCamera):
        self.f, self.a0 = Fraction(camera.main_lens_focal_mm), Fraction(camera.focus_distance_mm)
        self.i0 = 1 / (1 / self.f - 1 / self.a0)
        lenslet = Fraction(camera.lenslet_focal_mm)
        self.step = (self.i0 / lenslet + 1) / camera.views  # view step over lenslet pitch

    def slope(self, depth: float) -> Fraction:
        """Convert a depth."""
        vergence = 0 if np.isinf(depth) else 1 / (self.a0 + Fraction(depth))
        return self.step * (self.i0 * (1 / self.f - vergence) - 1)

    def depth(self, slope: float) -> Fraction:
        """Convert a slope."""
        return 1 / (1 / self.f - (1 + Fraction(slope) / self.step) / self.i0) - self.a0


def exact_chain(elements) -> np.ndarray:
    """Matrix of a path of ("space", d) and ("lens", f) in rational arithmetic."""
    system = as_exact(np.eye(2))
    for kind, length in elements:
        element = as_exact(np.eye(2))
        if kind == "space":
            element[0, 1] = Fraction(length)
        else:
            element[1, 0] = -1 / Fraction(length)
        system = element @ system
    return system


def float_chain(elements) -> np.ndarray:
    """Make the same matrix by the package."""
    return chain(*(free_space(x) if kind == "space" else thin_lens(x) for kind, x in elements))


def naive_slope(distance: float) -> np.float64:
    """Slope of an object by way of its image distance."""
    return CAMERA.view_step_mm / CAMERA.lenslet_pitch_mm * (I0 / textbook_image(F, distance) - 1)


@hard_case(
    "slope of an object at f(1 - 1e-12), at f, at infinity",
    "image distance a f/(a - f)",
    "1/a0 - 1/(a0 + z)",
    16 * UNIT,
)
def conjugates() -> Values:
    distances = (1e-9, 1.0, F * (1 - 1e-12), F, F * (1 + 1e-12), 1e9, 1e300, np.inf)
    exact = np.array([ExactCamera(CAMERA).slope(a - A0) for a in distances])
    ours = [CAMERA.depth_to_slope(a - A0) for a in distances]
    return Values(exact, [naive_slope(a) for a in distances], ours)


@hard_case("slope next to the focal plane", "i0/i(z) - 1", "1/a0 - 1/(a0 + z)", 16 * UNIT)
def near_focus() -> Values:
    depths = (-1e-6, -1e-9, 1e-12, 1e-9, 1e-6)
    exact = np.array([ExactCamera(CAMERA).slope(z) for z in depths])
    return Values(exact, [naive_slope(A0 + z) for z in depths], CAMERA.depth_to_slope(depths))


@hard_case("depth of a small slope", "i f/(i - f) - a0", "difference of reciprocals", 16 * UNIT)
def depth_of_slope() -> Values:
    slopes = (1e-12, -1e-9, 1e-6)
    exact = np.array([ExactCamera(CAMERA).depth(slope) for slope in slopes])
    step = CAMERA.view_step_mm / CAMERA.lenslet_pitch_mm
    obvious = [textbook_image(F, I0 / (1 + slope / step)) - A0 for slope in slopes]
    return Values(exact, obvious, CAMERA.slope_to_depth(slopes))


@hard_case(
    "matrix from the front focal plane to the array",
    "to the image, and back from it",
    "one product of matrices",
    1e-13,
)
def front_focal_plane() -> Values:
    exact, obvious, ours = [], [], []
    for distance in (F * (1 - 1e-12), F, F * (1 + 1e-12)):
        path = [("space", distance), ("lens", F)]
        v = textbook_image(F, distance)
        exact.append(exact_chain([*path, ("space", I0)]))
        obvious.append(float_chain([*path, ("space", v), ("space", I0 - v)]))
        ours.append(CAMERA.object_to_array(distance - A0))
    return Values(np.array(exact), np.array(obvious), np.array(ours), np.array([[4, 700], [1, 4]]))


@hard_case(
    "magnification of a 4-f chain", "hop from image to image", "one product of matrices", 1e-13
)
def relay() -> Values:
    exact, obvious, ours = [], [], []
    for f1, f2 in ((100.0, 50.0), (0.1, 0.2), (35.1, 80.3)):
        path = [("space", f1), ("lens", f1), ("space", f1 + f2), ("lens", f2), ("space", f2)]
        v = textbook_image(f1, f1)
        exact.append(exact_chain(path)[0, 0])
        obvious.append(-v / f1 * -textbook_image(f2, f1 + f2 - v) / (f1 + f2 - v))
        ours.append(float_chain(path)[0, 0])
    return Values(np.array(exact), obvious, ours)


@hard_case(
    "way back through 100 elements of an unstable chain",
    "divide by the determinant",
    "swap and negate: the determinant is 1",
    400 * UNIT,
)
def a_hundred_elements() -> Values:
    path = [("space", 700.0), ("lens", 150.0)] * 50
    (a, b), (c, d) = exact_chain(path)
    exact, system = np.array([[d, -b], [-c, a]]), float_chain(path)
    determinant = system[0, 0] * system[1, 1] - system[0, 1] * system[1, 0]
    ours = inverse(system)
    return Values(exact, ours / determinant, ours)


@hard_case(
    "focus of a lens of 1e8 mm", "abs(C) < 1e-5 means no power", "-1/C, whatever its size", 4 * UNIT
)
def weak_lens() -> Values:
    powers = [float_chain([("lens", focal), ("space", focal)])[1, 0] for focal in (1e8, -1e8)]
    obvious = [np.inf if abs(power) < 1e-5 else -1 / power for power in powers]
    return Values(np.array([1e8, -1e8]), obvious, [-1 / power for power in powers])


def exact_footprint(camera: PlenopticCamera, depth: float, axis: int = 0):
    """Centres, lenslet width and pixel width on a layer by similar triangles, in mm.

    The ray through height y of the array and h of the main lens crosses the focal plane at
    ``-y a0 / i0``, the conjugate of y, and goes on straight to the layer.
    """
    exact = ExactCamera(camera)
    lenslet_focal, pitch = Fraction(camera.lenslet_focal_mm), Fraction(camera.lenslet_pitch_mm)
    pixel = pitch * (1 + lenslet_focal / exact.i0) / camera.views
    if camera.pixel_pitch_mm is not None:
        pixel = Fraction(camera.pixel_pitch_mm)

    def on_layer(y, h):
        y = y * exact.a0 / exact.i0
        return -y - (y + h) * Fraction(depth) / exact.a0

    view_step = pixel * exact.i0 / lenslet_focal
    count, views = camera.lenslets[axis], camera.views
    lenslets = as_exact(np.arange(count) - (count - 1) / 2) * pitch
    views = as_exact(np.arange(views) - (views - 1) / 2)[:, None] * view_step
    return -on_layer(lenslets, -views), on_layer(pitch, pitch), on_layer(0, -view_step)


@hard_case(
    "views about the middle of the lens, 2, 5 and 14 of them",
    "u - N//2, aperture/(N - 1) apart",
    "u - (N - 1)/2",
    1e-13,
)
def middle_of_the_lens() -> Values:
    exact, obvious, ours = [], [], []
    for views in (1, 2, 5, 14):
        camera = replace(CAMERA, views=views, lenslets=(1, 3))
        centres, _, step = exact_footprint(camera, 20.0, 1)
        spacing = np.float64(camera.aperture_mm) / (views - 1) * float(step) / camera.view_step_mm
        exact.extend(centres[:, 1])
        obvious.extend(-(np.arange(views) - views // 2) * spacing)
        ours.extend(trace_footprint(camera, 20.0, 1).centres_mm[:, 1])
    return Values(np.array(exact), obvious, ours, scale=1.0)


@hard_case(
    "pixels that do not divide the lenslet, in mm",
    "column times pixel pitch",
    "counted from each chief ray",
    1e-12,
)
def uneven_pixels() -> Values:
    camera = replace(CAMERA, pixel_pitch_mm=0.0073, lenslets=(1, 540))
    centres, lenslet, pixel = exact_footprint(camera, 20.0, 1)
    counted = centred(540 * camera.views) * 0.0073
    on_lenslet = counted.reshape(540, -1).T - centred(540) * camera.lenslet_pitch_mm
    obvious = -centred(540) * float(lenslet) - on_lenslet * float(pixel) / 0.0073
    return Values(centres, obvious, trace_footprint(camera, 20.0, 1).centres_mm, scale=1.0)


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
        ours.extend(trapezoid_cdf(x, wide, other))
    return Values(np.array(exact), obvious, ours, scale=1.0)


@hard_case(
    "shares of a bundle from 0.9 mm to nothing, added up",
    "density at the middle of each cell",
    "differences of the distribution",
    50 * UNIT,
)
def shares_add_up() -> Values:
    edges = np.linspace(-1, 1, 41) + 0.01
    middles, cell, obvious, ours = (edges[1:] + edges[:-1]) / 2, edges[1] - edges[0], [], []
    for wide in (0.9, 0.13, 1e-3, 1e-9, 1e-20, 0.0):
        for narrow in (wide, wide * 1e-6, 0.0):
            inside = np.clip(((wide + narrow) / 2 - abs(middles)) / max(narrow, 1e-300), 0, 1)
            obvious.append((inside / max(wide, 1e-300) * cell).sum())
            ours.append(np.diff(trapezoid_cdf(edges, wide, narrow)).sum())
    return Values(np.ones(len(ours)), obvious, ours)
