"""Virtual depth of each lenslet of a focused plenoptic camera, by matching of micro-images."""

import numpy as np

from lf_flame.formats.focused._kernels import match
from lf_flame.formats.focused.lenslets import Array, FocusedLenslets


def find_virtual_depth(image: np.ndarray, lenslets: FocusedLenslets, array: Array) -> np.ndarray:
    """Find the virtual depth of each lenslet, shape (rows, columns), in a levelled picture.

    A point is displaced by the pitch over the virtual depth from one micro-image to the next
    (Perwass and Wietzke, Proc. SPIE 8291, 2012). The likeness of a micro-image to its neighbours is
    their covariance, over the places that both see, relative to the geometric mean of their
    variances. It is summed over all neighbours within 1.8 pitches; in a hexagonal array those of
    another kind, which are blurred differently, count little. Its largest value over inverse depths
    from -0.55 to 0.55 (from 0, where the lenslets have ranges) is refined with all neighbours
    within 3.1 pitches.

    A depth is NaN outside the picture, without texture (a likeness below 0.5), where several depths
    fit (another likeness is less than 0.1 lower), or where fewer than two neighbours agree within
    10 %: where texture is faint, single ones match by accident.
    """
    grey = np.ascontiguousarray(image.mean(axis=2, keepdims=True), np.float32)
    pitch, near, far = lenslets.grid.pitch, 1.8, 3.1
    step = 0.5 / (near * pitch)  # displaces the farthest neighbours by half a pixel
    count = int(np.ceil(0.55 / step))
    inverses = step * np.arange(-2 if lenslets.ranges else -count, count + 1)
    coarse = _likeness(grey, lenslets, array, near, np.zeros(array.whole.shape), inverses)
    best = coarse.argmax(axis=2)
    start = inverses[best]
    fine = np.arange(-8, 9) * step / 4
    found = start + _tops(_likeness(grey, lenslets, array, far, start, fine), fine)
    # At inverse depths as near as that, likeness is still that of the same peak.
    apart = np.abs(inverses - start[..., None]) > max(0.07, 2 / pitch)
    other = np.where(apart, coarse, 0).max(axis=2)
    likeness = coarse.max(axis=2)
    known = array.whole & (likeness >= 0.5) & (likeness - other >= 0.1)
    known &= (best > 0) & (best < inverses.size - 1)
    # Above 0.5 no place is seen by two lenslets whole; below 2 pixels any two micro-images match.
    known &= (np.abs(found) <= 0.52) & (np.abs(found) * pitch >= 2)
    found[~known] = np.nan
    found[_agreeing(found, lenslets, array) < 2] = np.nan
    return 1 / found


def _agreeing(inverse: np.ndarray, lenslets: FocusedLenslets, array: Array) -> np.ndarray:
    """Count the nearest neighbours of each lenslet that have its inverse depth within 10 %."""
    count = np.zeros(inverse.shape, int)
    wide = np.pad(inverse, 2, constant_values=np.nan)
    rows, columns = inverse.shape
    for odd, steps in enumerate(_neighbours(lenslets, 1.1)):
        lines = array.rows % 2 == odd
        for row, column in steps:
            other = wide[2 + row : 2 + row + rows, 2 + column : 2 + column + columns]
            count[lines] += (np.abs(other - inverse) < 0.1 * np.abs(inverse))[lines]
    return count


def _likeness(grey, lenslets: FocusedLenslets, array: Array, reach: float, start, steps):
    """Likeness at inverse depths around those in `start`, shape (rows, columns, steps)."""
    radius = lenslets.radius
    stride = max(1.0, radius / 7)  # between places that are compared
    half = int(radius / stride)
    spots = stride * np.mgrid[-half : half + 1, -half : half + 1].reshape(2, -1).T
    spots = np.ascontiguousarray(spots[np.hypot(*spots.T) <= radius])
    odd = (array.rows % 2).astype(np.int64)
    out = np.zeros((*array.whole.shape, len(steps)))
    match(
        grey, array.centres, array.whole, array.kinds, odd, _neighbours(lenslets, reach), spots,
        radius, np.ascontiguousarray(start), steps, out,
    )  # fmt: skip
    return out


def _neighbours(lenslets: FocusedLenslets, reach: float) -> np.ndarray:
    """List the steps to all lenslets within some pitches, of an even and of an odd row."""
    grid = lenslets.grid
    side = int(np.ceil(reach * grid.pitch / min(grid.pitch, grid.row_pitch))) + 1
    near = np.mgrid[-side : side + 1, -side : side + 1].reshape(2, -1)
    steps = []
    for own in (0, 1):
        y, x = grid.position(own + near[0], near[1])
        here = grid.position(own, 0)
        away = np.hypot(y - here[0], x - here[1])
        steps.append(near.T[(away > 0) & (away <= reach * grid.pitch)])
    return np.array(steps, np.int64)


def _tops(likeness: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Places of the largest likeness, by a parabola through the five values around it."""
    top = np.clip(likeness.argmax(axis=2), 2, len(steps) - 3)
    near = np.take_along_axis(likeness, top[..., None] + np.arange(-2, 3), axis=2)
    slope = near @ np.array([-2, -1, 0, 1, 2]) / 10
    bend = near @ np.array([2, -1, -2, -1, 2]) / 14
    shift = np.where(bend < 0, -slope / np.where(bend < 0, 2 * bend, 1), 0)
    return steps[top] + np.clip(shift, -2, 2) * (steps[1] - steps[0])
