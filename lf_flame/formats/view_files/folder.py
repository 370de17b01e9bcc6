"""One image file for each view of a light field, in a folder."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from fnmatch import fnmatch
from math import prod
from pathlib import Path

import numpy as np

from lf_flame._common import progress
from lf_flame._common.atomic_files import atomic_folder
from lf_flame._common.images import FLOAT, read_shape
from lf_flame._common.memory import check_memory
from lf_flame._common.printable import printable
from lf_flame.errors import InputError
from lf_flame.formats.images import IMAGE_SUFFIXES, read_image, to_levels, write_image
from lf_flame.formats.view_files.names import number_grid, split_numbers
from lf_flame.formats.view_files.orders import (
    FoundOrder,
    Grid,
    arranged,
    by_columns,
    check_grid,
    check_order,
    find_order,
    fold,
    order_memory,
    read_grid,
    stated_order,
)
from lf_flame.formats.zarr_arrays import is_zarr
from lf_flame.lightfield import LightField


@dataclass(frozen=True, eq=False)
class ViewFolder:
    """Files of a light field in the order of its views.

    Attributes
    ----------
    path : Path
    files : ndarray of Path, shape (v, u)
        Files of the views; None for a missing view.
    found : FoundOrder
        Order in which the file names count the views, and how it was found.
    left_out : int
        Number of other files in the folder.
    """

    path: Path
    files: np.ndarray
    found: FoundOrder
    left_out: int

    def describe(self) -> str:
        """Describe the views, their order and the missing ones in a few lines."""
        v, u = self.files.shape
        first, last = (
            "(missing)" if file is None else printable(file.name)
            for file in self.files[[0, -1], [0, -1]]
        )
        lines = [
            f"{printable(self.path)}: {v} x {u} views, top left {first}, bottom right {last}",
            *self.found.describe(),
        ]
        if gaps := [f"{v}_{u}" for v, u in np.argwhere(self.files == None)]:  # noqa: E711
            named = ", ".join(gaps[:3]) + (" ..." if len(gaps) > 3 else "")
            lines.append(f"missing views, with weight 0: {len(gaps)} ({named})")
        if self.left_out:
            lines.append(f"other files left out: {self.left_out}")
        return "\n".join(lines)

    def read(self) -> LightField:
        """Read the views.

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
        there = np.array([file is not None for file in self.files.flat])
        places, paths = np.flatnonzero(there), list(self.files.flat[there])
        first = read_image(paths[0])
        views = np.zeros((self.files.size, *first.shape), np.float32)

        def place(k: int) -> None:
            image = read_image(paths[k])
            if image.shape != first.shape:
                raise InputError(
                    f"All views must be alike: {paths[k]} has shape {image.shape}, "
                    f"{paths[0].name} {first.shape}."
                )
            views[places[k]] = image

        with ThreadPoolExecutor(_readers(paths)) as pool:  # decoders release the interpreter's lock
            done = pool.map(place, range(len(paths)))
            for _ in progress.steps(done, "reading", len(paths), "view"):
                pass
        shape = self.files.shape
        weights = None if there.all() else there.reshape(shape)
        return LightField(views.reshape(shape + first.shape), weights=weights)


def _readers(files: list[Path]) -> int:
    """Count the files that are decoded at the same time."""
    return min(len(files), os.cpu_count() or 1)


def is_view_folder(path: str | Path) -> bool:
    """Whether a path is read as one file for each view: a folder, but none of Zarr."""
    if Path(path).suffix.lower() == ".zarr" and is_zarr(path):
        return False
    return Path(path).is_dir()


def first_image(path: Path) -> Path | None:
    """First image of a folder by its name; None if there is none."""
    return min(_images(path, None)[0], default=None)


def _images(path: Path, names: str | None) -> tuple[list[Path], int]:
    """Paths of the images of a folder, and the number of all files."""
    if not path.is_dir():
        raise InputError(f"The views cannot be read: {path} is no folder.")
    every = sorted(path.iterdir())
    images = [
        one
        for one in every
        if one.suffix.lower() in IMAGE_SUFFIXES
        and not one.name.startswith(".")
        and fnmatch(one.name, names or "*")
    ]
    return images, len(every)


def _find_files(path: Path, names: str | None) -> tuple[list[Path], int]:
    """Find the images whose names differ only in numbers, and the number of other files."""
    images, count = _images(path, names)
    kinds: dict[str, list] = {}
    for one, parts in zip(images, split_numbers([one.stem for one in images]), strict=True):
        if len(parts) > 1:
            kinds.setdefault("#".join(parts[::2]) + one.suffix.lower(), []).append(one)
    several = sorted(kinds, key=lambda kind: -len(kinds[kind]))[:3]
    if len(kinds) > 1:
        raise InputError(
            f"{path} holds several sets of images, "
            f"{', '.join(f'{len(kinds[kind])} of {kind}' for kind in several)}: choose the views "
            f"by --names, such as --names '{several[0].replace('#', '*')}'."
        )
    found = kinds[several[0]] if kinds else []
    if len(found) < 2:
        raise InputError(
            f"{path} holds no two images ({', '.join(IMAGE_SUFFIXES)}) whose names differ in "
            f"numbers only{'' if names is None else f' and are like {names}'}."
        )
    return found, count - len(found)


def scan_view_folder(
    path: str | Path,
    order: str | None = None,
    *,
    grid: Grid | str | None = None,
    names: str | None = None,
    first: int | None = None,
) -> ViewFolder:
    """Find the files that are the views of a light field, and their order.

    The views are the images (png, jpg, tif, bmp, webp, ppm, pgm) with names that differ only in
    numbers. The last two numbers that vary are row and column: ``row_col.png``, ``view_R_C.jpg``,
    ``2067_RR_CC.png``, positions such as ``pos_-40_12.5.png``; in Stanford's
    ``out_RR_CC_y_x.png`` the last two that lie on a grid. A single number, as in HCI's
    ``input_Cam000.png``, counts row by row a square, or the `grid`. Rows and columns need one step;
    views may be missing.

    Parameters
    ----------
    path : str or Path
        Folder with the images.
    order : str, optional
        Meaning of the numbers, the slower one first, with a minus for an axis that runs the other
        way: ``row,col`` (row by row from the top left), ``col,row``, ``-row,col`` (rows from the
        bottom), ``row,-col``, and so on. Default: the order that the parallax between views shows
        (`lf_flame.formats.view_files.orders.find_order`), otherwise ``row,col``.
    grid : (int, int) or str, optional
        Number of rows and columns of the light field, such as (1, 9) or ``9x9``. Numbers that do
        not fill it are places in it, and places without a view get weight 0.
    names : str, optional
        Pattern of the views' names, such as ``input_Cam*.png``. Default: all images.
    first : int, optional
        Number of the first place of the grid. Default: 1 if the last place is then there,
        otherwise 0; for numbers that fill the grid, the lowest.

    Returns
    -------
    ViewFolder

    Raises
    ------
    InputError
        If the folder, its names or the order cannot be used, steps between views differ, or the
        views of a running number move as a single row does.

    Notes
    -----
    With rows counted downward and columns to the right, as seen by the cameras, nearer objects have
    the lower slope, as in `lf_flame.refocus`: when the camera moves to the right, near objects move
    to the left. Parallel cameras then give only slopes below 0. A folder that gives higher slopes
    to nearer objects has both axes flipped, which no parallax shows: read it as ``-row,-col``.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import LightField, formats
    >>> light_field = LightField(np.random.default_rng(1).uniform(size=(3, 3, 20, 30)))

    >>> formats.write_light_field(light_field, "views")
    >>> formats.scan_view_folder("views").files.shape
    (3, 3)
    """
    path, shape = Path(path), None if grid is None else read_grid(grid)
    order = None if order is None else check_order(order)
    files, left_out = _find_files(path, names)
    turned = shape[::-1] if shape and order and by_columns(order) else shape
    numbered = number_grid(files, path, turned, first)
    image = read_shape(files[0])
    # As floats, with a byte for whether a value is finite; decoding takes two more at a time.
    reading = ((FLOAT + 1) * numbered.size + 2 * FLOAT * _readers(files)) * prod(image)
    check_memory(max(reading, order_memory(image) + 2 * FLOAT * prod(image)), path)
    if numbered.ndim == 1:
        numbered, found = fold(numbered, path, shape, order, read=read_image)
    else:
        found = find_order(numbered, read_image) if order is None else stated_order(order)
    ordered = arranged(numbered, found.order)
    check_grid(shape, ordered.shape, path)
    return ViewFolder(path, ordered, found, left_out)


def write_view_folder(
    light_field: LightField, folder: str | Path, bits: int, *, linear: bool
) -> None:
    """Write each view as ``view_RR_CC.png`` (floats: ``.tif``) of a new or an empty folder."""
    folder = Path(folder).resolve()
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"The views need a new or empty folder, got {folder}, which is neither.")
    views = light_field.filled
    levels = views if bits == 32 else to_levels(views, bits)
    suffix = ".tif" if bits == 32 else ".png"
    width = max(2, len(str(max(levels.shape[:2]) - 1)))
    with atomic_folder(folder) as aside:
        for v, u in np.ndindex(levels.shape[:2]):
            path = aside / f"view_{v:0{width}}_{u:0{width}}{suffix}"
            write_image(path, levels[v, u], linear=linear)
