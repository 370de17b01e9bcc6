"""Corners of a checkerboard, or dots of a regular grid: their lattice, and exact positions.

A corner of a checkerboard and a round dot look the same after half a turn about their centre,
under any blur that is equal in all directions. The position x minimises the sum over offsets d in a
disc of ``(I(x + d) - I(x - d))^2``: no model of edges or of blur is needed.
"""

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates, spline_filter
from scipy.spatial import cKDTree

from lf_flame.errors import InputError

LEAST_POINTS = 9
"""Smallest number of corners, those of a board of 4 x 4 squares."""


def find_lattice(image: np.ndarray, *, dots: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Find the corners of a checkerboard, or dots, and number them by row and column.

    Gives row and column of each point, from any origin, and its approximate position in pixels,
    each of shape (n, 2). The target may be rotated, and cut off by the borders.
    """
    image = np.asarray(image, float)
    middle = (np.array(image.shape) - 1) / 2
    best: dict[tuple[int, int], int] = {}
    points = np.empty((0, 2))
    # Saddles of brightness are searched for at three scales of smoothing.
    for found in [_dots(image)] if dots else (_saddles(image, scale) for scale in (1.0, 2.0, 4.0)):
        # The lattice grows from a dozen points around the centre; most points in it are enough.
        seeds = np.argsort(np.hypot(*(found - middle).T))[:12] if len(found) > 4 else ()
        for seed in seeds:
            grown = _grow(found, seed)
            if not dots:
                grown = _true_corners(image, found, grown)
            if len(grown) > len(best):
                best, points = grown, found
            if len(grown) > 0.6 * len(found):
                break
    indices = np.array(list(best), int).reshape(-1, 2)
    refuse_few(indices, dots=dots)
    return indices, points[list(best.values())]


def refuse_few(indices: np.ndarray, *, dots: bool) -> None:
    """Refuse a target of which too few corners or dots are found."""
    rows, columns = (len(np.unique(column)) for column in indices.T)
    if len(indices) < LEAST_POINTS or min(rows, columns) < 3:
        what, target = ("dots", "a grid of dots") if dots else ("corners", "a checkerboard")
        raise InputError(
            f"The target must show at least 3 x 3 {what} in rows and columns, got {len(indices)} "
            f"in {rows} x {columns}: let it fill more of the picture, lit evenly, or check that it "
            f"is {target}."
        )


def lattice_steps(indices: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Find the steps in pixels to the next row and to the next column, shape (2, 2)."""
    design = np.column_stack([indices, np.ones(len(indices))])
    return np.linalg.lstsq(design, points, rcond=None)[0][:2]


def _saddles(image: np.ndarray, scale: float) -> np.ndarray:
    """Positions of the saddles of brightness; the corners of a checkerboard are strong ones."""
    from skimage.feature import peak_local_max

    orders = ((2, 0), (0, 2), (1, 1))
    rows, columns, mixed = (gaussian_filter(image, scale, order) for order in orders)
    response = mixed**2 - rows * columns
    peaks = peak_local_max(response, min_distance=2, exclude_border=2)
    if len(peaks) < LEAST_POINTS:
        return np.empty((0, 2))
    strength = response[tuple(peaks.T)]
    return peaks[strength > 0.15 * np.median(np.sort(strength)[-4 * LEAST_POINTS :])].astype(float)


def _dots(image: np.ndarray) -> np.ndarray:
    """Centres of the dots, dark on bright or bright on dark."""
    from skimage.filters import threshold_otsu
    from skimage.measure import label, regionprops
    from skimage.segmentation import clear_border

    if np.ptp(image) == 0:
        return np.empty((0, 2))
    smooth = gaussian_filter(image, 0.7)
    bright = smooth > threshold_otsu(smooth)
    # Dots cover less than half of the target.
    whole = regionprops(clear_border(label(bright if bright.mean() < 0.5 else ~bright)))
    usual = np.median([one.area for one in whole]) if whole else 0.0
    alike = [one.centroid for one in whole if 0.4 * usual < one.area < 2.5 * usual]
    return np.array(alike).reshape(-1, 2)


def _grow(points: np.ndarray, seed: int) -> dict[tuple[int, int], int]:
    """Place points at rows and columns, from a seed outward: number of the point at each."""
    tree = cKDTree(points)
    near = tree.query(points[seed], k=min(9, len(points)))[1][1:]
    steps = points[near] - points[seed]
    first, lengths = steps[0], np.hypot(*steps.T)
    cosine = steps @ first / lengths / lengths[0]
    across = steps[(np.abs(cosine) < 0.5) & (lengths < 1.4 * lengths[0])]
    if not len(across):
        return {}
    # The step to the next column is the one that points more to the right.
    below, beside = sorted((first, across[0]), key=lambda step: abs(step[1]))
    basis = np.array([below * np.copysign(1, below[0]), beside * np.copysign(1, beside[1])])
    reach = 0.25 * min(np.hypot(*basis.T))
    placed, taken, front = {(0, 0): seed}, {seed}, [(0, 0)]
    while front:
        row, column = front.pop(0)
        here = points[placed[row, column]]
        for down, right in ((0, 1), (0, -1), (1, 0), (-1, 0)):
            place = (row + down, column + right)
            if place in placed:
                continue
            # The last step is repeated: perspective and distortion change steps slowly.
            before = placed.get((row - down, column - right))
            step = down * basis[0] + right * basis[1]
            step = step if before is None else here - points[before]
            distance, number = tree.query(here + step)
            if distance < reach and number not in taken:
                placed[place] = int(number)
                taken.add(int(number))
                front.append(place)
    return placed


def _true_corners(
    image: np.ndarray, points: np.ndarray, placed: dict[tuple[int, int], int]
) -> dict[tuple[int, int], int]:
    """Leave out points whose four squares are not alternately bright and dark.

    These are on the rim of the board, between dots, or by the image's borders.
    """
    if len(placed) < LEAST_POINTS:
        return {}
    indices, where = np.array(list(placed)), points[list(placed.values())]
    signs = np.array([(1, 1), (-1, -1), (1, -1), (-1, 1)])
    places = where[:, None] + 0.4 * signs @ lattice_steps(indices, where)
    values = map_coordinates(image, places.transpose(2, 0, 1), order=1, cval=np.nan)
    same, other = values[:, :2].mean(axis=1), values[:, 2:].mean(axis=1)
    contrast = np.abs(same - other)
    middle = map_coordinates(gaussian_filter(image, 0.7), where.T, order=1)
    usual = np.nanmedian(contrast) if np.isfinite(contrast).any() else np.inf
    turns = (same > other) == (indices.sum(axis=1) % 2 == 0)
    true = (turns if turns.mean() > 0.5 else ~turns) & (contrast > 0.3 * usual)
    for one in (values[:, 0] - values[:, 1], values[:, 2] - values[:, 3]):
        true &= np.abs(one) < 0.35 * contrast
    true &= np.abs(middle - (same + other) / 2) < 0.35 * contrast
    return {place: n for (place, n), good in zip(placed.items(), true, strict=True) if good}


def centres(image: np.ndarray, starts: np.ndarray, radius: float) -> np.ndarray:
    """Find the centre of symmetry near each starting point, shape (n, 2), by Gauss-Newton steps.

    A disc of the radius in pixels is compared with itself. A position is NaN where the disc leaves
    the image or no centre is within half the radius.
    """
    image = np.asarray(image, float)
    smooth, slopes = spline_filter(image, order=3), np.gradient(image)
    reach = int(np.ceil(radius))
    # One of each pair of offsets d and -d, one pixel apart.
    rows, columns = (axis.ravel() + 0.5 for axis in np.mgrid[-reach:reach, 0:reach])
    offsets = np.column_stack([rows, columns])[np.hypot(rows, columns) <= radius]
    found, moving = np.array(starts, float), np.ones(len(starts), bool)
    last = np.array(image.shape) - 1.0

    def sample(picture: np.ndarray, places: np.ndarray, order: int) -> np.ndarray:
        return map_coordinates(picture, places, order=order, prefilter=False, mode="nearest")

    for _ in range(6):
        inside = np.all((found >= radius) & (found <= last - radius), axis=1)
        found[~inside | (np.hypot(*(found - starts).T) > radius / 2)] = np.nan
        live = np.flatnonzero(moving & np.isfinite(found[:, 0]))
        if not len(live):
            break
        there = (found[live, None] + offsets).transpose(2, 0, 1)
        mirrored = (found[live, None] - offsets).transpose(2, 0, 1)
        difference = sample(smooth, there, 3) - sample(smooth, mirrored, 3)
        jacobian = np.stack(
            [sample(slope, there, 1) - sample(slope, mirrored, 1) for slope in slopes], axis=-1
        )
        normal = np.einsum("nmi,nmj->nij", jacobian, jacobian)
        normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(2) + 1e-300
        right = np.einsum("nmi,nm->ni", jacobian, difference)
        step = np.linalg.solve(normal, right[..., None])[..., 0]
        found[live] -= step
        moving[live] = np.abs(step).max(axis=1) > 3e-4  # pixels
    return found
