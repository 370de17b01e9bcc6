"""Refocusing by shifting views: in space, with a plan of the shifts and one compiled pass."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import ArrayLike

from lf_flame._common.arrays import centred
from lf_flame.errors import InputError
from lf_flame.refocus import _kernels
from lf_flame.refocus._arguments import (
    Views,
    as_block,
    as_readable,
    as_slopes,
    as_view_indices,
    as_views,
    as_weights,
    for_slopes,
    refuse_infinite,
    refuse_not_finite,
)
from lf_flame.refocus.unknown_pixels import ignoring_unknown

SLOPES_AT_ONCE = 8
"""Number of slopes for each reading of the light field."""

BLOCK = 2048
"""Approximate number of pixels of a line per block; shorter ones are read more slowly."""

INTERPOLATIONS = ("linear", "nearest", "cubic")
"""Interpolations: two neighbours by distance; the nearest; four by Keys's cubic convolution."""


@ignoring_unknown()
def shift_and_sum(
    light_field: Views,
    slopes: ArrayLike,
    *,
    interpolation: str = "linear",
    weights: ArrayLike | None = None,
) -> np.ndarray:
    """Refocus by shifting and averaging views; outside a view its nearest edge pixel is used.

    Interpolation is separable over rows and columns of views: each row is first shifted and summed
    along s, then the row sums along t. This takes N^2 + N shifts instead of 2 N^2 for N x N views.
    The light field is read once for several slopes.

    Parameters
    ----------
    light_field : LightField or array_like, shape (v, u, t, s) or (v, u, t, s, channels)
        Views. Contiguous arrays of 8 or 16 bits, float32 or float64 are read without a copy, and
        so are the grey views of a raw lenslet image of n x n pixels under a lenslet,
        ``raw.reshape(rows, n, columns, n).transpose(1, 3, 0, 2)``.
    slopes : float or sequence of float
        Slope of each refocused image, in lenslets per view step; positive for depths behind the
        focal plane.
    interpolation : {"linear", "nearest", "cubic"}, optional
        Interpolation between lenslets. "nearest" rounds each view's shift to whole lenslets,
        halves up; "cubic" is Keys's convolution, which can overshoot at edges.
    weights : array_like, shape (v, u), optional
        Weight of each view, 0 or above (`lf_flame.refocus.aperture`); divided by their sum. Views
        of weight 0 are not read. The light field's own weights multiply them. Default: all equal.

    Returns
    -------
    ndarray of float32, shape (n, t, s) or (n, t, s, channels)
        One image for each slope; for a single number the image itself, without the first axis.
        It has the unit of the views. Eight terms at a time are summed in float32, these sums in
        float64: the error stays within a few units in the last place for any number of views.
        (Views of float64 are summed in float64 throughout.)

    Raises
    ------
    InputError
        If views, slopes, interpolation or weights cannot be used.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import refocus
    >>> picture = np.random.default_rng(1).uniform(size=(24, 30))
    >>> steps = (-1, 0, 1)  # each view shows the picture one pixel farther along than the next
    >>> views = np.array([[np.roll(picture, (-v, -u), (0, 1)) for u in steps] for v in steps])
    >>> image = refocus.shift_and_sum(views, -1.0)
    >>> np.allclose(image[1:-1, 1:-1], picture[1:-1, 1:-1])
    True
    >>> refocus.shift_and_sum(views, [-1.0, 0.0, 1.0]).shape
    (3, 24, 30)
    """
    weights = as_weights(weights, light_field)
    views, steps = as_readable(as_views(light_field), raw=True), as_slopes(slopes)
    places = [centred(count) for count in views.shape[:2]]
    return for_slopes(_stack(views, places, steps, interpolation, weights), slopes)


def align_views(
    light_field: Views,
    slopes: ArrayLike,
    view_indices: Sequence[tuple[int, int]],
    *,
    block: tuple[int, int] = (1, 1),
) -> np.ndarray:
    """Shift selected views so that objects at a slope are at the same position in all of them.

    View (v, u) becomes ``L[v, u, t + slope (v - vc), s + slope (u - uc)]``, interpolated linearly,
    coordinates clamped at the edges; the mean over all views is `shift_and_sum`.

    Parameters
    ----------
    light_field : LightField or array_like, shape (v, u, t, s) or (v, u, t, s, channels)
        Views; those without an index are not read.
    slopes : float or sequence of float
        Slopes in lenslets per view step, whatever the block.
    view_indices : sequence of (int, int)
        Row and column of each view, counted from 0.
    block : (int, int), optional
        Number of lenslets averaged into one pixel, along (t, s), after shifting.

    Returns
    -------
    ndarray of float32, shape (n, views, t / block, s / block), or with a last axis of channels
        Aligned views; without the first axis for a single slope.

    Raises
    ------
    InputError
        If an argument cannot be used, or a pixel that was read is NaN or infinite.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import refocus
    >>> views = np.random.default_rng(1).uniform(size=(5, 5, 24, 30))

    >>> aligned = refocus.align_views(views, 0.5, [(0, 0), (2, 2), (4, 4)])
    >>> aligned.shape
    (3, 24, 30)
    >>> np.allclose(aligned[1], views[2, 2])  # the central view stays where it is
    True
    """
    views, steps = as_readable(as_views(light_field)), as_slopes(slopes)
    indices = as_view_indices(view_indices, views.shape[:2])
    block = as_block(block, views.shape[2:4])
    height, width = (n // m for n, m in zip(views.shape[2:4], block, strict=True))
    out = np.empty((len(steps), len(indices), height, width, *views.shape[4:]), np.float32)
    for k, (v, u) in enumerate(indices.tolist()):
        one = np.s_[v : v + 1, u : u + 1]
        places = [centred(count)[some] for count, some in zip(views.shape[:2], one, strict=True)]
        image = _stack(views[one], places, steps, "linear", np.ones((1, 1)))
        lines = image.reshape(len(steps), height, block[0], *image.shape[2:]).mean(axis=2)
        out[:, k] = sum(lines[:, :, s :: block[1]] for s in range(block[1])) / np.float32(block[1])
    return for_slopes(out, slopes)


class ShiftPlan(NamedTuple):
    """Positions at which the kernel reads the views at n slopes, and their weights.

    A chain is a run of views that are summed together.
    """

    used: np.ndarray  # (v, u): whether a view has a weight above 0; others are not read
    reach: int  # pixels by which lines and blocks are padded: the farthest reach of any tap
    at: np.ndarray  # (v, n, chain, link): position of tap 0 in the padded lines of a row of views
    weights: np.ndarray  # (tap, v, n, chain, link), scaled row by row; 0 in links without a view
    down: np.ndarray  # (v, n): row that tap 0 of a row of views reads for row 0 of the image
    down_weights: np.ndarray  # (v, n, tap); undo the scale, and divide by the sum of the weights
    bands: int  # of rows of the image, made in parallel, as are the blocks of columns
    blocks: int


def plan_shifts(
    shape: tuple[int, ...], channels: int, places: list[np.ndarray], slopes: np.ndarray,
    interpolation: str, weights: np.ndarray, precision: type,
) -> ShiftPlan:  # fmt: skip
    """Plan the shifts of views (v, u, rows, pixels of a row with channels adjacent)."""
    rows, columns, height, width = shape
    blocks = -(-width // (max(BLOCK // channels, 1) * channels))
    down, down_taps = shift_taps(view_shifts(slopes, places[0], height), interpolation)
    columns_at = np.broadcast_to(places[1], (rows, columns))
    across, taps = shift_taps(view_shifts(slopes, columns_at, width // channels), interpolation)
    if not taps[1:].any():  # whole slopes
        taps = taps[:1]
    reach = max(-int(across.min()), int(across.max()) + len(taps) - 1, 0) * channels
    line = _padded_line(width, blocks, channels, len(taps), reach)
    at = np.arange(columns)[:, None] * line + across * channels + reach
    scale = _powers_of_two(weights.sum(axis=1))
    across_weights = taps * (weights / scale[:, None])[:, :, None]
    down_weights = down_taps * (scale / weights.sum())[:, None]
    return ShiftPlan(
        weights > 0,
        reach,
        *_chain(weights > 0, at, across_weights.astype(precision)),
        down,
        np.moveaxis(down_weights, 0, 2).copy(),
        bands=min(height, -(-numba.get_num_threads() // blocks)),
        blocks=blocks,
    )


def _stack(views, places, slopes, interpolation: str, weights: np.ndarray) -> np.ndarray:
    """Refocus views [v, u, t, s(, c)] at given slopes; places: those of their rows and columns."""
    channels = views.shape[4] if views.ndim == 5 else 1
    lines = views.reshape(*views.shape[:3], -1)  # the channels of a lenslet are adjacent
    precision = np.float64 if views.dtype == np.float64 else np.float32
    stack = np.empty((len(slopes), *lines.shape[2:]), np.float32)
    for first in range(0, len(slopes), SLOPES_AT_ONCE):
        some = slice(first, first + SLOPES_AT_ONCE)
        plan = plan_shifts(
            lines.shape, channels, places, slopes[some], interpolation, weights, precision
        )
        bad = np.zeros((plan.bands, plan.blocks), bool)
        _kernels.sum_bands(
            lines, plan.reach, channels, plan.used, plan.at, plan.weights, plan.down,
            plan.down_weights, bad, stack[some],
        )  # fmt: skip
        if bad.any():
            refuse_not_finite(views)
    refuse_infinite(stack, views)
    return stack.reshape(len(slopes), *views.shape[2:])


def view_shifts(slopes: np.ndarray, places: np.ndarray, length: int) -> np.ndarray:
    """Shift at every position and slope, [..., n]; beyond the image it is clipped."""
    return np.clip(slopes * places[..., None], -length, length)


def _padded_line(width: int, blocks: int, channels: int, taps: int, reach: int) -> int:
    """Find the distance in pixels from one view's line to the next in a block of columns."""
    breadth = -(-width // (blocks * channels)) * channels
    return _next_multiple(breadth + (taps - 1) * channels, _kernels.LANES) + 2 * reach


def _powers_of_two(sums: np.ndarray) -> np.ndarray:
    """Scale of each row: the sum of its weights, rounded up to a power of two.

    Divided by it, equal weights stay exact and no sum leaves the range of float32.
    """
    return 2.0 ** np.ceil(np.log2(np.maximum(sums, np.finfo(float).tiny)))


def _next_multiple(length: int, multiple: int) -> int:
    return -(-length // multiple) * multiple


def _chain(used: np.ndarray, at: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Arrange at[v, u, n], weights[tap, v, u, n] of the views used in chains, see `ShiftPlan`."""
    rows, columns = used.shape
    taps, slopes = len(weights), at.shape[2]
    length = _next_multiple(int(used.sum(axis=1).max()), _kernels.CHAIN)
    links = np.argsort(~used, axis=1, kind="stable")[:, :length]  # used views come first
    chained_at = np.zeros((rows, slopes, length), np.uint64)
    linked_at = np.take_along_axis(at, links[:, :, None], axis=1)
    chained_at[..., : links.shape[1]] = np.swapaxes(linked_at, 1, 2)
    chained = np.zeros((taps, rows, slopes, length), weights.dtype)
    linked = np.take_along_axis(weights, links[None, :, :, None], axis=2)
    chained[..., : links.shape[1]] = np.swapaxes(linked, 2, 3)
    shape = (rows, slopes, -1, _kernels.CHAIN)
    return chained_at.reshape(shape), chained.reshape(taps, *shape)


def check_interpolation(interpolation: str, allowed=INTERPOLATIONS) -> None:
    """Refuse an unknown interpolation."""
    if interpolation not in allowed:
        raise InputError(
            f"interpolation must be one of {', '.join(allowed)}, got {interpolation!r}."
        )


def shift_taps(shifts: np.ndarray, interpolation: str) -> tuple[np.ndarray, np.ndarray]:
    """Find the neighbours that make up ``line[s + shift]``, and their weights.

    Parameters
    ----------
    shifts : ndarray of float64
        Shifts in lenslets, within the range of integers.
    interpolation : {"linear", "nearest", "cubic"}
        "nearest" rounds halves up. "cubic" is the convolution with a = -1/2 of R. Keys, "Cubic
        convolution interpolation for digital image processing", IEEE Trans. ASSP 29 (1981).

    Returns
    -------
    first : ndarray of int64, of the shape of `shifts`
        Offset of the first neighbour: tap j reads ``line[s + first + j]``.
    weights : ndarray of float64, shape (taps, *shape of shifts)
        Weights with sum 1. Shifts are rounded to 2^-24, so that "linear" weights have sum 1 in
        float32 as well.

    Raises
    ------
    InputError
        If the interpolation is unknown.
    """
    check_interpolation(interpolation)
    if interpolation == "nearest":
        return np.floor(shifts + 0.5).astype(np.int64), np.ones((1, *np.shape(shifts)))
    shifts = np.rint(shifts * 2.0**24) / 2.0**24
    whole = np.floor(shifts)
    f = shifts - whole
    if interpolation == "linear":
        return whole.astype(np.int64), np.stack([1 - f, f])
    weights = [
        f * (-0.5 + f * (1 - 0.5 * f)),
        1 + f * f * (-2.5 + 1.5 * f),
        f * (0.5 + f * (2 - 1.5 * f)),
        f * f * (-0.5 + 0.5 * f),
    ]
    return whole.astype(np.int64) - 1, np.stack(weights)
