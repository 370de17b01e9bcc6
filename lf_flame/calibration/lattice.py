"""Corners of a checkerboard, or dots of a regular grid, in one image, as rows and columns."""

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import cKDTree

from lf_flame.errors import InputError

SCALES = (1.0, 2.0, 4.0)
"""Standard deviations in pixels of the smoothing before corners are looked for."""

WEAKEST = 0.15
"""Smallest response of a corner, relative to the strong ones."""

REACH = 0.25
"""Largest distance of a corner from its predicted place, in squares."""

SEEDS = 12
"""Number of corners around the centre of the image from which the lattice is grown."""

ENOUGH = 0.6
"""Share of the points found in a lattice with which no other seed is tried."""

LEAST_ROWS, LEAST_POINTS = 3, 9
"""Smallest number of rows and columns of corners, and of corners: a board of 4 x 4 squares."""

STEPS = ((0, 1), (0, -1), (1, 0), (-1, 0))


def find_lattice(image: np.ndarray, *, dots: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Find the corners of a checkerboard, or dots, and number them by row and column.

    Parameters
    ----------
    image : ndarray, shape (t, s)
        Picture of the target; it may be turned, and cut off by the borders.
    dots : bool, optional
        Whether the target is a square grid of round dots, not a checkerboard.

    Returns
    -------
    indices : ndarray of int, shape (n, 2)
        Row and column of each point; the origin is arbitrary.
    points : ndarray, shape (n, 2)
        Approximate position of each point in pixels, row and column.

    Raises
    ------
    InputError
        If fewer than 3 x 3 corners or dots form a lattice.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.calibration import find_lattice
    >>> y, x = np.indices((48, 56)) // 8
    >>> indices, points = find_lattice(((y + x) % 2).astype(float))
    >>> int(np.ptp(indices[:, 0])) + 1, int(np.ptp(indices[:, 1])) + 1
    (5, 6)
    """
    image = np.asarray(image, float)
    what = "dots" if dots else "corners of squares"
    best: dict[tuple[int, int], int] = {}
    points = np.empty((0, 2))
    for found in [_dots(image)] if dots else (_saddles(image, scale) for scale in SCALES):
        for seed in _seeds(found, image.shape):
            grown = _grow(found, seed)
            if not dots:
                grown = _true_corners(image, found, grown)
            if len(grown) > len(best):
                best, points = grown, found
            if len(grown) > ENOUGH * len(found):
                break
    indices = np.array(list(best), int).reshape(-1, 2)
    counts = [len(np.unique(column)) for column in indices.T]
    if len(indices) < LEAST_POINTS or min(counts) < LEAST_ROWS:
        raise InputError(
            f"The target must show at least {LEAST_ROWS} x {LEAST_ROWS} {what} in rows and "
            f"columns{'' if dots else ' (4 x 4 squares)'}, got {counts[0]} x {counts[1]}: let it "
            f"fill more of the picture, lit evenly, or check that it is "
            f"{'a grid of dots' if dots else 'a checkerboard'}."
        )
    return indices, points[list(best.values())]


def spacing(indices: np.ndarray, points: np.ndarray) -> float:
    """Mean distance in pixels between neighbouring points of a lattice."""
    design = np.column_stack([indices, np.ones(len(indices))])
    steps = np.linalg.lstsq(design, points, rcond=None)[0][:2]
    return float(np.sqrt(abs(np.linalg.det(steps))))


def _saddles(image: np.ndarray, scale: float) -> np.ndarray:
    """Positions of the saddles of brightness; the corners of a checkerboard are strong ones."""
    from skimage.feature import peak_local_max

    rows, columns, mixed = (
        gaussian_filter(image, scale, order) for order in ((2, 0), (0, 2), (1, 1))
    )
    response = mixed**2 - rows * columns
    peaks = peak_local_max(response, min_distance=2, exclude_border=2)
    if len(peaks) < LEAST_POINTS:
        return np.empty((0, 2))
    strength = response[tuple(peaks.T)]
    strong = np.median(np.sort(strength)[-4 * LEAST_POINTS :])
    return peaks[strength > WEAKEST * strong].astype(float)


def _dots(image: np.ndarray) -> np.ndarray:
    """Centres of the dots, dark on bright or bright on dark."""
    from skimage.filters import threshold_otsu
    from skimage.measure import label, regionprops

    if np.ptp(image) == 0:
        return np.empty((0, 2))
    smooth = gaussian_filter(image, 0.7)
    bright = smooth > threshold_otsu(smooth)
    # Dots cover less than half of the target.
    dotted = bright if bright.mean() < 0.5 else ~bright
    whole = [
        region
        for region in regionprops(label(dotted))
        if min(region.bbox[:2]) > 0 and np.all(np.less(region.bbox[2:], image.shape))
    ]
    if not whole:
        return np.empty((0, 2))
    usual = np.median([region.area for region in whole])
    return np.array(
        [region.centroid for region in whole if 0.4 * usual < region.area < 2.5 * usual]
    ).reshape(-1, 2)


def _seeds(points: np.ndarray, shape: tuple[int, ...]) -> Iterator[int]:
    """Numbers of the points nearest to the centre of the image."""
    middle = (np.array(shape[:2]) - 1) / 2
    yield from np.argsort(np.hypot(*(points - middle).T))[:SEEDS] if len(points) > 4 else ()


def _basis(points: np.ndarray, tree: cKDTree, seed: int) -> np.ndarray | None:
    """Find the steps from a point to the next row and to the next column, shape (2, 2)."""
    near = tree.query(points[seed], k=min(9, len(points)))[1][1:]
    steps = points[near] - points[seed]
    first = steps[0]
    cosine = steps @ first / np.hypot(*steps.T) / np.hypot(*first)
    across = steps[(np.abs(cosine) < 0.5) & (np.hypot(*steps.T) < 1.4 * np.hypot(*first))]
    if not len(across):
        return None
    # The step to the next column is the one that points more to the right.
    both = sorted((first, across[0]), key=lambda step: abs(step[1]))
    return np.array([both[0] * np.copysign(1, both[0][0]), both[1] * np.copysign(1, both[1][1])])


def _grow(points: np.ndarray, seed: int) -> dict[tuple[int, int], int]:
    """Place points at rows and columns, from a seed outward: number of the point at each."""
    tree = cKDTree(points)
    basis = _basis(points, tree, seed)
    if basis is None:
        return {}
    reach = REACH * min(np.hypot(*basis.T))
    placed, taken, front = {(0, 0): seed}, {seed}, [(0, 0)]
    while front:
        row, column = front.pop(0)
        here = points[placed[row, column]]
        for down, right in STEPS:
            place = (row + down, column + right)
            if place in placed:
                continue
            # The last step goes on, as perspective and distortion change steps slowly.
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
    """Leave out points whose four squares are not bright and dark in turn.

    So are points on the rim of the board, saddles between dots, and those by the image's borders.
    """
    if len(placed) < LEAST_POINTS:
        return {}
    indices, where = np.array(list(placed)), points[list(placed.values())]
    design = np.column_stack([indices, np.ones(len(indices))])
    steps = np.linalg.lstsq(design, where, rcond=None)[0][:2]
    signs = np.array([(1, 1), (-1, -1), (1, -1), (-1, 1)])
    places = where[:, None] + 0.4 * signs @ steps
    values = map_coordinates(image, places.transpose(2, 0, 1), order=1, cval=np.nan)
    same, other = values[:, :2].mean(axis=1), values[:, 2:].mean(axis=1)
    contrast = np.abs(same - other)
    middle = map_coordinates(gaussian_filter(image, 0.7), where.T, order=1)
    usual = np.nanmedian(contrast) if np.isfinite(contrast).any() else np.inf
    turns = (same > other) == (indices.sum(axis=1) % 2 == 0)
    turns = turns if turns.mean() > 0.5 else ~turns
    true = (
        turns
        & (contrast > 0.3 * usual)
        & (np.abs(values[:, 0] - values[:, 1]) < 0.35 * contrast)
        & (np.abs(values[:, 2] - values[:, 3]) < 0.35 * contrast)
        & (np.abs(middle - (same + other) / 2) < 0.35 * contrast)
    )
    return {place: n for (place, n), good in zip(placed.items(), true, strict=True) if good}
