"""Frames of a series whose height is far out of what their neighbours have."""

import numpy as np
from numpy.typing import ArrayLike

NEIGHBOURS = 7
"""Number of frames, the middle one included, of which the median is taken."""

FAR = 6.0
"""Distance from that median in standard deviations, as the median of all distances tells them."""

FEW = 0.05
"""Share of the frames up to which some are outliers; more are a part of the course of heights."""


def find_outliers(heights: ArrayLike, *, least: float = 0.0) -> np.ndarray:
    """Find heights far out of what their neighbours in time have.

    Parameters
    ----------
    heights : array_like, shape (frames,)
        NaN where there is none.
    least : float, optional
        Distance that no outlier is below, in the unit of the heights.

    Returns
    -------
    ndarray of bool, shape (frames,)

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
