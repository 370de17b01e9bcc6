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
    find_order,
    fold,
    half_turned,
    stated_order,
)
from lf_flame.formats.zarr_arrays import ZarrFile
from lf_flame.lightfield import LightField

HDF5_SUFFIXES, MATLAB_SUFFIX, ZARR_SUFFIX = (".h5", ".hdf5"), ".mat", ".zarr"

ARRAY_SUFFIXES = (".npy", ".npz", *HDF5_SUFFIXES, MATLAB_SUFFIX, ZARR_SUFFIX)
"""File endings of arrays."""

TOOLBOX, DEPTH = "LF", "GT_DEPTH"
"""Names of the views in files of HCI and LFToolbox, and of the depths in those of HCI."""

COLOURS = 3
"""Number of colours in an array of LFToolbox, after which its weight comes."""

DEFAULT_AXES = {2: "ts", 3: "tsc", 4: "vuts", 5: "vutsc"}
"""Axes of an array for which none are stated, by their number; the first two are raw arrays."""

OTHER_AXES = {
    2: (),
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
    grid: Grid | None = None,
    array: str | None = None,
    order: str | None = None,
) -> tuple[LightField, ViewOrder]:
    """Read views as they are stored, and their order; arguments as in `read_light_field`.

    The array is the one named ``views`` or ``LF``, or the only one, or the only one of 4 or 5 axes.
    Arrays of MATLAB have the axes that MATLAB shows. In NumPy and Zarr files an array ``weights``
    holds the weights of views, and ``valid`` whether each pixel is known. An array ``LF`` of four
    channels in a ``.mat`` file is one of LFToolbox, whose last channel is a weight. The order is
    found for views with a running number and in files of the HCI data set.
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
        held, weights, valid = _without_weight(held)
    is_stated = axes is not None
    axes = axes.lower() if axes is not None else _default_axes(held.shape, path)
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
        ours, found = fold(ours, path, grid, order)
    elif not of_views:
        ours = cut_views(ours, views, path)
    elif found is AS_STORED and not is_stated and isinstance(file, Hdf5File):
        found = _find_hci_order(file, ours)
    return LightField(ours, weights=weights, valid=valid), found


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
    if stated is None and len(file.names) == 1:
        return file.names[0]
    for name in ("views", TOOLBOX) if stated is None else (stated,):
        if name in file.names:
            return name
    headers = {name: file.header(name) for name in file.names[:1000]}
    ranks = (4, 5) if axes is None else (len(axes),)
    fitting = [name for name, one in headers.items() if len(one.shape) in ranks]
    fitting = [name for name in fitting if name != "valid"] or fitting
    if stated is None and len(fitting) == 1:
        return fitting[0]
    wanted = f"views, or only one of {' or '.join(map(str, ranks))} axes"
    held = [f"{name} {one.shape}" for name, one in headers.items()]
    raise InputError(
        f"{file.path} must hold an array of numbers named {wanted if stated is None else stated}, "
        f"got {', '.join(held[:5]) or 'none'}{' ...' if len(held) > 5 else ''}; name one by "
        f"`lf-flame convert --array` (in Python array=...)."
    )


def _without_weight(array: np.ndarray) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
    """Part colours and weight of an array of LFToolbox, as views, their weights and known pixels.

    LFToolbox divides a raw image by the white image and keeps the white image as the weight of a
    pixel, so the weight is inverse to the variance of its noise. Views get the mean of their
    weights; a pixel of weight 0 in a view of another weight is unknown.
    """
    if array.ndim != 5 or array.shape[4] != COLOURS + 1:
        return array, None, None
    weights = array[..., COLOURS].mean(axis=(2, 3), dtype=np.float64)
    weights /= max(weights.max(), np.finfo(float).tiny)
    valid = (array[..., COLOURS] > 0) | (weights == 0)[..., None, None]
    return array[..., :COLOURS], weights, valid


def _default_axes(shape: tuple[int, ...], path: str | Path) -> str:
    """Axes of an array for which none are stated; refuse a shape that looks like others."""
    if len(shape) not in DEFAULT_AXES or 0 in shape:
        raise InputError(
            f"{path} must hold views[v, u, t, s] (with a last axis of channels or without), or a "
            f"raw lenslet array, got shape {shape}."
        )
    axes = DEFAULT_AXES[len(shape)]
    others = OTHER_AXES[len(shape)]
    if Path(path).suffix.lower() in HDF5_SUFFIXES:
        others = (axes[::-1], *others)  # as MATLAB writes them
    counts = {one: count for one in others if (count := _count_views(shape, one))}
    is_spectral = not counts and axes == "vutsc" and _count_views(shape[:-1], axes[:-1])
    if _count_views(shape, axes) or is_spectral:
        return axes
    best = min(counts, key=lambda one: counts[one], default="")
    looks = f", but looks like {best}" if best else ""
    raise InputError(
        f"{path} holds an array of shape {shape}, which can hardly be {axes}{looks}: state its "
        f"axes by `lf-flame convert --axes {best or 'AXES'}` (v, u or a running n: views; t, s: "
        f"rows and columns of pixels; c: channels)."
    )


def _count_views(shape: tuple[int, ...], axes: str) -> int:
    """Count views, if a shape suits axes: fewer views than pixels, and at most four channels.

    A square number of views beside 3 or 4 others is a running number beside colours.
    """
    size = dict(zip(axes, shape, strict=True))
    few, many = sorted((size.get("v", 1), size.get("u", 1)))
    is_coloured = few in (3, 4) and many >= 25 and isqrt(many) ** 2 == many
    count = few * many * size.get("n", 1)
    fits = size.get("c", 1) <= 4 and count < max(2, size["t"] * size["s"]) and not is_coloured
    return count if fits else 0
