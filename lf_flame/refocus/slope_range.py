"""From which slope to which the surfaces of a light field reach."""

from dataclasses import dataclass
from itertools import product

import numpy as np

from lf_flame.refocus._arguments import Views, as_views, as_weights, farthest_slope
from lf_flame.refocus.sharpness import find_sharpest_slopes

SIDE = 192
"""Lenslets of the longer side, about, to which views are averaged: the range needs no more."""

TILE = 12
"""Lenslets of a tile's side there, at least."""

CERTAIN, ALONE = 0.5, 0.9
"""Confidence from which a tile's slope counts, where a neighbour agrees and where none does."""

AGREEING = 0.5
"""Neighbours that agree differ by less. At an outline a tile may see what is not there."""

MARGIN = 0.3
"""Slope by which the range reaches beyond the tiles: a peak at an end would not be trusted."""

FEWEST = 0.25
"""Share of the tiles that must be certain for the range to be called so."""


@dataclass(frozen=True)
class SlopeRange:
    """Slopes between which a scene lies.

    Attributes
    ----------
    low, high : float
        Beyond those of the certain tiles by a margin, in lenslets per view step.
    slope : float
        The median of the certain tiles.
    certain : bool
        Whether enough of the image has a slope of its own to say so.
    """

    low: float
    high: float
    slope: float
    certain: bool

    def describe(self) -> str:
        """Say in words from where to where, and whether that is certain."""
        doubt = "" if self.certain else "; not certain, there is too little texture"
        return f"from slope {self.low:+.2f} to {self.high:+.2f}{doubt}"


def find_slope_range(light_field: Views) -> SlopeRange:
    """Find from which slope to which a scene reaches, by tiles of its views made smaller.

    Parameters
    ----------
    light_field : LightField or array_like, shape (v, u, t, s) or (v, u, t, s, channels)

    Returns
    -------
    SlopeRange
        Where no tile is certain, -3 to 3, as far as the image allows.

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
    views = as_views(light_field)
    limit = farthest_slope(views)
    block = max(1, round(max(views.shape[2:4]) / SIDE))
    small = _averaged(views, block)
    tiles = tuple(max(1, min(12, n // TILE)) for n in small.shape[2:4])
    found = find_sharpest_slopes(small, tiles=tiles, weights=weights)
    slopes = block * np.array([one.slope for one in found]).reshape(tiles)
    sure = slopes[_certain(slopes, np.array([one.confidence for one in found]).reshape(tiles))]
    if not sure.size:
        return SlopeRange(-min(3.0, limit), min(3.0, limit), 0.0, False)
    low, high = float(sure.min()) - MARGIN, float(sure.max()) + MARGIN
    certain = sure.size >= FEWEST * slopes.size
    return SlopeRange(max(low, -limit), min(high, limit), float(np.median(sure)), certain)


def _certain(slopes: np.ndarray, confidence: np.ndarray) -> np.ndarray:
    """Whether the slope of each tile counts, shape (rows, columns)."""
    sure = confidence >= CERTAIN
    rows, columns = slopes.shape
    around = np.pad(np.where(sure, slopes, np.nan), 1, constant_values=np.nan)
    agrees = np.zeros(slopes.shape, bool)
    for down, right in product((0, 1, 2), repeat=2):
        if (down, right) != (1, 1):
            neighbour = around[down : down + rows, right : right + columns]
            agrees |= np.abs(neighbour - slopes) < AGREEING
    return sure & (agrees | (confidence >= ALONE))


def _averaged(views: np.ndarray, block: int) -> np.ndarray:
    """Average colours, and blocks of lenslets; what a block lacks at the ends is left out."""
    grey = views if views.ndim == 4 else views.mean(axis=4, dtype=np.float32)
    v, u, t, s = grey.shape
    t, s = t // block, s // block
    cut = grey[:, :, : t * block, : s * block].reshape(v, u, t, block, s, block)
    return cut.mean(axis=(3, 5), dtype=np.float32)
