"""Refocusing on a surface: a slope for every pixel instead of one for the image.

A slope map is ``slopes[t, s]``, in lenslets per view step. It is linear for a tilted plane, such as
a tilted (Scheimpflug) lens has in focus. Regions of interest can each have their own slope
(volumetric refocusing: Samarakoon, Abeywardena, Edussooriya, arXiv 2502.19238). The slope map of a
whole scene gives an image with everything in focus (`lf_flame.refocus.focus_map`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numba import njit
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter

from lf_flame._common.arrays import as_numbers
from lf_flame._common.threads import parallel
from lf_flame.errors import InputError
from lf_flame.refocus._arguments import (
    Region,
    Views,
    as_readable,
    as_region,
    as_views,
    as_weights,
    refuse_infinite,
)
from lf_flame.refocus.shift import check_interpolation
from lf_flame.refocus.unknown_pixels import ignoring_unknown

TAPS = {"nearest": 1, "linear": 2, "cubic": 4}
"""Number of lenslets along an axis that each interpolation reads."""

WINDOW = 1.5
"""Half-width of the window of a Gaussian that softens a slope map, in standard deviations: a window
of 15 x 15 for a standard deviation of 5."""


@ignoring_unknown()
def refocus_surface(
    light_field: Views,
    slopes: ArrayLike,
    *,
    interpolation: str = "linear",
    weights: ArrayLike | None = None,
) -> np.ndarray:
    """Refocus every pixel at its own slope.

    ``out[t, s]`` is the mean over v, u of ``L[v, u, t + slopes[t, s] (v - vc), s + slopes[t, s]
    (u - uc)]``, coordinates clamped at the edges. A constant map gives `shift_and_sum`.

    Parameters
    ----------
    light_field : LightField or array_like, shape (v, u, t, s) or (v, u, t, s, channels)
        Views. Types uint8, uint16, float32 and float64 are read directly; others are converted to
        float32, or to float64 if they are wider.
    slopes : array_like, shape (t, s) or (n, t, s)
        One slope map or several, in lenslets per view step.
    interpolation : {"linear", "nearest", "cubic"}, optional
        Interpolation between lenslets. "nearest" rounds both shifts to whole lenslets, halves up;
        "cubic" is Keys' convolution with a = -1/2, 4 x 4 lenslets, which can overshoot.
    weights : array_like, shape (v, u), optional
        Weight of each view, 0 or above; divided by their sum. Views of weight 0 are not read. The
        light field's own weights multiply them. Default: all equal.

    Returns
    -------
    ndarray of float32, shape of `slopes`, or with a last axis of channels
        Refocused images; sums run in float64.

    Raises
    ------
    InputError
        If an argument cannot be used, or a pixel that was read is NaN or infinite.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import refocus
    >>> views = np.random.default_rng(1).uniform(size=(5, 5, 24, 30))

    >>> surface = refocus.refocus_surface(views, np.full((24, 30), 0.5))
    >>> np.allclose(surface, refocus.shift_and_sum(views, 0.5), atol=1e-6)
    True
    """
    weights = as_weights(weights, light_field)
    views = as_readable(as_views(light_field))
    slopes = _as_slope_maps(slopes, views.shape[2:4])
    check_interpolation(interpolation)
    grey = views.ndim == 4
    lights = views[..., None] if grey else views
    maps = slopes.reshape(-1, *slopes.shape[-2:])
    out = np.empty((*maps.shape, lights.shape[4]), np.float32)
    normalised = weights / weights.sum()
    with np.errstate(over="ignore"):  # refused below
        _refocus_rows(lights, maps, normalised, TAPS[interpolation], out)
    refuse_infinite(out, views)
    return out.reshape(slopes.shape if grey else (*slopes.shape, -1))


def region_slopes(
    shape: Sequence[int],
    regions: Iterable[tuple[Region, float]],
    *,
    background: float,
    soften: float = 0.0,
) -> np.ndarray:
    """Slope map of regions of interest, each with its own slope.

    Parameters
    ----------
    shape : (int, int)
        Number of lenslet rows and columns, (t, s).
    regions : iterable of (region, slope)
        Regions ``(t_start, t_stop, s_start, s_stop)`` in lenslets, with their slopes. A later
        region covers earlier ones.
    background : float
        Slope elsewhere; far from the slopes of the scene, the background is blurred.
    soften : float, optional
        Standard deviation, in lenslets, of a Gaussian that smooths the map, so that there are no
        seams (Samarakoon et al. use 5 in a window of 15 x 15). Regions are first widened by half
        the window: all lenslets of a region keep its slope, unless another region is as near.
        Default: no smoothing.

    Returns
    -------
    ndarray of float64, shape (t, s)

    Raises
    ------
    InputError
        If a region is not inside the image, or a number cannot be used.

    Examples
    --------
    >>> from lf_flame.refocus import region_slopes
    >>> region_slopes((2, 3), [((0, 2, 1, 2), 1.5)], background=0.0).tolist()
    [[0.0, 1.5, 0.0], [0.0, 1.5, 0.0]]
    """
    if not 0 <= soften < np.inf:
        raise InputError(f"soften must be a number of lenslets, 0 or above, got {soften}.")
    reach = max(int(WINDOW * soften), 1) if soften else 0
    slopes = np.full(shape, as_numbers(background, "background"))
    checked = [(as_region(one, slopes.shape), as_numbers(x, "A slope")) for one, x in regions]
    for beyond in (reach, 0):  # widened regions may cover their neighbours
        for (top, bottom, left, right), slope in checked:
            down, across = max(top - beyond, 0), max(left - beyond, 0)
            slopes[down : bottom + beyond, across : right + beyond] = slope
    slopes = _as_slope_maps(slopes, slopes.shape)
    return gaussian_filter(slopes, soften, mode="nearest", radius=reach) if reach else slopes


def _as_slope_maps(slopes: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    slopes = np.ascontiguousarray(as_numbers(slopes, "A slope map"))
    if slopes.ndim not in (2, 3) or slopes.shape[-2:] != tuple(shape) or slopes.size == 0:
        raise InputError(
            f"A slope map must have the {shape[0]} x {shape[1]} lenslets of the views, or be "
            f"a stack of such maps, got an array of shape {slopes.shape}."
        )
    if not np.all(np.isfinite(slopes)):
        bad = np.count_nonzero(~np.isfinite(slopes))
        raise InputError(f"A slope map must be finite, got {bad} NaN or infinite slopes.")
    return slopes


@njit
def refocus_row(views, line, t, weights, taps, out):
    """Refocus row t of an image with a slope for each of its pixels, line[s]: out[s, c].

    A pixel's shift along t depends only on the row of the view, its shift along s only on the
    column. Interpolation therefore needs rows + columns sets of taps, not rows * columns.
    """
    rows, columns, height, width, channels = views.shape
    right = np.empty((columns, taps, width), np.int64)
    right_weight = np.empty((columns, taps, width))
    down = np.empty((taps, width), np.int64)
    down_weight = np.empty((taps, width))
    total, part = np.zeros((channels, width)), np.empty((channels, width))
    for u in range(columns):
        middle = u - (columns - 1) / 2
        place_taps(line, middle, 0, 1, width, channels, right[u], right_weight[u])
    for v in range(rows):
        middle = v - (rows - 1) / 2
        place_taps(line, middle, t, 0, height, width * channels, down, down_weight)
        for a in range(taps):
            part[:] = 0.0
            for u in range(columns):
                if weights[v, u] != 0.0:
                    add_view(views[v, u].reshape(-1), down[a], right[u], right_weight[u],
                             weights[v, u], part)  # fmt: skip
            for c in range(channels):
                for s in range(width):
                    total[c, s] += down_weight[a, s] * part[c, s]
    for s in range(width):
        for c in range(channels):
            out[s, c] = total[c, s]


@njit
def place_taps(line, middle, start, step, length, stride, index, weight):
    """Find where a view is read for each pixel along one axis: index[tap, s], weight[tap, s].

    Pixel s is at start + s * step; taps outside the axis read its edge. One tap rounds the shift,
    two interpolate linearly, four use Keys' cubic convolution with a = -1/2 (IEEE Trans. Acoust.
    Speech Signal Process. 29, 1153, 1981).
    """
    taps = index.shape[0]
    for s in range(line.size):
        # Beyond these limits every tap reads the edge.
        shift = min(max(line[s] * middle, -length - 2.0), length + 2.0)
        whole = math.floor(shift + 0.5) if taps == 1 else math.floor(shift)
        f = shift - whole
        g = 1.0 - f
        if taps == 1:
            weight[0, s] = 1.0
        elif taps == 2:
            weight[0, s], weight[1, s] = g, f
        else:
            weight[0, s], weight[3, s] = -0.5 * f * g * g, -0.5 * g * f * f
            weight[1, s] = 1.0 + f * f * (1.5 * f - 2.5)
            weight[2, s] = 1.0 + g * g * (1.5 * g - 2.5)
        first = start + s * step + int(whole) - (taps - 1) // 2
        for a in range(taps):
            index[a, s] = min(max(first + a, 0), length - 1) * stride


@njit
def add_view(view, down, right, tap_weight, weight, part):
    """Add weight times a row of a flat view, starting at `down`, interpolated along s."""
    for b in range(right.shape[0]):
        for c in range(part.shape[0]):
            for s in range(down.size):
                # unsigned, so that no index can be negative
                at = np.uint64(down[s] + right[b, s] + c)
                part[c, s] += weight * tap_weight[b, s] * view[at]


@parallel(lambda slopes: slopes.shape[0] * slopes.shape[1])
def _refocus_rows(k, views, slopes, weights, taps, out):
    """Weighted mean of views[v, u, t, s, c], shifted by slopes[n, t, s]: out[n, t, s, c].

    weights[v, u]: weights of the views, with sum 1; views of weight 0 are not read.
    """
    height = slopes.shape[1]
    n, t = k // height, k % height
    refocus_row(views, slopes[n, t], t, weights, taps, out[n, t])
