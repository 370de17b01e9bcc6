"""Slope map and image with everything in focus.

`all_in_focus` uses the views: it finds the slope at which those that see a place match the central
view (`lf_flame.refocus.matching`). `depth_from_focus` uses only a focal stack. Either gives a cost
for each pixel and slope, from which slopes are chosen together with those of the surroundings,
guided by the image (`lf_flame.refocus.semi_global`).

Depth from focus (Nayar, Nakagawa, IEEE Trans. Pattern Anal. Mach. Intell. 16, 824, 1994) finds at
each pixel the slope at which its surroundings are sharpest, by a parabola between the slopes of the
stack. Sharpness is the gradient energy of the low-passed slice under a Gaussian window.

The stack should come from exact shifts (`refocus` with "sinc"). With linear interpolation a slice
is piecewise linear in the slope, with kinks where a view's shift is a whole number of lenslets, and
the energy peaks at the kinks: slopes of known surfaces are then wrong by more than 0.02 in the
median, with exact shifts by less than 0.01. Neither a low-pass nor the modified Laplacian nor the
variance over the views removes this error.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter

from lf_flame._common.arrays import centred
from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.refocus._arguments import (
    Views,
    as_steps,
    as_views,
    as_weights,
    refuse_not_finite,
    refuse_uncounted,
)
from lf_flame.refocus.interpolation import check_interpolation
from lf_flame.refocus.matching import ComparedViews, as_grey
from lf_flame.refocus.refinement import refine_slopes
from lf_flame.refocus.semi_global import choose_slopes
from lf_flame.refocus.shift import shift_and_sum
from lf_flame.refocus.surface import refocus_surface

LOW_PASS = 1.0
"""Standard deviation of the Gaussian before the gradient, in lenslets; it suppresses aliasing."""

FLOOR = 0.1
"""Sharpness at which the cost of the sharpest slice is a half, relative to the mean."""

TRUSTED = 0.2
"""Smallest confidence of a certain slope."""

RESOLVED = 1.0
"""Shift of the outermost view, in lenslets, between slopes that can be distinguished."""

MAP_STEPS = 33
"""Number of slopes in the stack from which commands and pages make a slope map."""


@dataclass(frozen=True, eq=False)
class FocusMap:
    """Slope map and image with everything in focus, from `depth_from_focus` or `all_in_focus`.

    Things that one sees through, as a flame before others, have no one slope, and nothing here
    tells: for flames use `lf_flame.tomography.reconstruct`.

    Attributes
    ----------
    slope : ndarray of float64, shape (t, s)
        Slope of each pixel, in lenslets per view step: mean of its own and of neighbours of similar
        brightness with about the same slope.
    confidence : ndarray of float64, shape (t, s)
        Confidence from 0 to 1; a slope is certain from 0.2 on. It is the share of similar
        neighbours that agree, times their mean trust: by how much a slope's cost is below those of
        distinct slopes, how sharp the minimum is, and how low. 0 where the best slope is the first
        or last, and where the neighbours choose another.
    all_in_focus : ndarray of float32, shape (t, s) or (t, s, channels)
        Image with every pixel refocused at its slope.
    """

    slope: np.ndarray
    confidence: np.ndarray
    all_in_focus: np.ndarray


def depth_from_focus(stack: ArrayLike, slopes: ArrayLike, *, window: float = 3.0) -> FocusMap:
    """Find the slope at which each pixel of a focal stack is sharpest.

    Parameters
    ----------
    stack : array_like, shape (n, t, s) or (n, t, s, channels)
        Refocused images, preferably from `refocus` with "sinc" interpolation.
    slopes : sequence of float
        Slope of each image in lenslets per view step, at least three, rising in equal steps;
        `PlenopticCamera.slope_to_depth` turns those that are found into depths.
    window : float, optional
        Standard deviation, in lenslets, of the Gaussian under which sharpness is summed. A smaller
        one shows finer outlines, a larger one needs less texture.

    Returns
    -------
    FocusMap
        Slope map. Its image is interpolated between the two slices next to each pixel's slope.

    Raises
    ------
    InputError
        If an argument cannot be used.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import refocus
    >>> picture = np.random.default_rng(1).uniform(size=(24, 30))
    >>> steps = (-1, 0, 1)  # each view shows the picture one pixel farther along than the next
    >>> views = np.array([[np.roll(picture, (-v, -u), (0, 1)) for u in steps] for v in steps])
    >>> slopes = np.linspace(-2, 2, 9)
    >>> stack = refocus.refocus(views, slopes, interpolation="sinc")
    >>> float(np.median(refocus.depth_from_focus(stack, slopes).slope).round(1))
    -1.0
    """
    stack, slopes = np.asarray(stack), as_steps(slopes)
    costs = _blur(stack, slopes, window)
    picture = _between_slices(stack, slopes, slopes[costs.argmin(axis=2)])
    slope, confidence = choose_slopes(costs, slopes, _guide(picture), window, slopes[1] - slopes[0])
    return FocusMap(slope, confidence, _between_slices(stack, slopes, slope))


def all_in_focus(
    light_field: Views,
    slopes: ArrayLike,
    *,
    window: float = 3.0,
    interpolation: str = "linear",
    weights: ArrayLike | None = None,
) -> FocusMap:
    """Find the slope map of a light field and refocus every pixel at its slope.

    A pixel's slope is the one at which the views that see it match the central view best; near an
    outline half of the views are compared, or a quarter (`lf_flame.refocus.matching`). Where this
    is uncertain, for example without texture, the slope comes from the surroundings, up to the
    edges of the central view (`lf_flame.refocus.semi_global`). Finally slopes are refined between
    the steps of the search (`lf_flame.refocus.refinement`). The image is refocused on the resulting
    surface (`refocus_surface`), not selected from slices, so that it has no seams.

    Parameters
    ----------
    light_field : LightField or array_like, shape (v, u, t, s) or (v, u, t, s, channels)
    slopes : sequence of float
        Slopes to search, in lenslets per view step, at least three, rising in equal steps. A peak
        at the first or last is not trusted: include one step more on each side than the scene
        needs.
    window : float, optional
        Standard deviation, in lenslets, of the Gaussian by which neighbours are weighted; it
        reaches 24 lenslets at most.
    interpolation : optional
        Interpolation for the image, as in `refocus_surface`.
    weights : array_like, shape (v, u), optional
        Weight of each view, 0 or above, in the match and in the image; the light field's own
        weights multiply them. Default: all equal.

    Returns
    -------
    FocusMap
        Slope map, confidence and image. For views off a regular grid (`LightField.positions`) they
        come from the focal stack, as in `depth_from_focus`.

    Raises
    ------
    InputError
        If an argument cannot be used, or a pixel is NaN or infinite.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.refocus import all_in_focus
    >>> texture = np.random.default_rng(1).uniform(size=(48, 64))
    >>> views = [[np.roll(texture, (2 - v, 2 - u), (0, 1)) for u in range(5)] for v in range(5)]
    >>> found = all_in_focus(np.array(views), np.linspace(-2, 2, 17))
    >>> round(float(np.median(found.slope)), 2)  # content moves by -1 lenslet a view
    -1.0
    """
    weights = as_weights(weights, light_field)
    check_interpolation(interpolation)
    _check_window(window)
    if getattr(light_field, "positions", None) is not None:
        slopes = as_steps(slopes)
        stack = shift_and_sum(light_field, slopes, interpolation="cubic", weights=weights)
        return depth_from_focus(stack, slopes, window=window)
    views, slopes = as_grey(light_field), as_steps(slopes)
    down, right = (((n - 1) // 2, n // 2) for n in views.shape[:2])
    refuse_uncounted(
        light_field, product(down, right), "A slope map, which compares all views with one,"
    )
    compared = ComparedViews(views, slopes, weights)
    # The light field's own weights are among these already.
    own = light_field
    if isinstance(own, LightField):
        own = LightField.trusted(own.views, valid=own.valid)
    slope, confidence, guide, limit = _matched(compared, own, window, weights)
    if not compared.even and compared.find_levels(slope, confidence >= TRUSTED):
        slope, confidence, guide, limit = _matched(compared, own, window, weights)
    slope = refine_slopes(compared, slope, guide, limit)
    image = refocus_surface(own, slope, interpolation=interpolation, weights=weights)
    return FocusMap(slope, confidence, image)


def _matched(
    compared: ComparedViews, light_field: Views, window: float, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Slopes at which compared views match best, their confidence, the guide, and the limit."""
    slopes, limit = compared.slopes, compared.limit()
    costs = compared.costs(limit)
    best = slopes[costs.argmin(axis=2)]
    guide = _guide(_middle(as_views(light_field), best))
    found = choose_slopes(costs, slopes, guide, window, distinct_by(weights))
    return *found, guide, limit


def distinct_by(weights: np.ndarray) -> float:
    """Smallest difference of slopes that views with these weights, (v, u), can distinguish."""
    used = zip(weights.shape, _used(weights), strict=True)
    farthest = max(np.abs(centred(n))[some].max() for n, some in used)
    return RESOLVED / max(farthest, 0.5)


def _guide(picture: np.ndarray) -> np.ndarray:
    """Grey image, smooth enough that noise is no edge."""
    return gaussian_filter(picture.mean(axis=2) if picture.ndim == 3 else picture, LOW_PASS)


def _used(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of views with any weight above 0."""
    return np.any(weights > 0, axis=1), np.any(weights > 0, axis=0)


def _middle(views: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Central view; for an even number of views, the mean of the central ones on the surface."""
    down, right = (np.abs(centred(n)) < 1 for n in views.shape[:2])
    if down.sum() == right.sum() == 1:
        return views[views.shape[0] // 2, views.shape[1] // 2].astype(np.float32, copy=False)
    return refocus_surface(views, slope, weights=np.outer(down, right))


def _check_window(window: float) -> None:
    if not 0 < window < np.inf:
        raise InputError(f"window must be a number of lenslets above 0, got {window}.")


def _blur(stack: np.ndarray, slopes: np.ndarray, window: float) -> np.ndarray:
    """Cost of each slice, from 0 for the sharpest to 1: float32, shape (t, s, n)."""
    if stack.ndim not in (3, 4) or len(stack) != len(slopes) or min(stack.shape) < 1:
        raise InputError(
            f"A focal stack must have one image for each of the {len(slopes)} slopes, (n, t, s) or "
            f"(n, t, s, channels), got an array of shape {stack.shape}."
        )
    _check_window(window)
    refuse_not_finite(stack)
    sharpness = np.stack([_sharpness(image, window) for image in stack], axis=-1)
    peak = sharpness.max(axis=-1, keepdims=True)
    floor = max(FLOOR * peak.mean(), np.finfo(float).tiny)
    return (1 - sharpness / (peak + floor)).astype(np.float32)


def _sharpness(image: np.ndarray, window: float) -> np.ndarray:
    """Gradient energy around each pixel, summed over channels: shape (t, s)."""
    energy = np.zeros(image.shape[:2])
    for channel in np.moveaxis(np.atleast_3d(image), 2, 0):
        smooth = gaussian_filter(channel.astype(float), LOW_PASS, mode="nearest")
        for axis in (0, 1):
            if smooth.shape[axis] > 1:
                energy += np.gradient(smooth, axis=axis) ** 2
    return gaussian_filter(energy, window, mode="nearest")


def _between_slices(stack: np.ndarray, slopes: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Image interpolated linearly between the slices next to each pixel's slope."""
    at = np.clip((slope - slopes[0]) / (slopes[1] - slopes[0]), 0, len(slopes) - 1)
    below = np.minimum(at.astype(int), len(slopes) - 2)
    height, width = slope.shape
    rows, columns = np.indices((height, width), sparse=True)
    weight = (at - below).reshape(*slope.shape, *(1,) * (stack.ndim - 3))
    near, far = stack[below, rows, columns], stack[below + 1, rows, columns]
    return ((1 - weight) * near + weight * far).astype(np.float32)
