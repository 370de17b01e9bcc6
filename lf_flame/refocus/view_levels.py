"""Level of each view relative to the central one; it falls towards the corners.

Because of cos^4, vignetting or gains, views of one point differ in brightness, which a
comparison of views would mistake for parallax. The level of a view is a polynomial of second order
over the image, by which the view is multiplied. It is fitted to the central view where both
probably show the same point, by instrumental variables: sums of pixels times powers of their
coordinates, which noise does not bias (Wooldridge, Econometric Analysis of Cross Section and Panel
Data, 2010, chapter 5).
"""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import gaussian_filter1d, map_coordinates

from lf_flame._common.arrays import centred

FEWEST = 100
"""Smallest number of pixels with which a view's level is fitted."""

TURNS = 12
"""Largest number of fits of a level; with fewer, points occluded in one view still bias it."""

SETTLED = 1e-4
"""Largest change of a level that ends the fits."""

LIT = 0.05
"""Smallest light, relative to the brightest pixel, of a pixel that is used for levels: in darkness
all views are equal, and the usual misfit there says nothing about the rest."""

POWERS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
"""Powers of the coordinates t and s in a level; each runs from -1 to 1 over the image."""

SMOOTH = 2.0
"""Standard deviation of the Gaussian that suppresses noise, in pixels of a row."""

RIDGE = 1e-3
"""Strength of the regularisation towards level 1 (ridge), relative to the light; it matters where
little of the image is lit."""

EVEN, EVEN_OVER_IMAGE = 0.016, 0.016
"""Largest root-mean-square difference of levels from 1, and largest change over the image, that are
neglected: occluding outlines in noise cause as much, and the effect is small."""

EXPLAINED = 0.6
"""Largest squared difference of levels from 1, relative to the usual squared misfit, that is
neglected: chance causes it in unrelated views, and it is small relative to the misfits."""


def even_levels(shape: tuple[int, ...]) -> np.ndarray:
    """Levels of views of equal brightness: float32, shape (v, u, 6)."""
    levels = np.zeros((*shape, len(POWERS)), np.float32)
    levels[..., 0] = 1
    return levels


def find_levels(
    views: np.ndarray, slope: np.ndarray, rows: np.ndarray, weights: np.ndarray, known: np.ndarray
) -> np.ndarray:
    """Find the factor, over the image, that makes each view as bright as the central one.

    Uses pixels `known` of given rows, with their approximate slopes; views of weight 0 get level 1.
    Returns coefficients of `POWERS`, (v, u, 6): 1 and zeros if views differ by at most `EVEN`.
    """
    levels = even_levels(views.shape[:2])
    down, across = (centred(n) for n in views.shape[:2])
    places = np.meshgrid(rows, np.arange(views.shape[3]), indexing="ij")
    middle = np.mean(
        [
            _read(views[v, u], places, slope, down[v], across[u])[0]
            for v in np.flatnonzero(np.abs(down) < 1)
            for u in np.flatnonzero(np.abs(across) < 1)
        ],
        axis=0,
    )
    fits = []
    for v, u in np.argwhere(weights > 0).tolist():
        light, powers, inside = _read(views[v, u], places, slope, down[v], across[u])
        inside &= known & (light + middle > LIT * (light + middle).max())
        if max(abs(down[v]), abs(across[u])) < 1 or np.count_nonzero(inside) < FEWEST:
            continue
        light, there, powers = light[inside], middle[inside], powers[:, inside]
        levels[v, u] = found = _level(light, there, powers)
        usual = np.median((found @ powers * light - there) ** 2)
        chance = EXPLAINED * usual / max(np.mean(light**2), np.finfo(float).tiny)
        fits.append((weights[v, u], v, u, powers @ powers.T / powers.shape[1], chance))
    _smooth_over_views(levels, down, across, weights)
    even = even_levels(views.shape[:2])
    for some, least in ((slice(1, None), EVEN_OVER_IMAGE), (slice(None), EVEN)):
        off = np.zeros_like(levels)
        off[..., some] = (levels - even)[..., some]
        uneven = sum(weight * off[v, u] @ squares @ off[v, u] for weight, v, u, squares, _ in fits)
        if uneven <= sum(weight * (least**2 + chance) for weight, *_, chance in fits):
            levels[..., some] = even[..., some]
    return levels


def _smooth_over_views(
    levels: np.ndarray, down: np.ndarray, across: np.ndarray, weights: np.ndarray
) -> None:
    """Fit the change of levels over the image with a polynomial of second order over the views.

    Single views determine it poorly; the mean level (gain) of each view is kept.
    """
    v, u = np.meshgrid(down / max(down[-1], 1), across / max(across[-1], 1), indexing="ij")
    terms = np.stack([v, u, v**2, v * u, u**2])[:, weights > 0]
    root = np.sqrt(weights[weights > 0])
    fit = np.linalg.lstsq((terms * root).T, levels[weights > 0, 1:] * root[:, None])[0]
    levels[weights > 0, 1:] = terms.T @ fit


def _read(
    view: np.ndarray, places: Sequence[np.ndarray], slope: np.ndarray, down: float, across: float
):
    """Read a view where it shows the points: light, powers of the coordinates, and if inside."""
    at = [place + slope * step for place, step in zip(places, (down, across), strict=True)]
    light = map_coordinates(view, at, np.float64, order=1, mode="nearest")
    light = gaussian_filter1d(light, SMOOTH, axis=1, mode="nearest")
    inside = np.all([(x >= 0) & (x <= n - 1) for x, n in zip(at, view.shape, strict=True)], axis=0)
    t, s = (2 * x / max(n - 1, 1) - 1 for x, n in zip(at, view.shape, strict=True))
    return light, np.stack([t**i * s**j for i, j in POWERS]), inside


def _level(light: np.ndarray, middle: np.ndarray, powers: np.ndarray) -> np.ndarray:
    """Fit a level to pixels; those far off, for example occluded ones, have less weight."""
    level, trust = np.eye(len(POWERS))[0], np.ones(light.shape)
    for _ in range(TURNS):
        lit = (trust * light * powers) @ powers.T
        bounds = RIDGE * np.maximum(lit[0, 0], np.finfo(float).tiny) * np.eye(len(POWERS))
        bounds[0, 0] = np.finfo(float).tiny
        rest = (trust * (middle - light)) @ powers.T
        before, level = level, np.eye(len(POWERS))[0] + np.linalg.lstsq(lit + bounds, rest)[0]
        if np.abs(level - before).max() < SETTLED:
            break
        square = (light * (level @ powers) - middle) ** 2
        usual = np.median(square)
        trust = usual / (usual + square) if usual > 0 else np.ones(light.shape)
    return level
