"""From which slope to which the surfaces of a light field reach."""

from dataclasses import dataclass

import numpy as np

from lf_flame.refocus._arguments import Views, as_views, farthest_slope
from lf_flame.refocus.sharpness import find_sharpest_slopes

SIDE = 192
"""Lenslets of the longer side, about, to which views are averaged: the range needs no more."""

TILE = 12
"""Lenslets of a tile's side there, at least."""

CERTAIN = 0.5
"""Confidence of a tile from which its slope counts."""

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


def find_slope_range(views: Views) -> SlopeRange:
    """Find from which slope to which a scene reaches, by tiles of its views made smaller.

    Parameters
    ----------
    views : LightField or array_like, shape (v, u, t, s) or (v, u, t, s, channels)

    Returns
    -------
    SlopeRange
        Where no tile is certain, -3 to 3, as far as the image allows.
    """
    views = as_views(views)
    limit = farthest_slope(views)
    block = max(1, round(max(views.shape[2:4]) / SIDE))
    small = _averaged(views, block)
    tiles = tuple(max(1, min(12, n // TILE)) for n in small.shape[2:4])
    found = find_sharpest_slopes(small, tiles=tiles)
    sure = [block * one.slope for one in found if one.confidence >= CERTAIN]
    if not sure:
        return SlopeRange(-min(3.0, limit), min(3.0, limit), 0.0, False)
    low, high = min(sure) - MARGIN, max(sure) + MARGIN
    middle = float(np.median(sure))
    certain = len(sure) >= FEWEST * len(found)
    return SlopeRange(max(low, -limit), min(high, limit), middle, certain)


def _averaged(views: np.ndarray, block: int) -> np.ndarray:
    """Average colours, and blocks of lenslets; what a block lacks at the ends is left out."""
    grey = views if views.ndim == 4 else views.mean(axis=4, dtype=np.float32)
    v, u, t, s = grey.shape
    t, s = t // block, s // block
    cut = grey[:, :, : t * block, : s * block].reshape(v, u, t, block, s, block)
    return cut.mean(axis=(3, 5), dtype=np.float32)
