"""Slope map of a light field, image with everything in focus, and the range of slopes.

The slope of a pixel is the one at which the views that see its point match the central view
(`lf_flame.refocus.matching`), chosen together with those of its surroundings, guided by the image
(`lf_flame.refocus.semi_global`).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter

from lf_flame._common.arrays import centred
from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.refocus._arguments import (
    Views,
    as_grey,
    as_steps,
    as_views,
    as_weights,
    farthest_slope,
    refuse_excluded,
)
from lf_flame.refocus.matching import ComparedViews
from lf_flame.refocus.refinement import refine_slopes
from lf_flame.refocus.search import DEFAULT_RANGES, find_sharpest_slopes
from lf_flame.refocus.semi_global import choose_slopes
from lf_flame.refocus.shift import check_interpolation
from lf_flame.refocus.surface import refocus_surface

TRUSTED = 0.2
"""Smallest confidence of a certain slope."""

MAP_STEPS = 33
"""Number of slopes in the stack from which commands and pages make a slope map."""

SIDE = 192
"""Approximate longer side of the reduced views in lenslets; the range needs no more."""

TILE = 12
"""Smallest side of a tile in reduced lenslets."""

CERTAIN, ALONE = 0.5, 0.9
"""Smallest confidence of a certain tile: if a neighbour agrees, and if none does."""

AGREEING = 0.5
"""Largest difference of slope of neighbours that agree. At an outline a tile may be wrong."""

MARGIN = 0.3
"""Smallest slope added to the range on both sides: a peak at an end would not be trusted."""

BEYOND = 1.2
"""Smallest margin, in differences of slope that the views can distinguish. A slope is certain only
by comparison with one that differs as much; of a single plane, all such are in the margin."""

FEWEST = 0.25
"""Smallest fraction of certain tiles with which the range is certain."""


@dataclass(frozen=True, eq=False, repr=False)
class FocusMap:
    """Slope map and image with everything in focus, from `all_in_focus`.

    Transparent objects, such as flames behind each other, have no single slope, and the map does
    not show this: for flames use `lf_flame.tomography.reconstruct`.

    Attributes
    ----------
    slope : ndarray of float64, shape (t, s)
        Slope of each pixel, in lenslets per view step: mean of its own and of neighbours of similar
        brightness with about the same slope.
    confidence : ndarray of float64, shape (t, s)
        Confidence from 0 to 1; a slope is certain at 0.2 or more. It is the share of neighbours of
        similar brightness whose own best slope agrees, to 0.3 lenslets in the outermost view,
        minus the share of the others, at least 0. Best slopes that are the first or
        last agree with none. Texture that repeats, and reflections that glide over a smooth
        surface, agree on wrong slopes.
    all_in_focus : ndarray of float32, shape (t, s) or (t, s, channels)
        Image with every pixel refocused at its slope.
    """

    slope: np.ndarray
    confidence: np.ndarray
    all_in_focus: np.ndarray

    def __repr__(self) -> str:
        low, high = float(self.slope.min()), float(self.slope.max())
        certain = float(np.mean(self.confidence >= TRUSTED))
        return f"FocusMap(slopes {low:+.2f} to {high:+.2f}, {certain:.0%} certain)"


def all_in_focus(
    light_field: Views,
    slopes: ArrayLike,
    *,
    window: float = 3.0,
    interpolation: str = "linear",
    weights: ArrayLike | None = None,
) -> FocusMap:
    """Find the slope map of a light field and refocus every pixel at its slope.

    A pixel's slope is the one at which the views that see it match the central view best; near an
    outline half of the views are compared, or a quarter (`lf_flame.refocus.matching`). Where this
    is uncertain, for example without texture, the slope comes from the surroundings, up to the
    edges of the central view (`lf_flame.refocus.semi_global`). Finally slopes are refined between
    the steps of the search (`lf_flame.refocus.refinement`). The image is refocused on the resulting
    surface (`refocus_surface`), not selected from slices, so that it has no seams.

    Parameters
    ----------
    light_field : LightField or array_like, shape (v, u, t, s) or (v, u, t, s, channels)
    slopes : sequence of float
        Slopes to search, in lenslets per view step, at least three, increasing in equal steps. A
        peak at the first or last is not trusted: include one step more on each side than the scene
        needs.
    window : float, optional
        Standard deviation, in lenslets, of the Gaussian by which neighbours are weighted; it
        reaches at most 24 lenslets.
    interpolation : optional
        Interpolation for the image, as in `refocus_surface`.
    weights : array_like, shape (v, u), optional
        Weight of each view, 0 or above, in the match and in the image; the light field's own
        weights multiply them. Default: all equal.

    Returns
    -------
    FocusMap
        Slope map, confidence and image.

    Raises
    ------
    InputError
        If an argument cannot be used, or a pixel is NaN or infinite.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.refocus import all_in_focus
    >>> texture = np.random.default_rng(1).uniform(size=(48, 64))
    >>> views = [[np.roll(texture, (2 - v, 2 - u), (0, 1)) for u in range(5)] for v in range(5)]
    >>> found = all_in_focus(np.array(views), np.linspace(-2, 2, 17))
    >>> round(float(np.median(found.slope)), 2)  # content moves by -1 lenslet a view
    -1.0
    """
    weights = as_weights(weights, light_field)
    check_interpolation(interpolation)
    if not 0 < window < np.inf:
        raise InputError(f"window must be a number of lenslets above 0, got {window}.")
    views, slopes = as_grey(light_field), as_steps(slopes)
    down, right = (((n - 1) // 2, n // 2) for n in views.shape[:2])
    refuse_excluded(
        light_field, product(down, right), "A slope map, which compares all views with one,"
    )
    compared = ComparedViews(views, slopes, weights)
    # The light field's own weights are among these already.
    own = light_field
    if isinstance(own, LightField):
        own = LightField.trusted(own.views, valid=own.valid)
    slope, confidence, guide, limit = _matched(compared, own, window, weights)
    if not compared.even and compared.find_levels(slope, confidence >= TRUSTED):
        slope, confidence, guide, limit = _matched(compared, own, window, weights)
    slope = refine_slopes(compared, slope, guide, limit)
    image = refocus_surface(own, slope, interpolation=interpolation, weights=weights)
    return FocusMap(slope, confidence, image)


def _matched(
    compared: ComparedViews, light_field: Views, window: float, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Slopes at which compared views match best, their confidence, the guide, and the limit."""
    slopes, limit = compared.slopes, compared.limit()
    costs = compared.costs(limit)
    best = slopes[costs.argmin(axis=2)]
    picture = _middle(as_views(light_field), best)
    grey = picture.mean(axis=2) if picture.ndim == 3 else picture
    guide = gaussian_filter(grey, 1.0)  # smooth enough that noise makes no edges
    return *choose_slopes(costs, slopes, guide, window, distinct_by(weights)), guide, limit


def distinct_by(weights: np.ndarray) -> float:
    """Smallest difference of slopes that views with these weights, (v, u), can distinguish.

    It moves the outermost view by a lenslet.
    """
    used = np.argwhere(weights > 0) - (np.array(weights.shape) - 1) / 2
    farthest = float(np.abs(used).max())
    return 1.0 / max(farthest, 0.5)


def _middle(views: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Central view; for an even number of views, the mean of the central ones on the surface."""
    down, right = (np.abs(centred(n)) < 1 for n in views.shape[:2])
    if down.sum() == right.sum() == 1:
        return views[views.shape[0] // 2, views.shape[1] // 2].astype(np.float32, copy=False)
    return refocus_surface(views, slope, weights=np.outer(down, right))


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
    share, searched : float
        Share of the image whose slope is certain, and largest slope searched, in both directions.
    """

    low: float
    high: float
    slope: float
    share: float = 1.0
    searched: float = np.inf

    @property
    def certain(self) -> bool:
        """Whether enough of the image has a certain slope."""
        return self.share >= FEWEST

    def describe(self) -> str:
        """Describe the range in words, and whether it is certain."""
        doubt = (
            f"; not certain: {self.share:.0%} of the image has a clear slope up to "
            f"{self.searched:.3g}; there is too little texture, or its slopes are larger"
        )
        return f"from slope {self.low:+.2f} to {self.high:+.2f}{'' if self.certain else doubt}"


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
    small, block = _reduced(as_grey(light_field))
    tiles = tuple(max(1, min(12, n // TILE)) for n in small.shape[2:4])
    found = find_sharpest_slopes(small, tiles, weights)
    slopes = block * np.array([one.slope for one in found]).reshape(tiles)
    sure = slopes[_certain(slopes, np.array([one.confidence for one in found]).reshape(tiles))]
    searched = min(block * DEFAULT_RANGES[-1], limit)
    if not sure.size:
        return SlopeRange(-min(3.0, limit), min(3.0, limit), 0.0, 0.0, searched)
    margin = max(MARGIN, BEYOND * distinct_by(weights))
    low, high = float(sure.min()) - margin, float(sure.max()) + margin
    ends, share = (max(low, -limit), min(high, limit)), sure.size / slopes.size
    middle = float(np.percentile(sure, 50, method="lower"))  # not between two planes
    return SlopeRange(*ends, middle, share, searched)


def _certain(slopes: np.ndarray, confidence: np.ndarray) -> np.ndarray:
    """Whether each tile is certain, shape (rows, columns)."""
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
    """Average grey views over blocks of lenslets to a longer side of about `SIDE`.

    Incomplete blocks at the ends are left out. Also returns the lenslets along a block's side, by
    which slopes are smaller.
    """
    block = max(1, min(round(max(views.shape[2:]) / SIDE), *views.shape[2:]))
    v, u, t, s = views.shape
    t, s = t // block, s // block
    cut = views[:, :, : t * block, : s * block].reshape(v, u, t, block, s, block)
    # Sums may exceed float32.
    return cut.mean(axis=(3, 5), dtype=np.float64).astype(np.float32), block
