"""Geometric shapes as layer textures: area coverage of each cell, in [0, 1]."""

import numpy as np

from lf_flame.errors import InputError

SUPERSAMPLING = 8
"""Number of points per cell and axis that sample its coverage; an edge cell is right to 1/16."""

SHAPES = {
    "rectangle": None,
    "square": None,
    "circle": lambda y, x: y**2 + x**2 <= 1,
    "triangle": lambda y, x: np.abs(x) <= (y + 1) / 2,  # apex up, base along the lower edge
}
"""Shapes by name, with their tests on coordinates from -1 to 1 over the bounding box."""


def shape_texture(shape: str, size_mm: tuple[float, float], cell_mm: float = 0.1) -> np.ndarray:
    """Texture of a geometric shape that fills its bounding box: the coverage of each cell.

    Parameters
    ----------
    shape : {"rectangle", "square", "circle", "triangle"}
        Name of the shape; a circle in a box that is not square becomes an ellipse.
    size_mm : (float, float)
        Height and width of the bounding box.
    cell_mm : float, optional
        Desired size of a texture cell; it is larger if the shape would have over 1000 of them along
        an axis. A rectangle needs only one cell.

    Returns
    -------
    ndarray of float64, shape (rows, columns), values in [0, 1]

    Raises
    ------
    InputError
        If the shape is unknown, or a length is not finite and above 0.

    Examples
    --------
    >>> from lf_flame.scenes import shape_texture
    >>> shape_texture("circle", (4.0, 4.0), 0.5).shape
    (8, 8)
    """
    if shape not in SHAPES:
        raise InputError(f"Unknown shape {shape!r}; use {', '.join(SHAPES)}.")
    if not all(0 < length < np.inf for length in (*size_mm, cell_mm)):
        raise InputError(f"size_mm and cell_mm must be above 0, got {size_mm} and {cell_mm}.")
    inside = SHAPES[shape]
    if inside is None:
        return np.ones((1, 1))
    rows, columns = (round(np.clip(length / cell_mm, 1, 1000)) for length in size_mm)
    y, x = (
        (2 * np.arange(n * SUPERSAMPLING) + 1) / (n * SUPERSAMPLING) - 1 for n in (rows, columns)
    )
    lines = y.reshape(rows, SUPERSAMPLING, 1)
    # Row by row, as all points of a large shape would not fit into the memory.
    points = (inside(line, x).reshape(SUPERSAMPLING, columns, SUPERSAMPLING) for line in lines)
    return np.array([row.mean(axis=(0, 2)) for row in points])
