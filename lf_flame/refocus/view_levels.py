"""The level of each view against the middle one, which falls off towards the corners.

By cos^4, vignetting or the gain of a camera, views of one place differ in brightness; what compares
views takes that for parallax. The level of a view is a polynomial of second order over the image,
by which the view is multiplied. It is fitted to the middle view where both show the same place as
far as is known, by instrumental variables: sums of pixels times powers of their place, which noise
does not bias (Wooldridge, Econometric Analysis of Cross Section and Panel Data, 2010, chapter 5).
"""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import gaussian_filter1d, map_coordinates

from lf_flame._common.arrays import centred

FEWEST = 100
"""Pixels from which a view's level is fitted."""

TURNS = 12
"""Times that a level is fitted anew: fewer leave it drawn to what overlaps in one view only."""

LIT = 0.05
"""Light, in the brightest pixel's, from which a pixel tells of levels: in darkness all are alike,
and what is usual there says nothing of the rest."""

POWERS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
"""Powers of t and s in a level, each from -1 to 1 over the image."""

SMOOTH = 2.0
"""Standard deviation, in pixels of a row, of a Gaussian that takes off noise."""

RIDGE = 1e-3
"""Share of the light by which a level is held to be even where little of the image is lit."""

EVEN, EVEN_OVER_IMAGE = 0.016, 0.016
"""Root-mean-square difference of levels from 1, and change of them over the image, called none:
outlines that hide what is behind them, in noise, make as much, and it harms little."""

EXPLAINED = 0.6
"""Squared difference of levels from 1, in usual squared misfits that they leave, called none: what
they follow by chance in views that have nothing in common, and harmless beside the misfits."""


def even_levels(shape: tuple[int, ...]) -> np.ndarray:
    """Levels of views that are alike: float32, shape (v, u, 6)."""
    levels = np.zeros((*shape, len(POWERS)), np.float32)
    levels[..., 0] = 1
    return levels


def find_levels(
    views: np.ndarray, slope: np.ndarray, rows: np.ndarray, weights: np.ndarray, known: np.ndarray
) -> np.ndarray:
    """Find by what each view is to be multiplied to be as bright as the middle one.

    Parameters
    ----------
    views : ndarray, shape (v, u, t, s)
    slope : ndarray of float64, shape (rows, s)
        Of the pixels in some rows, as far as is known.
    rows : ndarray of int
    weights : ndarray of float64, shape (v, u)
        Views of weight 0 are left as they are.
    known : ndarray of bool, shape of `slope`
        Pixels to look at.

    Returns
    -------
    ndarray of float32, shape (v, u, 6)
        Coefficients of `POWERS`; 1 and zeros where views are alike to `EVEN`.
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
    for v, u in np.argwhere(weights > 0):
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
    """Make how levels change over the image a polynomial of second order over the views.

    Single views do not tell it well; the gain of each is its own.
    """
    v, u = np.meshgrid(down / max(down[-1], 1), across / max(across[-1], 1), indexing="ij")
    terms = np.stack([v, u, v**2, v * u, u**2])[:, weights > 0]
    root = np.sqrt(weights[weights > 0])
    fit = np.linalg.lstsq((terms * root).T, levels[weights > 0, 1:] * root[:, None])[0]
    levels[weights > 0, 1:] = terms.T @ fit


def _read(
    view: np.ndarray,
    places: Sequence[np.ndarray],
    slope: np.ndarray,
    down: float,
    across: float,
):
    """Read a view where it shows the places: its light, powers of where that is, and if inside."""
    at = [place + slope * step for place, step in zip(places, (down, across), strict=True)]
    light = map_coordinates(view, at, np.float64, order=1, mode="nearest")
    light = gaussian_filter1d(light, SMOOTH, axis=1, mode="nearest")
    inside = np.all([(x >= 0) & (x <= n - 1) for x, n in zip(at, view.shape, strict=True)], axis=0)
    t, s = (2 * x / max(n - 1, 1) - 1 for x, n in zip(at, view.shape, strict=True))
    return light, np.stack([t**i * s**j for i, j in POWERS]), inside


def _level(light: np.ndarray, middle: np.ndarray, powers: np.ndarray) -> np.ndarray:
    """Fit a level to pixels; those that are far off, as where something hides them, count less."""
    level, trust = np.eye(len(POWERS))[0], np.ones(light.shape)
    for _ in range(TURNS):
        lit = (trust * light * powers) @ powers.T
        bounds = RIDGE * np.maximum(lit[0, 0], np.finfo(float).tiny) * np.eye(len(POWERS))
        bounds[0, 0] = np.finfo(float).tiny
        rest = (trust * (middle - light)) @ powers.T
        level = np.eye(len(POWERS))[0] + np.linalg.lstsq(lit + bounds, rest)[0]
        square = (light * (level @ powers) - middle) ** 2
        usual = np.median(square)
        trust = usual / (usual + square) if usual > 0 else np.ones(light.shape)
    return level
