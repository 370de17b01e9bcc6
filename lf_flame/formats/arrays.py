"""Light fields in files of arrays: NumPy, HDF5, MATLAB and Zarr; nothing is unpickled."""

from dataclasses import replace
from math import isqrt
from pathlib import Path

import numpy as np

from lf_flame._common.arrays_in_files import ArrayFile, FileOfArrays
from lf_flame._common.images import FLOAT, to_unit
from lf_flame.errors import InputError
from lf_flame.formats.hdf5_and_matlab import Hdf5File, MatlabFile, is_matlab_hdf5
from lf_flame.formats.stacks import cut_views
from lf_flame.formats.view_files.orders import (
    AS_STORED,
    Grid,
    ViewOrder,
    arranged_light_field,
    check_grid,
    find_order,
    fold,
    half_turned,
    read_grid,
    stated_order,
)
from lf_flame.formats.zarr_arrays import ZarrFile
from lf_flame.lightfield import LightField

HDF5_SUFFIXES, MATLAB_SUFFIX, ZARR_SUFFIX = (".h5", ".hdf5"), ".mat", ".zarr"

ARRAY_SUFFIXES = (".npy", ".npz", *HDF5_SUFFIXES, MATLAB_SUFFIX, ZARR_SUFFIX)
"""File endings of arrays."""

VIEWS, TOOLBOX = "views", "LF"
"""Names of the array with the views: this program's, and that of HCI and LFToolbox."""

DEPTH = "GT_DEPTH"
"""Name of the depths in files of HCI."""

COLOURS = 3
"""Number of colours in an array of LFToolbox, after which its weight comes."""

DEFAULT_AXES = {2: "ts", 3: "tsc", 4: "vuts", 5: "vutsc"}
"""Axes of an array for which none are stated, by their number; the first two are raw arrays."""

OTHER_AXES = {
    3: ("nts", "tsn", "cts"),
    4: ("tsvu", "ntsc", "ncts", "cnts", "vtus"),
    5: ("vucts", "cvuts", "tsvuc", "cstuv"),
}
"""Axis orders of other programs, beside those of MATLAB, which are backwards in HDF5 files."""


def read_array(
    path: str | Path,
    *,
    views: int | None = None,
    axes: str | None = None,
    grid: Grid | str | None = None,
    array: str | None = None,
    order: str | None = None,
) -> tuple[LightField, ViewOrder]:
    """Read a light field from a file of arrays; arguments as in `lf_flame.read_light_field`.

    The array is the one named ``views`` or ``LF``, or the only one, or the only one of 4 or 5 axes.
    Arrays of MATLAB have the axes that MATLAB shows. In NumPy and Zarr files an array ``weights``
    holds the weights of views, and ``valid`` whether each pixel is known. An array ``LF`` of four
    channels in a ``.mat`` file is one of LFToolbox, whose last channel is a weight.

    Returns
    -------
    LightField
        Views; unsigned levels of 8 or 16 bits are scaled to 0 to 1, floats stay as they are.
    ViewOrder
        Order that was stated; for views with a running number and files of the HCI data set that
        which was found, and for others as stored.
    """
    file = _open(path)
    name = _choose_array(file, axes, array)
    stored = file.header(name).dtype.itemsize
    # As stored, as floats, and once more after the axes are reordered.
    (held,) = file.read([name], copies=1 + (1 + (stored < FLOAT)) * FLOAT / stored)
    beside = set(file.names) - {name} if isinstance(file, ArrayFile | ZarrFile) else set()
    weights, valid = (
        file.read([one])[0] if one in beside else None for one in ("weights", "valid")
    )
    if name == TOOLBOX and Path(path).suffix.lower() == MATLAB_SUFFIX and axes is None:
        held, weights, valid = _without_weight(held, path)
    is_stated = axes is not None
    if axes is None:
        _check_shape(held.shape, path)
        axes = DEFAULT_AXES[held.ndim]
    axes, shape = axes.lower(), None if grid is None else read_grid(grid)
    of_views = "n" if "n" in axes else "vu" if set(axes) & set("vu") else ""
    wanted = of_views + "ts" + ("c" if "c" in axes else "")
    if sorted(axes) != sorted(wanted) or len(axes) != held.ndim:
        raise InputError(
            f"axes must be one letter for each axis of {path}, whose shape is {held.shape}: v and "
            f"u or n for views (none in a raw array), t and s for pixels, c for channels, got "
            f"{axes!r}."
        )
    found = stated_order(order)
    ours = to_unit(held, path).transpose([axes.index(letter) for letter in wanted])
    if of_views == "n":
        ours, found = fold(ours, path, shape, order)
    elif not of_views:
        ours = cut_views(ours, views, path)
    elif found is AS_STORED and not is_stated and isinstance(file, Hdf5File):
        found = _find_hci_order(file, ours)
    light_field = LightField(ours, weights=weights, valid=valid)
    light_field = arranged_light_field(light_field, found.order)
    check_grid(shape, light_field.views.shape[:2], path)
    return light_field, found


def _find_hci_order(file: Hdf5File, views: np.ndarray) -> ViewOrder:
    """Find the order of stored views of the old HCI benchmark, and the sign of their slopes.

    In these HDF5 files (Wanner, Meister, Goldluecke 2013) a point at depth z moves to the left by
    the disparity ``dH focalLength / z - shift`` from one view to the next on the right, and its
    slope is minus that. One of the two axes of views is stored the other way round, which no
    parallax shows and the depths do. Without depths, columns run from left to right.
    """
    if TOOLBOX not in file.names or not {"dH", "focalLength", "shift"} <= set(file.numbers):
        return AS_STORED
    found = find_order(views)
    if found.slopes is None or DEPTH not in file.names:
        return found
    (depth,) = file.read([DEPTH], copies=3 * FLOAT / file.header(DEPTH).dtype.itemsize + 1)
    depth, numbers = depth[..., ::4, ::4], file.numbers
    depth = depth[depth > 0]
    if not depth.size:
        return found
    slopes = numbers["shift"] - numbers["dH"] * numbers["focalLength"] / depth
    true, (low, high) = np.percentile(slopes, (5, 95)), found.slopes
    reason = f"{found.reason}, with the sign by the depths of {DEPTH}"
    if np.abs([-high, -low] - true).sum() < np.abs([low, high] - true).sum():
        return ViewOrder(half_turned(found.order), reason)
    return replace(found, reason=reason, slopes=None)


def _open(path: str | Path) -> FileOfArrays:
    """Open a file of arrays by its ending, and one of MATLAB by its content."""
    suffix = Path(path).suffix.lower()
    if suffix == ZARR_SUFFIX:
        return ZarrFile(path)
    if suffix in HDF5_SUFFIXES or (suffix == MATLAB_SUFFIX and is_matlab_hdf5(path)):
        return Hdf5File(path)
    return MatlabFile(path) if suffix == MATLAB_SUFFIX else ArrayFile(path)


def _choose_array(file: FileOfArrays, axes: str | None, stated: str | None) -> str:
    """Choose the array that holds the views, by its name or its number of axes."""
    usual = (VIEWS,) if isinstance(file, ArrayFile) else (VIEWS, TOOLBOX)
    if stated is None and len(file.names) == 1:
        return file.names[0]
    named = [name for name in ((stated,) if stated is not None else usual) if name in file.names]
    if named:
        return named[0]
    headers = {name: file.header(name) for name in file.names[:1000]}
    some = [f"{name} {header.shape}" for name, header in list(headers.items())[:5]]
    held = ", ".join(some) or "none"
    if stated is not None:
        raise InputError(f"{file.path} has no array {stated!r} of numbers; it has {held}.")
    ranks = (4, 5) if axes is None else (len(axes),)
    fitting = [name for name, header in headers.items() if len(header.shape) in ranks]
    fitting = [name for name in fitting if name != "valid"] or fitting
    if len(fitting) == 1:
        return fitting[0]
    raise InputError(
        f"{file.path} must hold one array named views, or only one of "
        f"{' or '.join(map(str, ranks))} axes, got {held}{' ...' if len(headers) > 5 else ''}; "
        f"name one by `lf-flame convert --array` (in Python array=...)."
    )


def _without_weight(
    array: np.ndarray, path: str | Path
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
    """Part colours and weight of an array of LFToolbox, as views, their weights and known pixels.

    LFToolbox divides a raw image by the white image and keeps the white image as the weight of a
    pixel, so the weight is inverse to the variance of its noise. Views get the mean of their
    weights; a pixel of weight 0 in a view of another weight is unknown.
    """
    if array.ndim != 5 or array.shape[4] != COLOURS + 1:
        return array, None, None
    weights = array[..., COLOURS].mean(axis=(2, 3), dtype=np.float64)
    if not (np.all(weights >= 0) and 0 < weights.max() < np.inf):
        raise InputError(
            f"{path}: the fourth channel of {TOOLBOX} must be a weight, 0 or above, with one above "
            f"0; state the axes vutsc to read it as a channel."
        )
    weights /= weights.max()
    valid = (array[..., COLOURS] > 0) | (weights == 0)[..., None, None]
    return array[..., :COLOURS], None if np.all(weights == 1) else weights, valid


def _check_shape(shape: tuple[int, ...], path: str | Path) -> None:
    """Refuse an array that does not look like views[v, u, t, s]; say what it looks like."""
    if len(shape) not in DEFAULT_AXES or 0 in shape:
        raise InputError(
            f"{path} must hold views[v, u, t, s] (with a last axis of channels or without), or a "
            f"raw lenslet array, got shape {shape}."
        )
    axes = DEFAULT_AXES[len(shape)]
    others = OTHER_AXES.get(len(shape), ())
    if Path(path).suffix.lower() in HDF5_SUFFIXES:
        others = (axes[::-1], *others)  # as MATLAB writes them
    likely = [one for one in others if _is_likely(shape, one)]
    spectral = not likely and axes == "vutsc" and _is_likely(shape[:-1], axes[:-1])
    if _is_likely(shape, axes) or spectral:
        return
    best = min(likely, key=lambda one: _oddness(shape, one), default="")
    looks = f", but looks like {best}" if best else ""
    raise InputError(
        f"{path} holds an array of shape {shape}, which can hardly be {axes}{looks}: state its "
        f"axes by `lf-flame convert --axes {best or 'AXES'}` (v, u or a running n: views; t, s: "
        f"rows and columns of pixels; c: channels)."
    )


def _is_likely(shape: tuple[int, ...], axes: str) -> bool:
    """Whether a shape suits axes: fewer views than pixels, and at most four channels.

    A square number of views beside 3 or 4 others is a running number beside colours.
    """
    size = dict(zip(axes, shape, strict=True))
    few, many = sorted((size.get("v", 1), size.get("u", 1)))
    coloured = few in (3, 4) and many >= 25 and _is_square(many)
    fewer = few * many * size.get("n", 1) < max(2, size["t"] * size["s"])
    return size.get("c", 1) <= 4 and fewer and not coloured


def _oddness(shape: tuple[int, ...], axes: str) -> tuple:
    """Rank likely axes: square numbers of views first, then even rows and columns, then few."""
    size = dict(zip(axes, shape, strict=True))
    n, v, u = (size.get(letter, 1) for letter in "nvu")
    return not _is_square(n), max(v, u) / min(v, u), size.get("c", 1), n


def _is_square(count: int) -> bool:
    return isqrt(count) ** 2 == count
