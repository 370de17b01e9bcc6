"""The two orders in which an image holds its pixels: sub-aperture views, or the raw image.

Both are arrays ``[a, b, c, d]``. The place of a pixel along y is (a, c), along x (b, d): views are
``[v, u, t, s]``, and the raw lenslet image has a = b = 0. One kernel therefore writes both layouts.
"""

import numpy as np

from lf_flame.optics.camera import PlenopticCamera


def blank_image(camera: PlenopticCamera, layout: str, dtype=np.float32) -> np.ndarray:
    """Make a dark image ``[a, b, c, d]``; memory that no light reaches is never touched.

    Parameters
    ----------
    camera : PlenopticCamera
    layout : {"views", "raw"}
    dtype : dtype, optional

    Returns
    -------
    ndarray, shape (v, u, t, s), or (1, 1, t * v, s * u) for the raw image
    """
    n, (lines, columns) = camera.views, camera.lenslets
    shape = (n, n, lines, columns) if layout == "views" else (1, 1, lines * n, columns * n)
    return np.zeros(shape, dtype)


def as_views(image: np.ndarray, camera: PlenopticCamera, layout: str) -> np.ndarray:
    """Show an image of either layout as ``[v, u, t, s]``, without a copy."""
    if layout == "views":
        return image
    lines, columns = camera.lenslets
    raw = image.reshape(lines, camera.views, columns, camera.views)
    return raw.transpose(1, 3, 0, 2)


def arrange(table: np.ndarray, layout: str) -> np.ndarray:
    """Bring a table [view, lenslet, ...] into the order of an image's axes, (a, c) or (b, d)."""
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
