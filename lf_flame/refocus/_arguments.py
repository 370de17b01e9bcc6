"""Checks of arguments that all refocusing methods share."""

from __future__ import annotations

import operator
import reprlib
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from lf_flame._common.arrays import as_numbers
from lf_flame.errors import InputError
from lf_flame.lightfield import LightField, as_view_weights, in_order

Views = LightField | ArrayLike
"""A light field, or its views alone."""

Region = tuple[int, int, int, int]
"""Rows and columns of lenslets, ``(t_start, t_stop, s_start, s_stop)``; stops are excluded."""

READ_AS_THEY_ARE = (np.uint8, np.uint16, np.float32, np.float64)
"""Pixel types for which kernels are compiled; other types are converted."""


def as_views(views: Views) -> np.ndarray:
    """Sub-aperture views of any real type, not copied; NaN and infinity are not checked.

    Unknown pixels of a light field are filled.
    """
    views = views.filled if isinstance(views, LightField) else in_order(views)
    try:
        views = np.asarray(views)
    except ValueError:
        raise InputError("All views must be numbers, and of one shape.") from None
    if views.ndim not in (4, 5) or views.size == 0 or views.dtype.kind not in "biuf":
        raise InputError(
            f"A light field needs views[v, u, t, s] with at least one element, real-valued, "
            f"got an array of shape {views.shape} and type {views.dtype}."
        )
    return views


def as_readable(views: np.ndarray, *, raw: bool = False) -> np.ndarray:
    """Convert views to the type and memory order of the kernels, with a copy only if needed.

    With `raw` they may also lie in memory as in a raw lenslet image, s and u as neighbours.
    """
    if views.dtype not in READ_AS_THEY_ARE:
        wide = np.result_type(views.dtype, np.float32) != np.float32
        views = views.astype(np.float64 if wide else np.float32)
    size = views.itemsize
    if raw and views.ndim == 4 and views.strides[1::2] == (size, views.shape[1] * size):
        return views
    return np.ascontiguousarray(views)


def as_grey(light_field: Views) -> np.ndarray:
    """Average the channels of finite views: shape (v, u, t, s), of a type that kernels read."""
    views = as_views(light_field)
    refuse_not_finite(views)
    return as_readable(views if views.ndim == 4 else views.mean(axis=4, dtype=np.float32))


def for_slopes(stack: np.ndarray, slopes: ArrayLike) -> np.ndarray:
    """Return the stack for several slopes, and the image itself for a single slope."""
    return stack[0] if np.ndim(slopes) == 0 else stack


def as_slopes(slopes: ArrayLike) -> np.ndarray:
    slopes = np.atleast_1d(as_numbers(slopes, "slopes"))
    if slopes.ndim != 1 or slopes.size == 0 or not np.all(np.isfinite(slopes)):
        raise InputError(f"slopes must be one or more finite numbers, got {shown(slopes)}.")
    return slopes


def farthest_slope(views: Views) -> float:
    """Slope at which the outermost views are shifted by the whole image, in lenslets per view.

    Parameters
    ----------
    views : LightField or array_like, shape (v, u, t, s) or (v, u, t, s, channels)

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.refocus import farthest_slope
    >>> farthest_slope(np.ones((5, 5, 24, 30)))
    12.0
    """
    v, u, t, s = as_views(views).shape[:4]
    limits = [2 * n / (count - 1) for n, count in ((t, v), (s, u)) if count > 1]
    return min(limits, default=2.0 * max(t, s))


def as_steps(slopes: ArrayLike) -> np.ndarray:
    """Slopes to search: three or more, increasing in equal steps."""
    slopes = as_slopes(slopes)
    steps = np.diff(slopes)
    rounding = 1e-6 * np.abs(slopes).max()  # of float32
    if len(slopes) < 3 or steps[0] <= 0 or not np.allclose(steps, steps[0], atol=rounding):
        raise InputError(
            f"slopes to search must be three or more in equal steps upwards, got {shown(slopes)}."
        )
    return slopes


def shown(numbers: np.ndarray) -> str:
    """Write numbers on one line; of many, the middle ones are left out."""
    return np.array2string(numbers, threshold=8, max_line_width=10_000)


def refuse_not_finite(views: np.ndarray) -> None:
    """Refuse NaN and infinite pixels; the error says how many there are."""
    bad = sum(np.count_nonzero(~np.isfinite(row)) for row in views)  # by rows, to save memory
    if bad:
        raise InputError(f"A light field must be finite, got {bad} NaN or infinite pixels.")


def refuse_infinite(images: np.ndarray, views: np.ndarray) -> None:
    """Refuse views of which images are not finite."""
    if not all(np.isfinite(row).all() for row in images):
        refuse_not_finite(views)
        most = np.abs(views).max()
        raise InputError(f"Pixels are too large for float32, got up to {most:.3g}: scale them.")


def as_weights(weights: ArrayLike | None, views: Views) -> np.ndarray:
    """Weights of views, (v, u), 1 if none are given, times the light field's own; not all 0."""
    shape = as_views(views).shape[:2]
    own = views.weights if isinstance(views, LightField) else None
    stated = (
        np.ones(shape)
        if weights is None
        else as_view_weights(as_numbers(weights, "weights"), shape)
    )
    if own is None:
        return stated
    both = stated * own
    if not 0 < both.sum() < np.inf:
        raise InputError(
            "All views that the weights choose are excluded from this light field (weight 0); "
            "choose a wider aperture."
        )
    return both


def as_region(region: ArrayLike, size: tuple[int, ...]) -> Region:
    """Check that a region is four integers, inside an image with `size` lenslets (t, s)."""
    edges = np.asarray(region) if np.shape(region) == (4,) else np.empty(0)
    if edges.dtype.kind in "iu":
        top, bottom, left, right = (int(edge) for edge in edges)
        if 0 <= top < bottom <= size[0] and 0 <= left < right <= size[1]:
            return top, bottom, left, right
    raise InputError(
        f"A region must be (t_start, t_stop, s_start, s_stop), four whole numbers inside the "
        f"{size[0]} x {size[1]} lenslets, got {reprlib.repr(region)}."
    )


def as_block(block: Sequence[int], lenslets: tuple[int, ...]) -> tuple[int, int]:
    """Check the number of lenslets (t, s) that are averaged into one pixel."""
    try:
        down, across = (operator.index(n) for n in block)
    except (TypeError, ValueError):
        raise InputError(f"A block is two whole numbers, got {block!r}.") from None
    if min(down, across) < 1 or lenslets[0] % down or lenslets[1] % across:
        raise InputError(
            f"Blocks of {down} x {across} lenslets do not divide an image of {lenslets[0]} x "
            f"{lenslets[1]}."
        )
    return down, across


def as_view_indices(view_indices: Sequence[tuple[int, int]], shape: tuple[int, ...]) -> np.ndarray:
    """Check rows and columns of views against the light field's number of views, [k, 2]."""
    try:
        indices = np.asarray(view_indices)
    except ValueError:  # of unequal lengths
        indices = np.empty(0)
    if indices.ndim != 2 or indices.shape[1:] != (2,) or indices.dtype.kind not in "iu":
        raise InputError(f"Views are indexed by pairs of row and column, got {view_indices!r}.")
    for v, u in indices.tolist():
        if not (0 <= v < shape[0] and 0 <= u < shape[1]):
            raise InputError(
                f"There is no view ({v}, {u}) in a light field of {shape[0]} x {shape[1]} views, "
                f"counted from 0."
            )
    return indices


def refuse_excluded(views: Views, indices: Iterable[tuple[int, int]], what: str) -> None:
    """Refuse a light field in which a view that `what` needs has weight 0, as a missing one has."""
    own = views.weights if isinstance(views, LightField) else None
    for v, u in indices:
        if own is not None and own[v, u] == 0:
            raise InputError(
                f"{what} needs the view in row {v}, column {u} (from 0), which is excluded from "
                f"this light field: it is missing, or contains other light."
            )


def by_channel(refocus, views: np.ndarray, slopes: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Refocus each channel of a colour light field in turn."""
    if views.ndim == 4:
        return refocus(views, slopes, weights)
    channels = [refocus(views[..., c], slopes, weights) for c in range(views.shape[4])]
    return np.stack(channels, axis=-1)
