"""Mosaics of views: rows and columns of whole views side by side in one picture."""

from pathlib import Path

from lf_flame.errors import InputError
from lf_flame.formats.images import read_image
from lf_flame.formats.view_files.orders import Grid, read_grid
from lf_flame.lightfield import LightField


def read_view_mosaic(path: str | Path, grid: Grid | str) -> LightField:
    """Read a picture that holds all views side by side.

    In a lenslet image (`read_lenslet_image`) the pixels of one lenslet are neighbours; here those
    of one view are.

    Parameters
    ----------
    path : str or Path
        Image, without margins or lines between the views.
    grid : (int, int) or str
        Number of rows and columns of views, such as (8, 8) or ``8x8``.

    Returns
    -------
    LightField
        Views as the picture holds them, row by row.

    Raises
    ------
    InputError
        If the image cannot be read, or its sides are not multiples of the rows and columns.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.formats import read_view_mosaic
    >>> from lf_flame.formats.images import write_image
    >>> write_image("mosaic.png", np.zeros((60, 90), np.uint8))
    >>> read_view_mosaic("mosaic.png", "3x3")
    LightField(3 x 3 views of 20 x 30 pixels, grey)
    """
    rows, columns = read_grid(grid, "mosaic")
    picture = read_image(path)
    height, width = picture.shape[:2]
    if height % rows or width % columns:
        raise InputError(
            f"A mosaic of {rows} x {columns} views needs sides that are multiples of these, and "
            f"{path} has {height} x {width} pixels: cut off its margins, or state other numbers."
        )
    size = (rows, height // rows, columns, width // columns, *picture.shape[2:])
    return LightField(picture.reshape(size).swapaxes(1, 2))
