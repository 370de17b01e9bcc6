"""Position of a corner or a dot to a small part of a pixel, as the centre of a point symmetry.

A corner of a checkerboard and a round dot look the same after half a turn about their centre,
whatever blurs them alike in all directions. The position x minimises the sum over offsets d in a
disc of ``(I(x + d) - I(x - d))^2``: no model of edges or of blur is needed.
"""

import numpy as np
from scipy.ndimage import map_coordinates, spline_filter

TURNS = 6
"""Largest number of Gauss-Newton steps."""

SETTLED = 3e-4
"""Step in pixels below which a position is final."""


def half_disc(radius: float) -> np.ndarray:
    """Offsets of a half disc, one of each pair d and -d, shape (m, 2), one pixel apart."""
    reach = int(np.ceil(radius))
    rows, columns = (axis.ravel() + 0.5 for axis in np.mgrid[-reach:reach, 0:reach])
    inside = np.hypot(rows, columns) <= radius
    return np.column_stack([rows, columns])[inside]


def centres(image: np.ndarray, starts: np.ndarray, radius: float) -> np.ndarray:
    """Find the centre of symmetry near each starting point.

    Parameters
    ----------
    image : ndarray, shape (t, s)
    starts : ndarray, shape (n, 2)
        Approximate positions, row and column, in pixels.
    radius : float
        Radius in pixels of the disc that is compared with itself.

    Returns
    -------
    ndarray, shape (n, 2)
        Positions; NaN where the disc leaves the image or no centre is within half the radius.
    """
    image = np.asarray(image, float)
    smooth = spline_filter(image, order=3)
    slopes = np.gradient(image)
    offsets = half_disc(radius)
    found = np.array(starts, float)
    moving = np.ones(len(found), bool)
    last = np.array(image.shape) - 1.0
    for _ in range(TURNS):
        inside = np.all((found >= radius) & (found <= last - radius), axis=1)
        lost = ~inside | (np.hypot(*(found - starts).T) > radius / 2)
        found[lost] = np.nan
        live = np.flatnonzero(moving & np.isfinite(found[:, 0]))
        if not len(live):
            break
        there = (found[live, None] + offsets).transpose(2, 0, 1)
        mirrored = (found[live, None] - offsets).transpose(2, 0, 1)
        difference = _sample(smooth, there, 3) - _sample(smooth, mirrored, 3)
        jacobian = np.stack(
            [_sample(slope, there, 1) - _sample(slope, mirrored, 1) for slope in slopes], axis=-1
        )
        normal = np.einsum("nmi,nmj->nij", jacobian, jacobian)
        normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(2) + 1e-300
        right = np.einsum("nmi,nm->ni", jacobian, difference)
        step = np.linalg.solve(normal, right[..., None])[..., 0]
        found[live] -= step
        moving[live] = np.abs(step).max(axis=1) > SETTLED
    return found


def _sample(image: np.ndarray, places: np.ndarray, order: int) -> np.ndarray:
    return map_coordinates(image, places, order=order, prefilter=False, mode="nearest")
