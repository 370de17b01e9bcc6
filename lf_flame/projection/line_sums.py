"""Lines of the views that make up a line of an image, along one axis, with their weights."""

from typing import NamedTuple

import numpy as np

from lf_flame._common.arrays import centred
from lf_flame.refocus.shift import shift_taps, view_shifts


class LineSums(NamedTuple):
    """Lines of images as sums of lines of views: shifted, interpolated, averaged over blocks.

    Line k of image n is, in its term p, the sum over v and j of
    ``weights[n, p, v, j] * lines[v, k * block + first[n, v] + j]``, coordinates clamped.

    Attributes
    ----------
    first : ndarray of int64, shape (n, v)
        Offset of the first line that is read.
    weights : ndarray of float64, shape (n, p, v, tap)
        Weight of each line.
    block : int
        Number of lenslets averaged into one pixel.
    """

    first: np.ndarray
    weights: np.ndarray
    block: int


def sum_lines(
    slopes: np.ndarray, shares: np.ndarray, length: int, block: int, interpolation: str
) -> LineSums:
    """Plan the sums of lines at some slopes: interpolation, shift and mean over a block.

    shares[n or 1, p, v]: weight of each line of views in each term of an image. length: number of
    lenslets along the axis, a multiple of `block`, the number averaged into one pixel.
    """
    first, taps = shift_taps(view_shifts(slopes, centred(shares.shape[2]), length), interpolation)
    merged = np.zeros((len(taps) + block - 1, *first.shape))
    for j, tap in enumerate(taps):
        merged[j : j + block] += tap / block
    weights = np.multiply(shares[..., None], merged.T[:, None], order="C")
    return LineSums(first.T.copy(), weights, block)


def split_rows(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Write weights of views as a sum of products of weights along v and along u.

    Rows of views with the same weights share a product: one product suffices for equal weights or
    a single view; a round aperture of 15 x 15 views takes 8.

    Returns factors of shapes (p, v) and (p, u): ``down.T @ across`` are the weights, 0 or above
    with at least one above 0, divided by their sum.
    """
    rows_of: dict[bytes, list[int]] = {}
    for v in np.flatnonzero(weights.any(axis=1)).tolist():
        rows_of.setdefault(weights[v].tobytes(), []).append(v)
    down = np.zeros((len(rows_of), len(weights)))
    for p, rows in enumerate(rows_of.values()):
        down[p, rows] = 1
    return down, weights[[rows[0] for rows in rows_of.values()]] / weights.sum()
