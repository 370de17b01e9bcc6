"""Scan of a folder, an archive or a list for the files that are the views of a light field."""

from pathlib import Path

import numpy as np

from lf_flame._common.input_files import File
from lf_flame.formats.images import read_image
from lf_flame.formats.view_files.folder import ViewFolder, check_view_memory
from lf_flame.formats.view_files.names import grid_of, number_grid
from lf_flame.formats.view_files.orders import Grid, arranged, as_grid, check_grid, check_order
from lf_flame.formats.view_files.parallax_order import FoundOrder, find_order
from lf_flame.formats.view_files.positions import (
    Pair,
    off_grid,
    pairs_off_grid,
    place_views,
)
from lf_flame.formats.view_files.running_numbers import fold
from lf_flame.formats.view_files.sources import LIST, find_files, read_list
from lf_flame.lightfield import LightField


def scan_view_folder(
    path: str | Path,
    order: str | None = None,
    *,
    grid: Grid | str | None = None,
) -> ViewFolder:
    """Find the files that are the views of a light field, and their order.

    The views are the images (png, jpg, tif, bmp, webp, ppm, pgm) with names that differ only in
    numbers: ``row_col.png``, ``view_R_C.jpg``, ``2067_RR_CC.png``, Stanford's
    ``out_RR_CC_y_x.png`` (the first two numbers that make a full grid), positions such as
    ``pos_-40_12.5.png``, or HCI's ``input_Cam000.png`` and so on. A running number counts a square
    if the parallax shows one, or fills the `grid`. Numbers may start anywhere. Other files are left
    out; a second set of images half as large or larger is refused. Places with decimals that fill
    no grid of equal steps are kept as positions (`LightField.positions`).

    Parameters
    ----------
    path : str or Path
        A folder; a ``.zip`` archive of one, which is read without being extracted; or a list, a
        ``.csv`` file with a name, a row and a column in each line, of images beside it.
    order : str, optional
        Meaning of the numbers, the slower one first, with a minus for an axis that runs the other
        way: ``row,col`` (row by row from the top left), ``col,row``, ``-row,col`` (rows from the
        bottom), ``row,-col``, and so on; with ``snake,`` before it where every other row (of
        ``col,row``: column) runs back. Default: the order that the parallax between views shows
        (`lf_flame.formats.view_files.parallax_order.find_order`), else ``row,col``.
    grid : (int, int) or str, optional
        Number of rows and columns of the light field, such as (1, 9) or ``1x9``, for a running
        number in any order, or where more than a third of the views are missing. What is missing
        gets weight 0.

    Returns
    -------
    ViewFolder

    Raises
    ------
    InputError
        If the folder, its names or the order cannot be used, or too many views are missing.

    Notes
    -----
    With rows counted downward and columns to the right, as seen by the cameras, nearer objects have
    the lower slope, as in `lf_flame.refocus`: when the camera moves to the right, near objects move
    to the left. Parallel cameras then give only slopes below 0. A folder that gives higher slopes
    to nearer objects has both axes turned, which no parallax shows: read it as ``-row,-col``.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import LightField, formats
    >>> light_field = LightField(np.random.default_rng(1).uniform(size=(3, 3, 20, 30)))

    >>> formats.write_view_folder(light_field, "views")
    >>> formats.scan_view_folder("views").files.shape
    (3, 3)
    """
    path, shape, left_out = Path(path), as_grid(grid), 0
    if path.suffix.lower() == LIST and not path.is_dir():
        listed = read_list(path)
        if shape is None and off_grid(list(listed)):
            return _placed_folder(path, list(listed.values()), list(listed), order, left_out)
        numbered, missing = grid_of(list(listed.values()), list(listed), path)
    else:
        files, left_out = find_files(path)
        placed = pairs_off_grid(files) if shape is None else None
        if placed is not None:
            return _placed_folder(path, files, placed, order, left_out)
        numbered, missing = number_grid(files, shape)
    check_view_memory([file for file in numbered.flat if file], path, numbered.size)
    if numbered.ndim == 1:
        numbered, found = fold(numbered, path, shape, order, read=read_image)
    elif order is None:
        found = find_order(numbered, read_image)
    else:
        found = FoundOrder(check_order(order), "as stated")
    ordered = arranged(numbered, found.order)
    check_grid(shape, ordered.shape, path)
    return ViewFolder(path, ordered, found, left_out, missing)


def _placed_folder(
    path: Path, files: list[File], pairs: list[Pair], order: str | None, left_out: int
) -> ViewFolder:
    """Arrange views at positions of their own as rows of one column."""
    check_view_memory(files, path, len(files))
    positions, found = place_views(pairs, order)
    column = np.empty((len(files), 1), object)
    column[:, 0] = files
    return ViewFolder(path, column, found, left_out, positions=positions)


def read_view_folder(
    path: str | Path,
    order: str | None = None,
    *,
    grid: Grid | str | None = None,
) -> LightField:
    """Read a folder of views: `scan_view_folder`, then `ViewFolder.read`; same parameters.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import LightField, formats
    >>> light_field = LightField(np.random.default_rng(1).uniform(size=(3, 3, 20, 30)))

    >>> formats.write_view_folder(light_field, "views")
    >>> read = formats.read_view_folder("views")
    >>> bool(np.abs(read.views - light_field.views).max() < 1e-4)  # 16 bits
    True
    """
    return scan_view_folder(path, order, grid=grid).read()
