"""Which lines of the views make up a line of an image, along one axis, and with which weights."""

from typing import NamedTuple

import numpy as np

from lf_flame.refocus.interpolation import shift_taps
from lf_flame.refocus.shift import view_shifts


class LineSums(NamedTuple):
    """Lines of images as sums of lines of views: shifted, interpolated, averaged over blocks.

    Line k of image n is, in its term p, the sum over v and j of
    ``weights[n, p, v, j] * lines[v, k * block + first[n, v] + j]``, coordinates clamped.

    Attributes
    ----------
    first : ndarray of int64, shape (n, v)
    weights : ndarray of float64, shape (n, p, v, tap)
    block : int
    """

    first: np.ndarray
    weights: np.ndarray
    block: int


def sum_lines(
    slopes: np.ndarray, shares: np.ndarray, length: int, block: int, interpolation: str
) -> LineSums:
    """Plan the sums of lines at some slopes.

    Parameters
    ----------
    slopes : ndarray of float64, shape (n,)
    shares : ndarray of float64, shape (n or 1, p, v)
        Weight of each line of views in each term of an image.
    length : int
        Lenslets along the axis, a whole multiple of the block.
    block : int
        Lenslets that are averaged into one pixel.
    interpolation : str
        As for `lf_flame.refocus.shift_and_sum`.

    Returns
    -------
    LineSums
        A pixel of taps and a block of places together have ``taps + block - 1`` taps.
    """
    first, taps = shift_taps(view_shifts(slopes, shares.shape[2], length), interpolation)
    merged = np.zeros((len(taps) + block - 1, *first.shape))
    for j, tap in enumerate(taps):
        merged[j : j + block] += tap / block
    weights = shares[..., None] * merged.T[:, None]
    return LineSums(first.T.copy(), weights, block)


def split_rows(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Write weights of the views as a sum of products of weights along v and along u.

    Rows of views that have the same weights share a product: one for all views alike, or for a
    single view; a round aperture of 15 x 15 views takes 8.

    Parameters
    ----------
    weights : ndarray of float64, shape (v, u)
        0 or above, at least one above 0.

    Returns
    -------
    down : ndarray of float64, shape (p, v)
    across : ndarray of float64, shape (p, u)
        ``down.T @ across`` are the weights, divided by their sum.
    """
    rows_of: dict[bytes, list[int]] = {}
    for v in np.flatnonzero(weights.any(axis=1)).tolist():
        rows_of.setdefault(weights[v].tobytes(), []).append(v)
    down = np.zeros((len(rows_of), len(weights)))
    for p, rows in enumerate(rows_of.values()):
        down[p, rows] = 1
    return down, weights[[rows[0] for rows in rows_of.values()]] / weights.sum()
