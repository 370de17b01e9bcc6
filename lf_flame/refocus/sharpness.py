"""The slope at which a region of a light field is sharpest.

Sharpness is gradient energy without the changes that focus does not cause
(`lf_flame.refocus.semblance`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise, product

import numpy as np
from numpy.typing import ArrayLike

from lf_flame.errors import InputError
from lf_flame.refocus._arguments import (
    Region,
    Views,
    as_region,
    as_views,
    as_weights,
)
from lf_flame.refocus.sharpness_curves import SlopeSearch, measure_curves

PARTS, SMALLEST_PART = 4, 6
"""Largest number of parts of a region along each axis, and their smallest side in lenslets."""

WORST_LOSS = 0.1
"""Part of the sharpness that one slope for a whole region may cost, where parts of it would be
sharper at slopes of their own; the confidence falls to 0 there. One layer in noise costs up to
0.015, layers at +0.5 and -0.5 some 0.1 to 0.4."""


def find_sharpest_slope(
    light_field: Views,
    slopes: ArrayLike | None = None,
    *,
    region: Region | None = None,
    weights: ArrayLike | None = None,
) -> SlopeSearch:
    """Find the slope at which a region is sharpest.

    Parameters
    ----------
    light_field : LightField or array_like, shape (v, u, t, s) or (v, u, t, s, channels)
        Views; colours are averaged to grey.
    slopes : sequence of float, optional
        Slopes to search, at least three, rising in equal steps. If the steps are wide for the
        number of views, slopes between them are searched too. Default: -3 to 3, then -6 to 6 and
        -12 to 12 if no clear peak lies inside.
    region : (int, int, int, int), optional
        Region ``(t_start, t_stop, s_start, s_stop)`` in lenslets, stops excluded; it should contain
        one layer. Default: the whole image.
    weights : array_like, shape (v, u), optional
        Weight of each view, 0 or above; the light field's own weights multiply them. Default: all
        equal.

    Returns
    -------
    SlopeSearch
        Slope, confidence and sharpness curve.

    Raises
    ------
    InputError
        If an argument cannot be used, if a slope shifts views by more than the image, or if the
        curve has no peak inside the range: it is flat to the rounding of float32 pixels, or still
        rises at an end.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.refocus import find_sharpest_slope
    >>> texture = np.random.default_rng(1).uniform(size=(48, 64))
    >>> views = [[np.roll(texture, (2 - v, 2 - u), (0, 1)) for u in range(5)] for v in range(5)]
    >>> found = find_sharpest_slope(np.array(views))
    >>> round(found.slope, 2)  # each view has moved by a lenslet more
    -1.0
    """
    weights = as_weights(weights, light_field)
    views = as_views(light_field, placed=True)
    height, width = views.shape[2:4]
    whole = (0, height, 0, width)
    region = as_region(whole if region is None else region, (height, width))
    curves = measure_curves(light_field, slopes, [region, *_parts(region)], weights, asked=1)
    if curves.flat[0]:
        raise InputError(
            "No slope is sharpest: the sharpness is the same at all of them, "
            "to the rounding of float32 pixels."
        )
    if curves.rising[0]:
        end = curves.slopes[curves.top[0]]
        raise InputError(
            f"The sharpness still rises at the end of the slopes searched, {curves.slopes[0]:g} to "
            f"{curves.slopes[-1]:g}; search a range that goes beyond {end:g}."
        )
    found = curves.search(0)
    confidence = found.confidence * max(1 - curves.loss / WORST_LOSS, 0)
    return replace(found, confidence=confidence)


def find_sharpest_slopes(
    light_field: Views,
    slopes: ArrayLike | None = None,
    *,
    tiles: tuple[int, int] | None = None,
    regions: Iterable[Region] | None = None,
    weights: ArrayLike | None = None,
) -> list[SlopeSearch]:
    """Find the slope of sharpest focus of each of many regions, in one pass over the views.

    Parameters
    ----------
    light_field, slopes
        As for `find_sharpest_slope`. The default range is shared: it widens while any curve rises
        at an end, or most have no peak.
    tiles : (int, int), optional
        Number of rows and columns of tiles into which the image is cut.
    regions : sequence of (int, int, int, int), optional
        Regions ``(t_start, t_stop, s_start, s_stop)`` in lenslets, instead of tiles.
    weights : array_like, shape (v, u), optional
        As for `find_sharpest_slope`.

    Returns
    -------
    list of SlopeSearch
        Results in the order of the regions, or of the tiles row by row. If a curve has no peak
        inside the range, the slope is NaN and the confidence 0.

    Raises
    ------
    InputError
        If an argument cannot be used, or a slope shifts views by more than the image.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.refocus import find_sharpest_slopes
    >>> texture = np.random.default_rng(1).uniform(size=(48, 64))
    >>> views = [[np.roll(texture, (2 - v, 2 - u), (0, 1)) for u in range(5)] for v in range(5)]
    >>> found = find_sharpest_slopes(np.array(views), tiles=(1, 2))
    >>> [round(one.slope, 1) for one in found]
    [-1.0, -1.0]
    """
    weights = as_weights(weights, light_field)
    views = as_views(light_field, placed=True)
    if tiles is not None and regions is None:
        chosen = _tiles(tiles, views.shape[2:4])
    elif regions is not None and tiles is None:
        chosen = list(regions)
    else:
        raise InputError("Give tiles or regions, and not both.")
    if not chosen:
        raise InputError("regions must hold at least one region, got none.")
    curves = measure_curves(light_field, slopes, chosen, weights)
    return [curves.search(k) for k in range(len(chosen))]


def _parts(region: Region) -> list[Region]:
    """Cut a region into parts, unless it is small."""
    top, bottom, left, right = region
    size = (bottom - top, right - left)
    rows, columns = (max(min(PARTS, side // SMALLEST_PART), 1) for side in size)
    parts = _tiles((rows, columns), size)
    return [(top + a, top + b, left + c, left + d) for a, b, c, d in parts]


def _tiles(tiles: tuple[int, int], size: tuple[int, int]) -> list[Region]:
    """Cut the image into tiles, row by row, with sizes that differ by at most a lenslet."""
    if not all(1 <= n <= m for n, m in zip(tiles, size, strict=True)):
        raise InputError(
            f"tiles must be rows and columns, at least 1 and at most the {size[0]} x {size[1]} "
            f"lenslets, got {tuple(tiles)}."
        )
    edges = ((np.arange(n + 1) * m // n).tolist() for n, m in zip(tiles, size, strict=True))
    rows, columns = (pairwise(along) for along in edges)
    return [(*row, *column) for row, column in product(rows, columns)]
