"""Geometric shapes as layer textures: area coverage of each cell, in [0, 1]."""

import numpy as np

from lf_flame.errors import InputError

SUPERSAMPLING = 8
"""Number of points per cell and axis that sample its coverage; an edge cell is right to 1/64."""

MOST_CELLS = 1000
"""Largest number of cells along an axis; a larger shape gets larger cells."""


def _inside_circle(y, x):
    return y**2 + x**2 <= 1


def _inside_triangle(y, x):
    return np.abs(x) <= (y + 1) / 2  # apex up, base along the lower edge


SHAPES = {"rectangle": None, "square": None, "circle": _inside_circle, "triangle": _inside_triangle}
"""Shapes by name, with their tests on coordinates from -1 to 1 over the bounding box. On each line
along x, the inside must be one interval that contains x = 0."""


def shape_texture(shape: str, size_mm: tuple[float, float], cell_mm: float = 0.1) -> np.ndarray:
    """Texture of a geometric shape that fills its bounding box: the coverage of each cell.

    Parameters
    ----------
    shape : {"rectangle", "square", "circle", "triangle"}
        Name of the shape; a circle in a box that is not square becomes an ellipse.
    size_mm : (float, float)
        Height and width of the bounding box.
    cell_mm : float, optional
        Desired size of a texture cell; it is larger if the shape would have over MOST_CELLS. A
        rectangle needs only one cell.

    Returns
    -------
    ndarray of float64, shape (rows, columns), values in [0, 1]

    Raises
    ------
    InputError
        If the shape is unknown.

    Examples
    --------
    >>> from lf_flame.scenes import shape_texture
    >>> shape_texture("circle", (4.0, 4.0), 0.5).shape
    (8, 8)
    """
    if shape not in SHAPES:
        raise InputError(f"Unknown shape {shape!r}; known are {', '.join(SHAPES)}.")
    inside = SHAPES[shape]
    if inside is None:
        return np.ones((1, 1))
    rows, columns = (round(np.clip(length / cell_mm, 1, MOST_CELLS)) for length in size_mm)
    y, x = (
        (2 * np.arange(n * SUPERSAMPLING) + 1) / (n * SUPERSAMPLING) - 1 for n in (rows, columns)
    )
    # On each line the points inside are one interval about the centre: its ends suffice.
    middle = len(x) // 2
    left, right = _count_inside(inside, y, np.stack([x[:middle][::-1], x[middle:]]))
    hits = _points_before(middle + right, columns)
    hits -= _points_before(middle - left, columns)
    counts = hits.reshape(rows, SUPERSAMPLING, columns).sum(axis=1, dtype=np.int16)
    return counts / SUPERSAMPLING**2


def _count_inside(inside, y: np.ndarray, outward: np.ndarray) -> np.ndarray:
    """Count the points inside on each line y up to the first outside, by bisection.

    `outward` are the points from the centre to the left and to the right, [side, point]. The
    result is [side, line].
    """
    low = np.zeros((2, len(y)), int)
    high = np.full_like(low, outward.shape[1])
    while np.any(low < high):
        middle = (low + high) // 2
        at = outward[[[0], [1]], np.minimum(middle, outward.shape[1] - 1)]
        is_inside = inside(y, at) & (low < high)
        low, high = np.where(is_inside, middle + 1, low), np.where(is_inside, high, middle)
    return low


def _points_before(end: np.ndarray, columns: int) -> np.ndarray:
    """Count the points of each cell, [line, cell], before an end on each line."""
    # 16-bit integers hold all points of a line, and are fast.
    cells = np.arange(columns, dtype=np.int16) * np.int16(SUPERSAMPLING)
    before = end.astype(np.int16)[:, None] - cells
    return np.clip(before, np.int16(0), np.int16(SUPERSAMPLING), out=before)
