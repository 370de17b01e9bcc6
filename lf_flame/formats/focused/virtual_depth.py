"""Virtual depth of each lenslet of a focused plenoptic camera, by matching of micro-images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from lf_flame.formats.focused._kernels import match
from lf_flame.formats.focused.lenslets import Array, FocusedLenslets
from lf_flame.formats.focused.levelling import levelled
from lf_flame.formats.raw.sensor_images import as_image

STEEPEST = 0.55
"""Largest inverse virtual depth that is tried. Above 0.5 no place is seen by two lenslets whole."""

LARGEST_INVERSE = 0.52
"""Largest inverse virtual depth that is accepted."""

FIRST_STEP, NEAR = 0.5, 1.8
"""Displacement in pixels from one tried depth to the next between lenslets NEAR pitches apart, the
farthest neighbours of the first search."""

FAR, FINER = 3.1, 4
"""Distance in pitches of the farthest neighbours of the second search; ratio of its steps."""

SPOTS_ACROSS = 14
"""Number of places along the diameter of a micro-image that are compared."""

SMALLEST_PATCH = 2.0
"""Smallest displacement in pixels between neighbouring micro-images at an accepted depth."""

LEAST_LIKENESS, LEAST_CONFIDENCE = 0.5, 0.1
"""Smallest likeness, and smallest difference from that at other depths, of a known depth."""

NEAREST, AGREEMENT, FEWEST_AGREEING = 1.1, 0.1, 2
"""Distance in pitches of the nearest neighbours, and how many of them must have nearly the same
depth, to which relative difference: where texture is faint, single lenslets match by accident."""

SAME_PEAK = 0.07
"""Distance in inverse depth, at least, from which on another depth is another one."""


@dataclass(frozen=True, eq=False)
class VirtualDepth:
    """Virtual depth of each lenslet.

    Attributes
    ----------
    depth : ndarray of float64, shape (rows, columns)
        Virtual depth; NaN where it is unknown: outside the picture, without texture, where several
        depths fit, or where fewer than two neighbours agree within 10 %.
    confidence : ndarray of float64, shape (rows, columns)
        Likeness of the micro-images at this depth less the best at others, 0 to 1.
    array : Array
        Rows, columns and centres of the lenslets.
    """

    depth: np.ndarray
    confidence: np.ndarray
    array: Array

    @property
    def share(self) -> float:
        """Share of the lenslets in the picture with a known depth."""
        return float(np.isfinite(self.depth).sum() / max(self.array.whole.sum(), 1))

    def inverse(self) -> np.ndarray:
        """Inverse depths, those of unknown lenslets from the nearest known one."""
        known = np.isfinite(self.depth)
        nearest = ndimage.distance_transform_edt(
            ~known, return_distances=False, return_indices=True
        )
        return 1 / self.depth[tuple(nearest)]


def find_virtual_depth(raw: ArrayLike, lenslets: FocusedLenslets) -> VirtualDepth:
    """Find the virtual depth of each lenslet from the displacement between micro-images.

    The virtual depth is the distance from the lenslets to the image that the main lens forms, in
    units of the distance from the lenslets to the sensor: a point is displaced by the pitch over
    the virtual depth from one micro-image to the next (Perwass and Wietzke, Proc. SPIE 8291, 2012).

    The likeness of a micro-image to its neighbours is their covariance, over the places that both
    see, relative to the geometric mean of their variances. It is summed over all neighbours within
    1.8 pitches; in a hexagonal array those of another kind, which are blurred differently, count
    little. Its largest value over inverse depths from -0.55 to 0.55 (from 0, where the
    lenslets have ranges) is refined with all neighbours within 3.1 pitches.

    Parameters
    ----------
    raw : array_like, shape (rows, columns) or (rows, columns, channels)
        Raw picture, linear in radiance; channels are averaged. The fall-off of a micro-image
        towards its rim is measured in the picture itself and divided out.
    lenslets : FocusedLenslets

    Returns
    -------
    VirtualDepth

    Raises
    ------
    InputError
        If the picture cannot be used, or holds fewer than 3 x 3 micro-images.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.formats import FocusedLenslets, LensletGrid, find_virtual_depth
    >>> y, x = np.indices((160, 160))
    >>> row, column = y // 20, x // 20
    >>> down, right = y - 20 * row - 9.5, x - 20 * column - 9.5
    >>> y, x = 20 * row + 4 * down, 20 * column + 4 * right
    >>> picture = 2 + np.sin(y**2 / 1500) + np.sin(x**2 / 1700)
    >>> found = find_virtual_depth(picture, FocusedLenslets(LensletGrid(9.5, 9.5, 20)))
    >>> round(float(np.nanmedian(found.depth)), 1)
    4.0
    """
    image = as_image(raw, "raw")
    return match_depth(levelled(image, lenslets), lenslets)


def match_depth(image: np.ndarray, lenslets: FocusedLenslets) -> VirtualDepth:
    """Find virtual depths in a levelled picture, (rows, columns, channels)."""
    grey = np.ascontiguousarray(image.mean(axis=2, keepdims=True), np.float32)
    array = lenslets.array(image.shape)
    pitch = lenslets.grid.pitch
    step = FIRST_STEP / (NEAR * pitch)
    count = int(np.ceil(STEEPEST / step))
    inverses = step * np.arange(-2 if lenslets.ranges else -count, count + 1)
    start = np.zeros(array.whole.shape)
    coarse = _likeness(grey, lenslets, array, NEAR, start, inverses)
    best = coarse.argmax(axis=2)
    start = inverses[best]
    fine = np.arange(-2 * FINER, 2 * FINER + 1) * step / FINER
    found = start + _tops(_likeness(grey, lenslets, array, FAR, start, fine), fine)
    apart = np.abs(inverses - start[..., None]) > max(SAME_PEAK, 2 / pitch)
    other = np.where(apart, coarse, 0).max(axis=2)
    likeness = coarse.max(axis=2)
    confidence = np.clip(likeness - other, 0, 1)
    known = array.whole & (likeness >= LEAST_LIKENESS) & (confidence >= LEAST_CONFIDENCE)
    known &= (best > 0) & (best < inverses.size - 1)
    known &= (np.abs(found) <= LARGEST_INVERSE) & (np.abs(found) * pitch >= SMALLEST_PATCH)
    found[~known] = np.nan
    known &= _agreeing(found, lenslets, array) >= FEWEST_AGREEING
    depth = np.full(known.shape, np.nan)
    depth[known] = 1 / found[known]
    return VirtualDepth(depth, np.where(known, confidence, 0.0), array)


def _agreeing(inverse: np.ndarray, lenslets: FocusedLenslets, array: Array) -> np.ndarray:
    """Count the nearest neighbours of each lenslet that have about its inverse depth."""
    count = np.zeros(inverse.shape, int)
    wide = np.pad(inverse, 2, constant_values=np.nan)
    rows, columns = inverse.shape
    for odd, steps in enumerate(_neighbours(lenslets, NEAREST)):
        lines = array.rows % 2 == odd
        for row, column in steps:
            other = wide[2 + row : 2 + row + rows, 2 + column : 2 + column + columns]
            count[lines] += (np.abs(other - inverse) < AGREEMENT * np.abs(inverse))[lines]
    return count


def _likeness(grey, lenslets: FocusedLenslets, array: Array, reach: float, start, steps):
    """Likeness at inverse depths around those in `start`, shape (rows, columns, steps)."""
    radius = lenslets.radius
    stride = max(1.0, 2 * radius / SPOTS_ACROSS)
    half = int(radius / stride)
    spots = stride * np.mgrid[-half : half + 1, -half : half + 1].reshape(2, -1).T
    spots = spots[np.hypot(*spots.T) <= radius]
    odd = (array.rows % 2).astype(np.int64)
    out = np.zeros((*array.whole.shape, len(steps)))
    around = _neighbours(lenslets, reach)
    match(
        grey, array.centres, array.whole, lenslets.kinds(array), odd, around,
        np.ascontiguousarray(spots), radius, np.ascontiguousarray(start), np.asarray(steps, float),
        out,
    )  # fmt: skip
    return out


def _neighbours(lenslets: FocusedLenslets, reach: float) -> np.ndarray:
    """List the steps to all lenslets within some pitches, of an even and of an odd row."""
    grid = lenslets.grid
    side = int(np.ceil(reach * grid.pitch / min(grid.pitch, grid.row_pitch))) + 1
    near = [(row, column) for row in range(-side, side + 1) for column in range(-side, side + 1)]
    steps = []
    for own in (0, 1):
        at = np.array(grid.position(own, 0))
        places = np.array([grid.position(own + row, column) for row, column in near])
        away = np.hypot(*(places - at).T)
        steps.append([s for s, d in zip(near, away, strict=True) if 0 < d <= reach * grid.pitch])
    return np.array(steps, np.int64)


def _tops(likeness: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Places of the largest likeness, by a parabola through the five values around it."""
    top = np.clip(likeness.argmax(axis=2), 2, len(steps) - 3)
    near = np.take_along_axis(likeness, top[..., None] + np.arange(-2, 3), axis=2)
    slope = near @ np.array([-2, -1, 0, 1, 2]) / 10
    bend = near @ np.array([2, -1, -2, -1, 2]) / 14
    shift = np.where(bend < 0, -slope / np.where(bend < 0, 2 * bend, 1), 0)
    return steps[top] + np.clip(shift, -2, 2) * (steps[1] - steps[0])
