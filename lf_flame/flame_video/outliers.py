"""Outliers: frames with a height far from that of their neighbours."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

NEIGHBOURS = 7
"""Number of frames of the running median, including the central one."""

FAR = 6.0
"""Smallest distance of an outlier from the median, in standard deviations estimated from the median
of all distances."""

FEW = 0.05
"""Largest fraction of frames that can be outliers; more are part of the course of the heights."""


def find_outliers(heights: ArrayLike, *, least: float = 0.0) -> np.ndarray:
    """Find heights far from those of their neighbours in time.

    Parameters
    ----------
    heights : array_like, shape (frames,)
        Heights; NaN where there is none.
    least : float, optional
        Smallest distance of an outlier, in the unit of the heights.

    Returns
    -------
    ndarray of bool, shape (frames,)
        Whether each height is an outlier; all False if more than 5 % would be.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.flame_video import find_outliers
    >>> heights = 20 + np.random.default_rng(1).normal(0, 0.1, 100)
    >>> heights[40] = 3.0
    >>> np.flatnonzero(find_outliers(heights)).tolist()
    [40]
    """
    heights = np.asarray(heights, np.float64)
    known = np.flatnonzero(np.isfinite(heights))
    found = np.zeros(len(heights), bool)
    if len(known) < NEIGHBOURS:
        return found
    values = np.pad(heights[known], NEIGHBOURS // 2, mode="reflect")
    medians = np.median(np.lib.stride_tricks.sliding_window_view(values, NEIGHBOURS), axis=1)
    distances = np.abs(heights[known] - medians)
    far = distances > max(least, FAR * 1.4826 * float(np.median(distances)))
    if np.count_nonzero(far) <= FEW * len(known):
        found[known[far]] = True
    return found
