"""Opening light fields that are larger than memory, without reading them."""

from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from math import prod
from pathlib import Path

import numpy as np

from lf_flame._common.arrays_in_files import HDF5_ERRORS, Hdf5File, MatlabFile
from lf_flame._common.input_files import readable
from lf_flame._common.zarr_files import ZARR_ERRORS, ZarrFile
from lf_flame.errors import InputError
from lf_flame.formats.arrays import (
    ARRAY_SUFFIXES,
    HDF5_SUFFIXES,
    VALID,
    WEIGHTS,
    AnyFile,
    check_shape,
    choose_array,
    open_file,
)
from lf_flame.formats.hci_files import find_hci_order, is_hci
from lf_flame.formats.view_files.orders import Grid, arranged, as_grid, check_grid
from lf_flame.formats.view_files.parallax_order import FoundOrder
from lf_flame.formats.view_files.running_numbers import fold
from lf_flame.formats.view_files.scan import scan_view_folder
from lf_flame.formats.view_files.sources import is_view_folder
from lf_flame.lazy_light_field import LazyLightField


def open_light_field(
    path: str | Path,
    *,
    order: str | None = None,
    grid: Grid | str | None = None,
    axes: str | None = None,
    array: str | None = None,
) -> LazyLightField:
    """Open a light field of which rows of pixels are read when they are needed.

    Arrays in ``.npy``, ``.h5``, ``.mat`` (7.3) and ``.zarr`` files are read in parts, in place. The
    views of a folder are first decoded into a temporary file, of 4 bytes a value, in the folder
    that ``TMPDIR`` names; it is removed with the light field.

    Parameters
    ----------
    path : str or Path
    order, grid, axes, array : optional
        As in `read_light_field`.

    Returns
    -------
    LazyLightField

    Raises
    ------
    InputError
        If the path cannot be read, or in parts only; or the disk has too little room.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import LightField, formats, refocus
    >>> light_field = LightField(np.random.default_rng(1).uniform(size=(3, 3, 20, 30)))
    >>> formats.write_light_field(light_field, "light_field.zarr")
    >>> stored = formats.open_light_field("light_field.zarr")
    >>> refocus.refocus(stored, 0.5).shape
    (20, 30)
    """
    path = Path(path)
    if is_view_folder(path):
        return scan_view_folder(path, order, grid=grid, larger=True).unpack()
    return open_ordered(path, order=order, grid=grid, axes=axes, array=array)[0]


def open_ordered(
    path: Path,
    *,
    order: str | None,
    grid: Grid | str | None,
    axes: str | None,
    array: str | None,
) -> tuple[LazyLightField, FoundOrder | None]:
    """Open an array, and find the order of its views.

    Arguments and errors are those of `open_light_field`; the order is None where it was stated, or
    the views are used as stored.
    """
    if path.suffix.lower() not in ARRAY_SUFFIXES:
        raise InputError(
            f"Parts of {path} cannot be read: a light field larger than memory must be a folder of "
            f"views, or .zarr, .h5 or .npy; lf-flame convert SOURCE TARGET.zarr makes one."
        )
    with open_file(path) as file:
        stored = _open_array(file, path, axes, array)
    lines, found = _lines(stored, path, order, as_grid(grid), axes)
    ours = order if found is None else found.order
    numbers = lines if ours is None else arranged(lines, ours)
    weights = None if stored.weights is None else stored.weights.ravel()[numbers]
    return stored.rearranged(numbers, weights=weights), None if order else found


def _open_array(file: AnyFile, path: Path, axes: str | None, array: str | None) -> LazyLightField:
    """Open the views of a file as stored."""
    if isinstance(file, MatlabFile):
        raise InputError(f"Parts of {path} cannot be read: store it as -v7.3, .npy or .zarr.")
    name = choose_array(file, axes, array)
    if VALID in set(file.names) - {name}:
        raise InputError(
            f"{path} says which pixels are known, which is used only where all are in memory."
        )
    weights = file.read([WEIGHTS])[0] if WEIGHTS in set(file.names) - {name} else None
    shape = file.header(name).shape
    if len(shape) not in (4, 5) and axes is None:
        raise InputError(
            f"Parts of {path} cannot be read: {name or 'it'} must be views[v, u, t, s], or --axes "
            f"must name its axes, got shape {shape}."
        )
    if axes is None:
        check_shape(shape, path)
    named = (axes or {4: "vuts", 5: "vutsc"}[len(shape)]).lower()
    backwards = isinstance(file, Hdf5File) and file.reversed
    guard: Callable = nullcontext
    if isinstance(file, Hdf5File):
        guard = partial(readable, path, HDF5_ERRORS)
    elif isinstance(file, ZarrFile):
        guard = partial(readable, file.metadata, ZARR_ERRORS)
    return LazyLightField(
        file.open(name),
        axes=named[::-1] if backwards else named,
        weights=weights,
        source=str(path),
        guard=guard,
    )


def _lines(
    stored: LazyLightField, path: Path, order: str | None, grid: Grid | None, axes: str | None
) -> tuple[np.ndarray, FoundOrder | None]:
    """Numbers of the views, in lines as stored, and their order if it is found."""
    shape = stored.shape[:2]
    numbers = np.arange(prod(shape))

    def read(number: int) -> np.ndarray:
        return stored.view(*divmod(int(number), shape[1]))

    if axes is not None and "n" in axes.lower():
        return fold(numbers, path, grid, order, read=read)
    check_grid(grid, shape, path)
    lines = numbers.reshape(shape)
    if order is None and axes is None and path.suffix.lower() in HDF5_SUFFIXES and is_hci(path):
        return lines, find_hci_order(path, lines, read)
    return lines, None
