"""Light fields of the old HCI benchmark (Wanner, Meister, Goldluecke 2013), in HDF5 files.

``/LF`` holds the views, ``/GT_DEPTH`` the depth of their pixels. With the attributes ``dH``,
``focalLength`` and ``shift`` of the file, the disparity of a point at depth z is ``dH focalLength /
z - shift``: by so many pixels it moves to the left from one view to the next on the right. Its
slope is minus that. One of the two axes of views is stored the other way round.
"""

from dataclasses import replace

import numpy as np

from lf_flame._common.images import FLOAT
from lf_flame.formats.hdf5_and_matlab import Hdf5File
from lf_flame.formats.view_files.orders import ViewOrder, find_order, half_turned

DEPTH = "GT_DEPTH"
"""Name of the depths."""


def is_hci(file: Hdf5File) -> bool:
    """Whether an HDF5 file holds views and the attributes of this benchmark."""
    return "LF" in file.names and {"dH", "focalLength", "shift"} <= set(file.numbers)


def find_hci_order(file: Hdf5File, views: np.ndarray) -> ViewOrder:
    """Find the order of stored views by the parallax, and the sign of their slopes by the depths.

    No parallax shows which axis is stored the other way round, on which the sign of all slopes
    depends. Without depths, columns are assumed to run from left to right.
    """
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
