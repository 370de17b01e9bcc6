"""Signals of a furnace or lamp in pictures of it: means over its even part."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from lf_flame.errors import InputError

LIT = 0.8
"""Brightness of the source's even part, relative to its brightest hundredth."""

RIM = 2
"""Number of pixels from the edge of the even part that are left out."""

FEWEST_PIXELS = 100
"""Smallest number of pixels of the even part."""

MOST_UNEVEN = 0.05
"""Largest relative standard deviation within the even part without a warning."""


@dataclass(frozen=True, eq=False)
class SourceSignals:
    """Signals of a source in each picture and colour.

    Attributes
    ----------
    signals : ndarray of float64, shape (pictures, colours)
    mask : ndarray of bool, shape (rows, columns)
        Even part of the source.
    uneven : float
        Largest relative standard deviation within it, of the mean of all pictures.
    """

    signals: np.ndarray
    mask: np.ndarray
    uneven: float


def measure_source(photographs: Sequence[np.ndarray]) -> SourceSignals:
    """Average the evenly bright part of a source, which is in the same place in all pictures.

    Parameters
    ----------
    photographs : sequence of ndarray, shape (rows, columns, colours)
        Photographs, linear in light, black subtracted.

    Returns
    -------
    SourceSignals
        Mean of each colour in each picture over the part that is evenly bright.

    Raises
    ------
    InputError
        If the pictures differ in shape, or no part of them is evenly bright.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.tomography import measure_source
    >>> y, x = np.mgrid[:40, :60]
    >>> disc = (np.hypot(y - 20, x - 30) < 15)[..., None] * np.array([0.2, 0.5])
    >>> measure_source([disc, 2 * disc]).signals.round(6).tolist()
    [[0.2, 0.5], [0.4, 1.0]]
    """
    shapes = {one.shape for one in photographs}
    if len(shapes) != 1 or len(next(iter(shapes))) != 3:
        raise InputError(
            f"The pictures of the source must be in colour and of one size, got {sorted(shapes)}."
        )
    # Each picture and colour counts alike: the source is dark in blue, and where it is cold.
    scaled = [one / max(float(np.max(one)), 1e-300) for one in map(_by_colour, photographs)]
    bright = np.mean(scaled, axis=0)
    smooth = ndimage.uniform_filter(bright, 3)
    mask = smooth > LIT * np.percentile(smooth, 99)
    mask = ndimage.binary_erosion(mask, iterations=RIM) if not mask.all() else mask
    if mask.sum() < FEWEST_PIXELS:
        raise InputError(
            f"The source must be evenly bright over {FEWEST_PIXELS} pixels or more, and only "
            f"{int(mask.sum())} are: bring it nearer, or into focus."
        )
    signals = [one[mask].mean(axis=0, dtype=np.float64) for one in photographs]
    uneven = float(smooth[mask].std() / smooth[mask].mean())
    return SourceSignals(np.stack(signals), mask, uneven)


def _by_colour(photograph: np.ndarray) -> np.ndarray:
    """Sum of the colours, each scaled to its own brightest hundredth."""
    tops = np.percentile(photograph, 99, axis=(0, 1))
    return (photograph / np.where(tops > 0, tops, 1.0)).sum(axis=2)
