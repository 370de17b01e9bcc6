"""One image file for each view of a light field: in a folder, in an archive, or in a list."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from math import prod
from pathlib import Path

import numpy as np

from lf_flame._common import progress
from lf_flame._common.images import FLOAT, read_shape
from lf_flame._common.input_files import File, PackedFile
from lf_flame._common.memory import check_memory
from lf_flame._common.printable import printable
from lf_flame.errors import InputError
from lf_flame.formats.images import read_image
from lf_flame.formats.view_files.names import name_some
from lf_flame.formats.view_files.parallax_order import FoundOrder, order_memory
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
        """Number of rows and columns, the value of ``grid``, if the names count them."""
        return self.files.shape if self.positions is None else None

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
        paths = [file for file in self.files.flat if file]
        check_view_memory(paths, self.path, self.files.size)
        shape = read_image(paths[0]).shape
        views = np.zeros((self.files.size, *shape), np.float32)
        self._fill(views)
        views = views.reshape(*self.files.shape, *shape)
        return LightField(views, weights=self._weights, positions=self.positions)

    def _fill(self, views: np.ndarray) -> None:
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
            for _ in progress.steps(done, "reading", len(paths), "view"):
                pass

    @property
    def _weights(self) -> np.ndarray | None:
        """0 for the views that are missing, if any are."""
        there = np.array([file is not None for file in self.files.flat])
        return None if there.all() else there.reshape(self.files.shape)


def check_view_memory(files: list[File], folder: Path, places: int) -> None:
    """Refuse views that need too much memory, from the header of the first, before decoding.

    It counts the places of views as floats, with files being decoded, or the search for the order,
    which reads four views.
    """
    shape = read_shape(files[0])
    values = prod(shape)
    if shape[2] in (2, 4):
        values -= prod(shape[:2])  # transparency is left out
    decoding = 2 * FLOAT * prod(shape)
    # One byte per value stores whether it is finite.
    reading = (FLOAT + 1) * values * places + decoding * _readers(files)
    packed = sum(len(file.content) for file in files if isinstance(file, PackedFile))
    check_memory(packed + max(reading, order_memory(shape) + decoding), folder)


def _readers(files: list[File]) -> int:
    """Count the files that are decoded at the same time."""
    return min(len(files), os.cpu_count() or 1)


def _kind(shape: tuple[int, ...]) -> str:
    return f"{shape[0]} x {shape[1]} {'grey' if len(shape) == 2 else 'colour'}"
