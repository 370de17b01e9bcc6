"""Orders in which an image holds its pixels: sub-aperture views, the raw image, or chosen lines.

All are arrays ``[a, b, c, d]``. The place of a pixel along y is (a, c), along x (b, d): views are
``[v, u, t, s]``, and the raw lenslet image has a = b = 0. One kernel therefore writes all layouts.
"""

from typing import NamedTuple

import numpy as np

from lf_flame.optics.camera import PlenopticCamera


class Lines(NamedTuple):
    """Rows and columns at whose crossings the pixels of an image are chosen; a = b = 0.

    Attributes
    ----------
    rows, columns : ndarray of int64
        Line ``view * lenslets + lenslet`` of each, along y and along x.
    """

    rows: np.ndarray
    columns: np.ndarray


Layout = str | Lines
"""Order of pixels: "views", "raw" or chosen lines."""


def blank_image(camera: PlenopticCamera, layout: Layout, dtype=np.float32) -> np.ndarray:
    """Make a dark image ``[a, b, c, d]``; memory that no light reaches is never touched.

    Parameters
    ----------
    camera : PlenopticCamera
    layout : {"views", "raw"} or Lines
    dtype : dtype, optional

    Returns
    -------
    ndarray, shape (v, u, t, s); (1, 1, t * v, s * u) for the raw image; (1, 1, rows, columns)
    """
    if isinstance(layout, Lines):
        return np.zeros((1, 1, layout.rows.size, layout.columns.size), dtype)
    n, (lines, columns) = camera.views, camera.lenslets
    shape = (n, n, lines, columns) if layout == "views" else (1, 1, lines * n, columns * n)
    return np.zeros(shape, dtype)


def as_views(image: np.ndarray, camera: PlenopticCamera, layout: str) -> np.ndarray:
    """Show an image of views or a raw image as ``[v, u, t, s]``, without a copy."""
    if layout == "views":
        return image
    lines, columns = camera.lenslets
    raw = image.reshape(lines, camera.views, columns, camera.views)
    return raw.transpose(1, 3, 0, 2)


def arrange(table: np.ndarray, layout: Layout, axis: int) -> np.ndarray:
    """Bring a table [view, lenslet, ...] of an axis into the order of an image."""
    if isinstance(layout, Lines):
        return table.reshape(1, -1, *table.shape[2:])[:, layout[axis]]
    if layout == "views":
        return table
    raw = np.swapaxes(table, 0, 1)
    return raw.reshape(1, raw.shape[0] * raw.shape[1], *raw.shape[2:])


def seen_range(seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the first and one past the last place d that sees a plane, for each b.

    Parameters
    ----------
    seen : ndarray of bool, shape (b, d)

    Returns
    -------
    first, last : ndarray of int64, shape (b,)
        Both 0 where no place sees it.
    """
    any_seen = seen.any(axis=1)
    first = np.where(any_seen, seen.argmax(axis=1), 0)
    last = np.where(any_seen, seen.shape[1] - seen[:, ::-1].argmax(axis=1), 0)
    return first, last
