"""Light fields in files of arrays: NumPy, HDF5, MATLAB and Zarr; nothing is unpickled."""

from collections.abc import Iterator
from contextlib import contextmanager
from math import isqrt
from pathlib import Path

import numpy as np

from lf_flame._common.arrays_in_files import ArrayFile, open_arrays
from lf_flame._common.images import FLOAT, to_unit
from lf_flame._common.zarr_files import ZarrFile
from lf_flame.errors import InputError
from lf_flame.formats.hdf5_and_matlab import Hdf5File, MatlabFile, is_matlab_hdf5
from lf_flame.formats.lenslet_image import cut_views
from lf_flame.formats.view_files.orders import Grid, arranged_light_field, as_grid, check_grid
from lf_flame.formats.view_files.parallax_order import FoundOrder
from lf_flame.formats.view_files.running_numbers import fold, grids_of
from lf_flame.lightfield import LightField

HDF5_SUFFIXES, MATLAB_SUFFIX, ZARR_SUFFIX = (".h5", ".hdf5"), ".mat", ".zarr"

ARRAY_SUFFIXES = (".npy", ".npz", *HDF5_SUFFIXES, MATLAB_SUFFIX, ZARR_SUFFIX)
"""File endings of arrays."""

WEIGHTS, VALID = "weights", "valid"
"""Names of the arrays with the weights of views, and the known pixels, in a ``.npz`` file."""

VIEWS, TOOLBOX = "views", "LF"
"""Names of the array with the views: this program's, and that of HCI and LFToolbox."""

COLOURS = 3
"""Number of colours in an array of LFToolbox, after which its weight comes."""

MOST_ARRAYS = 1000
"""Largest number of arrays in a ``.npz`` file among which the views are searched for."""

MOST_NAMED = 5
"""Largest number of arrays that an error names."""

ORDERS_OF_AXES = (
    "tsvu", "stuv", "ntsc", "ncts", "cnts", "vtus", "nts", "tsn", "cts", "vucts", "cvuts", "tsvuc",
    "cstuv",
)  # fmt: skip
"""Axis orders of other programs' light fields, beside ``vuts`` and ``vutsc``; those of MATLAB are
backwards in HDF5 files."""

MOST_COLOURS = 4
"""Largest number of channels of an array whose axes are not stated."""

SQUARE_OF_VIEWS = 25
"""Number from which a square count beside an axis of 3 or 4 means views beside colours."""


def read_array(
    path: str | Path,
    views: int | None = None,
    *,
    axes: str | None = None,
    grid: Grid | str | None = None,
    array: str | None = None,
    order: str | None = None,
) -> LightField:
    """Read a light field from a file of arrays.

    Parameters
    ----------
    path : str or Path
        ``.npy``, ``.npz``, ``.h5``, ``.hdf5``, ``.mat`` or ``.zarr`` file with an array ``[v, u,
        t, s]`` or ``[v, u, t, s, channels]``, or a raw lenslet array of 2 or 3 axes: the one named
        ``views`` or ``LF``, or the only array, or the only one of 4 or 5 axes. In a ``.npz`` or
        ``.zarr`` file an array ``weights``, [v, u], holds the weights of views, and ``valid``, [v,
        u, t, s], whether each pixel is known. Arrays of MATLAB have the axes that MATLAB shows.
    views : int, optional
        Number of pixels under a lenslet along each axis of a raw lenslet array.
    axes : str, optional
        Meaning of the axes, one letter each: v and u, row and column of the view, or n, its
        running number; t and s, row and column of the pixel; c, the channel. Default: ``vuts``,
        ``vutsc``, or a raw array; an array of unlikely shape for these is refused.
    grid : (int, int) or str, optional
        Number of rows and columns of views for a running number, such as (9, 9) or ``9x9``.
    array : str, optional
        Name of the array, where the file holds several.
    order : str, optional
        Order of the views, as in `lf_flame.formats.scan_view_folder`. Default: for a running number
        the one that the parallax shows, otherwise the stored one.

    Returns
    -------
    LightField
        Views; unsigned levels of 8 or 16 bits are scaled to 0 to 1, floats stay as they are. An
        array ``LF`` of four channels in a ``.mat`` file is one of LFToolbox, whose last channel is
        a weight: the mean of a view's pixels, relative to that of the brightest view, is its
        weight in the light field, and pixels of weight 0 are unknown.

    Raises
    ------
    InputError
        If the file cannot be read, holds other arrays, or `views` does not divide a raw array.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import LightField, formats
    >>> light_field = LightField(np.random.default_rng(1).uniform(size=(3, 3, 20, 30)))

    >>> np.save("views.npy", light_field.views)
    >>> formats.read_array("views.npy")
    LightField(3 x 3 views of 20 x 30 pixels, grey)
    """
    stored, found = read_stored_array(path, views, axes=axes, grid=grid, array=array, order=order)
    return arranged_light_field(stored, order if found is None else found.order)


def read_stored_array(
    path: str | Path,
    views: int | None,
    *,
    axes: str | None,
    grid: Grid | str | None,
    array: str | None,
    order: str | None,
) -> tuple[LightField, FoundOrder | None]:
    """Read the views in the order stored, and find the order of those with a running number.

    Arguments and errors are those of `read_array`; the order is None for any other array.
    """
    with open_file(path) as file:
        name = choose_array(file, axes, array)
        stored = file.header(name).dtype.itemsize
        # As stored, as floats, and once more after the axes are reordered.
        (held,) = file.read([name], copies=1 + (1 + (stored < FLOAT)) * FLOAT / stored)
        keeps = isinstance(file, ArrayFile | ZarrFile)
        beside = set(file.names) - {name} if keeps else set()
        weights, valid = (
            file.read([one])[0] if one in beside else None for one in (WEIGHTS, VALID)
        )
    if name == TOOLBOX and Path(path).suffix.lower() == MATLAB_SUFFIX and axes is None:
        held, weights, valid = _without_weight(held, path)
    if axes is not None:
        ours, found = _arrange(to_unit(held, path), axes.lower(), path, as_grid(grid), order)
        if found is None:
            ours = cut_views(ours, views, path) if ours.ndim < 4 else ours
            check_grid(as_grid(grid), ours.shape[:2], path)
        return LightField(ours, weights=weights, valid=valid), found
    if grid is not None:
        raise InputError(f"grid is for views with a running number: state the axes of {path}, too.")
    if held.ndim not in (2, 3, 4, 5) or held.size == 0:
        raise InputError(
            f"{path} must hold views[v, u, t, s] (with a last axis of channels or without), or a "
            f"raw lenslet array, got shape {held.shape}."
        )
    check_shape(held.shape, path)
    held = to_unit(held, path)
    ours = cut_views(held, views, path) if held.ndim < 4 else held
    return LightField(ours, weights=weights, valid=valid), None


AnyFile = ArrayFile | Hdf5File | MatlabFile | ZarrFile
"""A file of arrays."""


@contextmanager
def open_file(path: str | Path) -> Iterator[AnyFile]:
    """Open a file of arrays by its ending, and one of MATLAB by its content."""
    suffix = Path(path).suffix.lower()
    if suffix == ZARR_SUFFIX:
        yield ZarrFile(path)
    elif suffix in HDF5_SUFFIXES or (suffix == MATLAB_SUFFIX and is_matlab_hdf5(path)):
        yield Hdf5File(path)
    elif suffix == MATLAB_SUFFIX:
        yield MatlabFile(path)
    else:
        with open_arrays(path) as file:
            yield file


def _without_weight(
    array: np.ndarray, path: str | Path
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
    """Part colours and weight of an array of LFToolbox, as views, their weights and known pixels.

    Weights of views, (v, u), are their means; a pixel of weight 0 in a view that counts is unknown.

    LFToolbox divides a raw image by the white image and keeps the white image as the weight of a
    pixel, so the weight is inverse to the variance of its noise.
    """
    if array.ndim != 5 or array.shape[4] != COLOURS + 1:
        return array, None, None
    weights = array[..., COLOURS].mean(axis=(2, 3), dtype=np.float64)
    if not (np.all(weights >= 0) and 0 < weights.max() < np.inf):
        raise InputError(
            f"{path}: the fourth channel of {TOOLBOX} must be a weight, 0 or above, with one above "
            f"0; state --axes vutsc to read it as a channel."
        )
    weights /= weights.max()
    valid = (array[..., COLOURS] > 0) | (weights == 0)[..., None, None]
    return array[..., :COLOURS], None if np.all(weights == 1) else weights, valid


def _arrange(
    array: np.ndarray, axes: str, path: str | Path, shape: Grid | None, order: str | None
) -> tuple[np.ndarray, FoundOrder | None]:
    """Reorder an array with stated axes to ``[v, u, t, s]`` or ``[v, u, t, s, c]``.

    A raw lenslet array has no v and u. The second result is the order of views with a running
    number.
    """
    of_views = "n" if "n" in axes else "vu" if set(axes) & set("vu") else ""
    wanted = of_views + "ts" + ("c" if "c" in axes else "")
    if sorted(axes) != sorted(wanted) or len(axes) != array.ndim:
        raise InputError(
            f"axes must be one letter for each axis of {path}, whose shape is {array.shape}: v and "
            f"u or n for views (none in a raw array), t and s for pixels, c for channels, got "
            f"{axes!r}."
        )
    ours = array.transpose([axes.index(letter) for letter in wanted])
    if "n" in axes:
        return fold(ours, path, shape, order)
    return ours, None


def check_shape(shape: tuple[int, ...], path: str | Path) -> None:
    """Refuse an array with a shape that is unlikely for the default axes."""
    axes = {2: "ts", 3: "tsc", 4: "vuts", 5: "vutsc"}[len(shape)]
    if not _unlikely(shape, axes):
        return
    like = [other for other in ORDERS_OF_AXES if len(other) == len(shape)]
    if Path(path).suffix.lower() in HDF5_SUFFIXES:
        like.sort(key=lambda other: other != axes[::-1])  # MATLAB's comes first
    like = [other for other in like if not _unlikely(shape, other)]
    if not like and axes.endswith("c") and not _unlikely(shape[:-1], axes[:-1]):
        return  # as many channels as a spectrum has
    best = min(like, key=lambda other: _oddness(shape, other), default="")
    looks = f", and looks like axes {best}" if best else ""
    stated = f"as --axes {best}{_grid_option(shape, best)}" if best else "by --axes"
    raise InputError(
        f"{path} holds an array of shape {shape}, which can hardly be [{', '.join(axes)}]{looks}: "
        f"state what they are, {stated} (v, u or a running n: views; t, s: rows and columns of "
        f"pixels; c: channels)."
    )


def _grid_option(shape: tuple[int, ...], axes: str) -> str:
    """Option that states rows x columns of views with a running number, unless it is a square."""
    if "n" not in axes or _is_square(shape[axes.index("n")]):
        return ""
    return f" --grid {grids_of(shape[axes.index('n')])[0]}"


def _is_square(count: int) -> bool:
    return isqrt(count) ** 2 == count


def _oddness(shape: tuple[int, ...], axes: str) -> tuple[bool, float, int, int]:
    """Rank a shape among likely ones, the most usual first.

    Unusual are a running number that is no square, rows and columns of views of unlike numbers,
    many channels and many views, in this order.
    """
    size = dict(zip(axes, shape, strict=True))
    n, v, u = (size.get(name, 1) for name in "nvu")
    return not _is_square(n), max(v, u) / min(v, u), size.get("c", 1), n


def _unlikely(shape: tuple[int, ...], axes: str) -> bool:
    """Whether a shape is unlikely for these axes.

    It is, if there are more views than pixels or more channels than colours, or if the views look
    like a running number beside 3 or 4 colours.
    """
    size = dict(zip(axes, shape, strict=True))
    views = size.get("n", 1) * size.get("v", 1) * size.get("u", 1)
    channels, across = size.get("c", 1), sorted((size.get("v", 1), size.get("u", 1)))
    square = _is_square(max(across)) and max(across) >= SQUARE_OF_VIEWS
    return (
        views >= max(2, size["t"] * size["s"])
        or channels > MOST_COLOURS
        or (square and across[0] in (3, 4))
    )


def choose_array(file: AnyFile, axes: str | None, stated: str | None) -> str:
    """Name of the array that holds the views."""
    ranks = (4, 5) if axes is None else (len(axes),)
    if stated is not None:
        if stated not in file.names:
            held = ", ".join(file.names[:MOST_NAMED]) or "none"
            raise InputError(f"{file.path} has no array {stated!r} of numbers; it has {held}.")
        return stated
    for name in (VIEWS, *([] if isinstance(file, ArrayFile) else [TOOLBOX])):
        if name in file.names:
            return name
    if len(file.names) == 1:
        return file.names[0]
    headers = {name: file.header(name) for name in file.names[:MOST_ARRAYS]}
    fitting = [name for name, header in headers.items() if len(header.shape) in ranks]
    fitting = [name for name in fitting if name != VALID] or fitting
    if len(fitting) != 1 or len(file.names) > MOST_ARRAYS:
        shown = [f"{name} {header.shape}" for name, header in headers.items()][:MOST_NAMED]
        more = f" and {len(file.names) - MOST_NAMED} more" if len(file.names) > MOST_NAMED else ""
        raise InputError(
            f"{file.path} must hold one array named views, or one only of "
            f"{' or '.join(map(str, ranks))} axes, got {', '.join(shown) or 'none'}{more}; name "
            f"one by --array (in Python array=...)."
        )
    return fitting[0]
