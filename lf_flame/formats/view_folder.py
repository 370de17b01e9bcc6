"""Folders with one image for each view of a light field."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from math import prod
from pathlib import Path

import numpy as np

from lf_flame._common.atomic_files import atomic_folder
from lf_flame._common.memory import check_memory
from lf_flame._common.pixels import read_shape
from lf_flame._common.printable import printable
from lf_flame._common.tiff_files import FLOAT
from lf_flame.errors import InputError
from lf_flame.formats.images import read_image, to_levels, write_image
from lf_flame.formats.view_names import number_grid, view_files
from lf_flame.formats.view_order import (
    FoundOrder,
    Grid,
    arranged,
    as_grid,
    check_order,
    find_order,
    fold,
    order_memory,
)
from lf_flame.lightfield import LightField


@dataclass(frozen=True, eq=False)
class ViewFolder:
    """The files of a light field, in their order.

    Attributes
    ----------
    path : Path
        The folder.
    files : ndarray of Path, shape (v, u)
    found : FoundOrder
        How the file names count the views, and how that was found.
    left_out : int
        Other files in the folder.
    """

    path: Path
    files: np.ndarray
    found: FoundOrder
    left_out: int

    @property
    def counted(self) -> tuple[int, int]:
        """Rows and columns as the file names count them: what ``grid`` would state."""
        rows, columns = self.files.shape
        return (columns, rows) if "col," in self.found.order else (rows, columns)

    def describe(self) -> str:
        """Tell in a few lines what was found and how it is read."""
        v, u = self.files.shape
        first, last = (printable(path.name) for path in self.files[[0, -1], [0, -1]])
        lines = [
            f"{printable(self.path)}: {v} x {u} views, top left {first}, bottom right {last}",
            f"order {self.found.order}, {self.found.reason}",
        ]
        if self.found.slopes and self.found.slopes[0] > 0 and self.found.order == "row,col":
            lines.append(
                "most slopes are above 0, those of parallel cameras below: if the nearer things "
                "have the higher ones here, the order is -row,-col"
            )
        if self.left_out:
            lines.append(f"other files left out: {self.left_out}")
        return "\n".join(lines)

    def read(self, progress: Callable = iter) -> LightField:
        """Read the views.

        Parameters
        ----------
        progress : callable, optional
            Wraps the list of files, as ``tqdm`` does.

        Returns
        -------
        LightField
            Values from 0 to 1; colour in a last axis of 3 channels.

        Raises
        ------
        InputError
            If a file cannot be read, or differs from the first in size or channels.
        """
        paths = list(self.files.flat)
        _check_memory(paths, self.path)
        first = read_image(paths[0])
        views = np.empty((len(paths), *first.shape), np.float32)

        def place(k: int) -> None:
            image = read_image(paths[k])
            if image.shape != first.shape:
                raise InputError(
                    f"All views must be alike: {paths[k]} is {_kind(image)}, {paths[0].name} is "
                    f"{_kind(first)}."
                )
            views[k] = image

        with ThreadPoolExecutor(
            _readers(paths)
        ) as pool:  # decoders work outside the interpreter's lock
            done = pool.map(place, range(len(paths)))
            for _ in zip(progress(paths), done, strict=True):
                pass
        return LightField(views.reshape(*self.files.shape, *first.shape))


def scan_view_folder(
    path: str | Path, order: str | None = None, *, grid: Grid | str | None = None
) -> ViewFolder:
    """Find out which files of a folder are the views of a light field, and how they count.

    The views are the images (png, jpg, tif, bmp, webp, ppm, pgm) whose names differ in their
    numbers only: ``row_col.png``, ``view_R_C.jpg``, ``2067_RR_CC.png``, Stanford's
    ``out_RR_CC_y_x.png`` (the first two numbers that make a full grid), positions such as
    ``pos_-40_12.5.png``, or HCI's ``input_Cam000.png`` and on: one running number along a square,
    if the parallax shows one, or along the rows of `grid`. Numbers may start anywhere. Other files
    are left out; a second set of images half as large or larger is refused.

    Parameters
    ----------
    path : str or Path
    order : str, optional
        What the numbers count, the slower first, a minus for an axis that runs the other way:
        ``row,col`` (row by row from the top left), ``col,row``, ``-row,col`` (rows from the
        bottom), ``row,-col``, and so on. Default: as the parallax of the four central views
        shows (`lf_flame.formats.view_order.find_order`), else ``row,col``.
    grid : (int, int) or str, optional
        Rows and columns that a running number counts, such as (1, 9) or ``1x9``.

    Returns
    -------
    ViewFolder

    Raises
    ------
    InputError
        If the folder, its names or the order cannot be used, or a view is missing.

    Notes
    -----
    With rows counted downward and columns to the right, as seen by the cameras, nearer things have
    the lower slope, as `lf_flame.refocus` has it: the camera moves to the right, and what is near
    moves to the left. Parallel cameras then have slopes below 0 only. A folder that gives higher
    slopes to nearer things has both axes turned, which no parallax shows: read it as ``-row,-col``.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import LightField, formats
    >>> light_field = LightField(np.random.default_rng(1).uniform(size=(3, 3, 20, 30)))

    >>> formats.write_view_folder(light_field, "views")
    >>> formats.scan_view_folder("views").shape[:2]
    (3, 3)
    """
    path = Path(path)
    files = view_files(path)
    _check_memory(files, path)
    shape = as_grid(grid)
    numbered = number_grid(files, shape)
    if numbered.ndim == 1:
        numbered = fold(numbered, path, shape, read_image)
    if order is None:
        found = find_order(numbered, read_image)
    else:
        found = FoundOrder(check_order(order), "as stated")
    left_out = sum(1 for _ in path.iterdir()) - len(files)
    return ViewFolder(path, arranged(numbered, found.order), found, left_out)


def _check_memory(files: list[Path], folder: Path) -> None:
    """Refuse views that need too much memory, by the header of the first, before any is decoded.

    As floats, with those that are being decoded, or with the search for their order.
    """
    shape = read_shape(files[0])
    values = prod(shape)
    if shape[2] in (2, 4):
        values -= prod(shape[:2])  # transparency is left out
    decoding = 2 * FLOAT * prod(shape)
    # A byte for each value says whether it is finite.
    reading = (FLOAT + 1) * values * len(files) + decoding * _readers(files)
    check_memory(max(reading, order_memory(shape) + decoding), folder)


def _readers(files: list[Path]) -> int:
    """Count the files that are decoded side by side."""
    return min(len(files), os.cpu_count() or 1)


def read_view_folder(
    path: str | Path,
    order: str | None = None,
    progress: Callable = iter,
    *,
    grid: Grid | str | None = None,
) -> LightField:
    """Read a folder of views: `scan_view_folder`, then `ViewFolder.read`; parameters as there.

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
    return scan_view_folder(path, order, grid=grid).read(progress)


def _kind(image: np.ndarray) -> str:
    return f"{image.shape[0]} x {image.shape[1]} {'grey' if image.ndim == 2 else 'colour'}"


def write_view_folder(
    light_field: LightField, folder: str | Path, bits: int = 16, *, linear: bool = True
) -> None:
    """Write each view as ``view_RR_CC.png`` (floats: ``.tif``), rows and columns from 0.

    Parameters
    ----------
    light_field : LightField
        Values from 0 to 1, unless written as floats; without a channel axis, or with 1 or 3
        channels.
    folder : str or Path
        A new or an empty folder. It is written aside and renamed when it is whole.
    bits : int, optional
        8 or 16; 32 for floats.
    linear : bool, optional
        As in `write_light_field`.

    Raises
    ------
    InputError
        If the folder holds files, or values or channels do not fit.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import LightField, formats
    >>> light_field = LightField(np.random.default_rng(1).uniform(size=(3, 3, 20, 30)))

    >>> formats.write_view_folder(light_field, "views")
    >>> formats.read_view_folder("views")
    LightField(3 x 3 views of 20 x 30 pixels, grey)
    """
    folder = Path(folder).resolve()
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"The views need a new or empty folder, got {folder}, which is neither.")
    levels = light_field.views if bits == 32 else to_levels(light_field.views, bits)
    suffix = ".tif" if bits == 32 else ".png"
    width = max(2, len(str(max(levels.shape[:2]) - 1)))
    with atomic_folder(folder) as aside:
        for v, u in np.ndindex(levels.shape[:2]):
            path = aside / f"view_{v:0{width}}_{u:0{width}}{suffix}"
            write_image(path, levels[v, u], linear=linear)
