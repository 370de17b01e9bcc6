"""Light fields of the old HCI benchmark (Wanner, Meister, Goldluecke 2013), in HDF5 files.

``/LF`` holds the views, ``/GT_DEPTH`` the depth of their pixels. With the attributes ``dH``,
``focalLength`` and ``shift`` of the file, the disparity of a point at depth z is ``dH focalLength /
z - shift``: by so many pixels it moves to the left from one view to the next on the right. Its
slope is minus that. One of the two axes of views is stored the other way round.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from lf_flame._common.images import FLOAT
from lf_flame.errors import InputError
from lf_flame.formats.hdf5_and_matlab import Hdf5File
from lf_flame.formats.view_files.orders import FoundOrder, arranged, find_order, half_turned

DEPTH = "GT_DEPTH"
"""Name of the depths."""


def is_hci(file: Hdf5File) -> bool:
    """Whether an HDF5 file holds views and the attributes of this benchmark."""
    return "LF" in file.names and {"dH", "focalLength", "shift"} <= set(file.numbers)


def find_hci_order(file: Hdf5File, views: np.ndarray) -> FoundOrder:
    """Find the order of stored views by the parallax, and the sign of their slopes by the depths.

    No parallax shows which axis is stored the other way round, on which the sign of all slopes
    depends. Without depths, columns are assumed to run from left to right.
    """
    found = find_order(views)
    slopes = _slopes(file)[..., ::4, ::4] if DEPTH in file.names else np.array([])
    slopes = slopes[np.isfinite(slopes)]
    if found.slopes is None or not slopes.size:
        return found
    true, (low, high) = np.percentile(slopes, (5, 95)), found.slopes
    reason = f"{found.reason}, with the sign by the depths of {DEPTH}"
    if np.abs([-high, -low] - true).sum() < np.abs([low, high] - true).sum():
        return FoundOrder(half_turned(found.order), reason)
    return replace(found, reason=reason, slopes=None)


def read_true_slopes(path: str | Path) -> np.ndarray:
    """Read the true slope of each pixel from a file of the old HCI benchmark.

    Parameters
    ----------
    path : str or Path
        HDF5 file with the array ``GT_DEPTH`` and the attributes dH, focalLength and shift.

    Returns
    -------
    ndarray of float32, shape (v, u, t, s), or (t, s) if the file has one view's depths only
        Slopes in pixels per view step, in the order of views that `read_light_field` finds; NaN
        where the depth is not above 0.

    Raises
    ------
    InputError
        If the file cannot be read, or has no depths.

    Examples
    --------
    >>> import h5py
    >>> import numpy as np
    >>> from lf_flame.formats import read_true_slopes
    >>> with h5py.File("scene.h5", "w") as file:
    ...     file.attrs.update(dH=0.1, dV=0.1, focalLength=100.0, shift=2.0)
    ...     file["LF"] = np.zeros((3, 3, 20, 30, 3), np.uint8)
    ...     file["GT_DEPTH"] = np.full((3, 3, 20, 30), 4.0, np.float32)
    >>> float(read_true_slopes("scene.h5")[1, 1, 0, 0])  # 2 - 0.1 * 100 / 4
    -0.5
    """
    file = Hdf5File(path)
    if not is_hci(file) or DEPTH not in file.names:
        raise InputError(
            f"{path} holds no true slopes: it needs the arrays LF and GT_DEPTH, and the attributes "
            f"dH, focalLength and shift."
        )
    slopes = _slopes(file)
    if slopes.ndim != 4:
        return slopes
    return arranged(slopes, find_hci_order(file, file.read(["LF"])[0]).order)


def _slopes(file: Hdf5File) -> np.ndarray:
    """Slopes of the pixels, in the order stored."""
    (depth,) = file.read([DEPTH], copies=3 * FLOAT / file.header(DEPTH).dtype.itemsize + 1)
    if depth.ndim not in (2, 4) or depth.size == 0:
        raise InputError(f"{file.path}: {DEPTH} must have 2 or 4 axes, got shape {depth.shape}.")
    depth = np.where(depth > 0, depth, np.nan).astype(np.float32)
    numbers = file.numbers
    return np.float32(numbers["shift"]) - np.float32(numbers["dH"] * numbers["focalLength"]) / depth
