"""Range of slopes of the surfaces in a light field."""

from dataclasses import dataclass
from itertools import product

import numpy as np

from lf_flame.refocus._arguments import (
    Views,
    as_views,
    as_weights,
    farthest_slope,
)
from lf_flame.refocus.focus_map import distinct_by
from lf_flame.refocus.search import find_sharpest_slopes

SIDE = 192
"""Approximate longer side of the reduced views in lenslets; the range needs no more."""

TILE = 12
"""Smallest side of a tile in reduced lenslets."""

CERTAIN, ALONE = 0.5, 0.9
"""Smallest confidence of a tile that counts: if a neighbour agrees, and if none does."""

AGREEING = 0.5
"""Largest difference of slope of neighbours that agree. At an outline a tile may be wrong."""

MARGIN = 0.3
"""Smallest slope added to the range on both sides: a peak at an end would not be trusted."""

BEYOND = 1.2
"""Smallest margin, in differences of slope that the views can distinguish. A slope is certain only
by comparison with one that differs as much; of a single plane, all such are in the margin."""

FEWEST = 0.25
"""Smallest fraction of certain tiles with which the range is certain."""


@dataclass(frozen=True)
class SlopeRange:
    """Range of slopes that contains a scene.

    Attributes
    ----------
    low, high : float
        Ends of the range: the extreme slopes of certain tiles and a margin, in lenslets per view
        step.
    slope : float
        Median slope of the certain tiles.
    certain : bool
        Whether enough of the image has texture for the range to be certain.
    """

    low: float
    high: float
    slope: float
    certain: bool

    def describe(self) -> str:
        """Describe the range in words, and whether it is certain."""
        doubt = "" if self.certain else "; not certain, there is too little texture"
        return f"from slope {self.low:+.2f} to {self.high:+.2f}{doubt}"


def find_slope_range(light_field: Views) -> SlopeRange:
    """Find the range of slopes of a scene, from tiles of its reduced views.

    Parameters
    ----------
    light_field : LightField or array_like, shape (v, u, t, s) or (v, u, t, s, channels)

    Returns
    -------
    SlopeRange
        Range of slopes. If no tile is certain, -3 to 3, as far as the image allows.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.refocus import find_slope_range
    >>> texture = np.random.default_rng(1).uniform(size=(96, 128))
    >>> views = [[np.roll(texture, (2 - v, 2 - u), (0, 1)) for u in range(5)] for v in range(5)]
    >>> found = find_slope_range(np.array(views))
    >>> bool(found.low < -1 < found.high), found.certain
    (True, True)
    """
    weights = as_weights(None, light_field)
    limit = farthest_slope(light_field)
    small, block = _reduced(as_views(light_field))
    tiles = tuple(max(1, min(12, n // TILE)) for n in small.shape[2:4])
    found = find_sharpest_slopes(small, tiles=tiles, weights=weights)
    slopes = block * np.array([one.slope for one in found]).reshape(tiles)
    sure = slopes[_certain(slopes, np.array([one.confidence for one in found]).reshape(tiles))]
    if not sure.size:
        return SlopeRange(-min(3.0, limit), min(3.0, limit), 0.0, False)
    margin = max(MARGIN, BEYOND * distinct_by(weights))
    low, high = float(sure.min()) - margin, float(sure.max()) + margin
    certain = sure.size >= FEWEST * slopes.size
    return SlopeRange(max(low, -limit), min(high, limit), float(np.median(sure)), certain)


def _certain(slopes: np.ndarray, confidence: np.ndarray) -> np.ndarray:
    """Whether each tile counts, shape (rows, columns)."""
    sure = confidence >= CERTAIN
    rows, columns = slopes.shape
    around = np.pad(np.where(sure, slopes, np.nan), 1, constant_values=np.nan)
    agrees = np.zeros(slopes.shape, bool)
    for down, right in product((0, 1, 2), repeat=2):
        if (down, right) != (1, 1):
            neighbour = around[down : down + rows, right : right + columns]
            agrees |= np.abs(neighbour - slopes) < AGREEING
    return sure & (agrees | (confidence >= ALONE))


def _reduced(views: np.ndarray) -> tuple[np.ndarray, int]:
    """Grey views, averaged over blocks of lenslets to a longer side of about `SIDE`.

    Incomplete blocks at the ends are left out. Also returns the lenslets along a block's side, by
    which slopes are smaller.
    """
    block = max(1, round(max(views.shape[2:4]) / SIDE))
    grey = views if views.ndim == 4 else views.mean(axis=4, dtype=np.float32)
    v, u, t, s = grey.shape
    t, s = t // block, s // block
    cut = grey[:, :, : t * block, : s * block].reshape(v, u, t, block, s, block)
    # Sums may exceed float32.
    return cut.mean(axis=(3, 5), dtype=np.float64).astype(np.float32), block
