"""One image file for each view of a light field: in a folder, in an archive, or in a list."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from math import prod
from pathlib import Path

import numpy as np

from lf_flame._common.array_files import MappedArray
from lf_flame._common.atomic_files import atomic_folder
from lf_flame._common.input_files import File, PackedFile
from lf_flame._common.memory import check_memory
from lf_flame._common.pixels import read_shape
from lf_flame._common.printable import printable
from lf_flame._common.scratch import Scratch
from lf_flame._common.tiff_files import FLOAT
from lf_flame.errors import InputError
from lf_flame.formats.images import read_image, to_levels, write_image
from lf_flame.formats.view_files.names import grid_of, name_some, number_grid
from lf_flame.formats.view_files.orders import Grid, arranged, as_grid, check_order
from lf_flame.formats.view_files.parallax_order import FoundOrder, find_order, fold, order_memory
from lf_flame.formats.view_files.positions import (
    Pair,
    off_grid,
    pairs_off_grid,
    place_views,
)
from lf_flame.formats.view_files.sources import LIST, find_files, read_list
from lf_flame.lazy_light_field import LazyLightField
from lf_flame.lightfield import LightField


@dataclass(frozen=True, eq=False)
class ViewFolder:
    """Files of a light field in the order of its views.

    Attributes
    ----------
    path : Path
        The folder.
    files : ndarray of Path or PackedFile, shape (v, u)
        Files of the views; None for a missing view.
    found : FoundOrder
        Order in which the file names count the views, and how it was found.
    left_out : int
        Number of other files in the folder.
    missing : tuple of str
        Numbers of the missing views, as the names count them.
    positions : ndarray of float64, shape (v, 1, 2), or None
        Places of views that stand on no grid, see `LightField`.
    """

    path: Path
    files: np.ndarray
    found: FoundOrder
    left_out: int
    missing: tuple[str, ...] = ()
    positions: np.ndarray | None = None

    @property
    def counted(self) -> tuple[int, int] | None:
        """Number of rows and columns as the names count them, the value of ``grid``, if they do."""
        if self.positions is not None:
            return None
        rows, columns = self.files.shape
        return (columns, rows) if "col," in self.found.order else (rows, columns)

    def describe(self) -> str:
        """Describe the views and their order in a few lines."""
        v, u = self.files.shape
        first, last = (
            "(missing)" if file is None else printable(file.name)
            for file in self.files[[0, -1], [0, -1]]
        )
        lines = [
            f"{printable(self.path)}: {v} x {u} views, top left {first}, bottom right {last}",
            *self.found.describe(),
        ]
        if self.missing:
            are = (
                "view is missing and has"
                if len(self.missing) == 1
                else "views are missing and have"
            )
            lines.append(
                f"{len(self.missing)} {are} weight 0: {printable(name_some(self.missing))}"
            )
        if self.left_out:
            lines.append(f"other files left out: {self.left_out}")
        return "\n".join(lines)

    def read(self, progress: Callable = iter) -> LightField:
        """Read the views.

        Parameters
        ----------
        progress : callable, optional
            Function that wraps the list of files, as ``tqdm`` does.

        Returns
        -------
        LightField
            Values from 0 to 1; colour images give a last axis of 3 channels. Missing views are
            black, and have weight 0.

        Raises
        ------
        InputError
            If a file cannot be read, or differs from the first in size or channels.
        """
        paths = [file for file in self.files.flat if file]
        _check_memory(paths, self.path, self.files.size)
        shape = read_image(paths[0]).shape
        views = np.zeros((self.files.size, *shape), np.float32)
        self._fill(views, progress)
        views = views.reshape(*self.files.shape, *shape)
        return LightField(views, weights=self._weights, positions=self.positions)

    def unpack(self, progress: Callable = iter) -> LazyLightField:
        """Decode the views into a temporary file, of which parts are then read.

        Parameters and errors are those of `read`.
        """
        if self.positions is not None:
            raise InputError(
                f"The views in {self.path} stand at positions of their own, and are refocused in "
                f"memory only."
            )
        shape = read_image(next(file for file in self.files.flat if file)).shape
        scratch = Scratch(FLOAT * self.files.size * prod(shape))
        views = MappedArray.new(scratch.folder / "views.npy", (self.files.size, *shape), scratch)
        self._fill(views, progress)
        return LazyLightField(
            views,
            axes="nts" + "c" * (len(shape) - 2),
            numbers=np.arange(self.files.size).reshape(self.files.shape),
            weights=self._weights,
            source=str(self.path),
        )

    def _fill(self, views: np.ndarray | MappedArray, progress: Callable) -> None:
        """Decode the views that there are into an array of zeros, [number, t, s] or with colours.

        A missing view is black.
        """
        places = [k for k, file in enumerate(self.files.flat) if file is not None]
        paths = [self.files.flat[k] for k in places]

        def place(k: int) -> None:
            image = read_image(paths[k])
            if image.shape != views.shape[1:]:
                raise InputError(
                    f"All views must be alike: {paths[k]} is {_kind(image.shape)}, {paths[0].name} "
                    f"is {_kind(views.shape[1:])}."
                )
            views[places[k]] = image

        with ThreadPoolExecutor(_readers(paths)) as pool:  # decoders release the interpreter's lock
            done = pool.map(place, range(len(paths)))
            for _ in zip(progress(paths), done, strict=True):
                pass

    @property
    def _weights(self) -> np.ndarray | None:
        """0 for the views that are missing, if any are."""
        there = np.array([file is not None for file in self.files.flat])
        return None if there.all() else there.reshape(self.files.shape)


def scan_view_folder(
    path: str | Path,
    order: str | None = None,
    *,
    grid: Grid | str | None = None,
    larger: bool = False,
) -> ViewFolder:
    """Find the files that are the views of a light field, and their order.

    The views are the images (png, jpg, tif, bmp, webp, ppm, pgm) with names that differ only in
    numbers: ``row_col.png``, ``view_R_C.jpg``, ``2067_RR_CC.png``, Stanford's
    ``out_RR_CC_y_x.png`` (the first two numbers that make a full grid), positions such as
    ``pos_-40_12.5.png``, or HCI's ``input_Cam000.png`` and so on. A running number counts a square
    row by row, if the parallax shows one, or the rows of `grid`. Numbers may start anywhere. Other
    files are left out; a second set of images half as large or larger is refused. Places with
    decimals that fill no grid of equal steps are kept as positions (`LightField.positions`).

    Parameters
    ----------
    path : str or Path
        A folder; a ``.zip`` archive of one, which is read without being extracted; or a list, a
        ``.csv`` file with a name, a row and a column in each line, of images beside it.
    order : str, optional
        Meaning of the numbers, the slower one first, with a minus for an axis that runs the other
        way: ``row,col`` (row by row from the top left), ``col,row``, ``-row,col`` (rows from the
        bottom), ``row,-col``, and so on; with ``snake,`` before it where every other row (of
        ``col,row``: column) runs back. Default: the order that the parallax of the four central
        views shows (`lf_flame.formats.view_files.parallax_order.find_order`), else ``row,col``.
    grid : (int, int) or str, optional
        Number of rows and columns, such as (1, 9) or ``1x9``, for a running number, or where more
        than a third of the views are missing. What is missing gets weight 0.
    larger : bool, optional
        Whether the views together may exceed the memory limit, for `ViewFolder.unpack`.

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
    path = Path(path)
    shape = as_grid(grid)
    left_out = 0
    if path.suffix.lower() == LIST and not path.is_dir():
        listed = read_list(path)
        files, pairs = list(listed.values()), list(listed)
        if shape is None and off_grid(pairs):
            return _placed_folder(path, files, pairs, order, left_out)
        numbered, missing = grid_of(files, pairs, path)
        if shape not in (None, numbered.shape):
            raise InputError(
                f"{path} lists {numbered.shape[0]} x {numbered.shape[1]} views, not the "
                f"{shape[0]} x {shape[1]} of the grid stated."
            )
    else:
        files, left_out = find_files(path)
        placed = pairs_off_grid(files) if shape is None else None
        if placed is not None:
            return _placed_folder(path, files, placed, order, left_out)
        numbered, missing = number_grid(files, shape)
    places = 0 if larger else numbered.size
    _check_memory([file for file in numbered.flat if file], path, places)
    if numbered.ndim == 1:
        numbered = fold(numbered, path, shape, read_image)
    if order is None:
        found = find_order(numbered, read_image)
    else:
        found = FoundOrder(check_order(order), "as stated")
    return ViewFolder(path, arranged(numbered, found.order), found, left_out, missing)


def _placed_folder(
    path: Path, files: list[File], pairs: list[Pair], order: str | None, left_out: int
) -> ViewFolder:
    """Arrange views at positions of their own as rows of one column."""
    _check_memory(files, path, len(files))
    positions, found = place_views(pairs, order)
    column = np.empty((len(files), 1), object)
    column[:, 0] = files
    return ViewFolder(path, column, found, left_out, positions=positions)


def _check_memory(files: list[File], folder: Path, places: int) -> None:
    """Refuse views that need too much memory, from the header of the first, before decoding.

    Counted are the places of views as floats, with files being decoded, or with the search for
    the order, which reads four views and takes no places.
    """
    shape = read_shape(files[0])
    values = prod(shape)
    if shape[2] in (2, 4):
        values -= prod(shape[:2])  # transparency is left out
    decoding = 2 * FLOAT * prod(shape)
    # One byte per value stores whether it is finite.
    reading = (FLOAT + 1) * values * places + decoding * (_readers(files) if places else 1)
    packed = sum(len(file.content) for file in files if isinstance(file, PackedFile))
    check_memory(packed + max(reading, order_memory(shape) + decoding), folder)


def _readers(files: list[File]) -> int:
    """Count the files that are decoded at the same time."""
    return min(len(files), os.cpu_count() or 1)


def read_view_folder(
    path: str | Path,
    order: str | None = None,
    progress: Callable = iter,
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
    return scan_view_folder(path, order, grid=grid).read(progress)


def _kind(shape: tuple[int, ...]) -> str:
    return f"{shape[0]} x {shape[1]} {'grey' if len(shape) == 2 else 'colour'}"


def write_view_folder(
    light_field: LightField, folder: str | Path, bits: int = 16, *, linear: bool = True
) -> None:
    """Write each view as ``view_RR_CC.png`` (floats: ``.tif``), rows and columns from 0.

    Parameters
    ----------
    light_field : LightField
        Values from 0 to 1, unless written as floats; grey, or with 1 or 3 channels.
    folder : str or Path
        A new or an empty folder. It appears when all views are written.
    bits : int, optional
        Number of bits: 8 or 16; 32 for floats.
    linear : bool, optional
        Whether values are linear in radiance; an 8-bit PNG then states it.

    Raises
    ------
    InputError
        If the folder contains files, or values or channels do not fit.

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
