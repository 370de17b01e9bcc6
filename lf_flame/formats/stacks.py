"""Several pictures in one file: views in lenslet images, mosaics and pages; refocused images."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import ArrayLike

from lf_flame._common.atomic_files import atomic_write
from lf_flame._common.config import build
from lf_flame._common.images import find_axes, open_tiff, pictures, read_tiff, to_unit
from lf_flame._common.input_files import parse_json
from lf_flame.errors import InputError
from lf_flame.formats.images import read_image
from lf_flame.formats.raw.lenslet_grid import grid_from_pitch
from lf_flame.formats.raw.sensor_images import check_colours
from lf_flame.formats.view_files.orders import (
    Grid,
    ViewOrder,
    find_order,
    fold,
    read_grid,
    stated_order,
)
from lf_flame.lightfield import LightField


def read_lenslets(
    path: str | Path, *, views: int | None = None, order: str | None = None
) -> tuple[LightField, ViewOrder]:
    """Read a rectified lenslet image (ESLF of the Lytro cameras), N x N pixels to a lenslet."""
    return LightField(cut_views(read_image(path), views, path)), stated_order(order)


def cut_views(raw: np.ndarray, views: int | None, source: str | Path) -> np.ndarray:
    """Cut a raw lenslet array into views; if `views` does not fit, the error says what would."""
    if views is None or views < 1 or any(n % views for n in raw.shape[:2]):
        common = math.gcd(*raw.shape[:2])
        fit = [str(n) for n in range(2, min(common, 64) + 1) if common % n == 0]
        raise InputError(
            f"To read {source} as a lenslet image, state the pixels under a lenslet (views), which "
            f"divide its {raw.shape[0]} x {raw.shape[1]} pixels "
            f"({', '.join(fit) or 'only 1 does'}), got {views}; to decode a raw image, give a "
            f"white image, the lenslets or the pitch."
        )
    if raw.ndim == 2 and views >= 5:  # with fewer pixels under a lenslet, views look like colours
        check_colours(raw, grid_from_pitch(raw.shape, views), "lenslet")
    return LightField.from_raw(raw, views=views).views


def read_mosaic(
    path: str | Path, *, mosaic: Grid | str, order: str | None = None
) -> tuple[LightField, ViewOrder]:
    """Read a picture that holds rows and columns of whole views, and find their order.

    In a lenslet image the pixels of one lenslet are neighbours; here those of one view are.
    """
    rows, columns = read_grid(mosaic, "mosaic")
    picture = read_image(path)
    height, width = picture.shape[:2]
    if height % rows or width % columns:
        raise InputError(
            f"A mosaic of {rows} x {columns} views needs sides that are multiples of these, and "
            f"{path} has {height} x {width} pixels: cut off its margins, or state other numbers."
        )
    size = (rows, height // rows, columns, width // columns, *picture.shape[2:])
    views = picture.reshape(size).swapaxes(1, 2)
    return LightField(views), find_order(views, stated=order)


def is_stack(path: str | Path) -> bool:
    """Whether a TIFF file holds more than one image; one in three channels is a colour image."""
    with open_tiff(path) as file:
        _, pages, _ = find_axes(pictures(file, path))
    return bool(pages)


def read_view_pages(
    path: str | Path, *, order: str | None = None, grid: Grid | None = None
) -> tuple[LightField, ViewOrder]:
    """Read the pages of a TIFF file as views, and find their order.

    The pages form rows and columns if the file has two page axes that are not named (as times or
    depths are); otherwise they count row by row a square, or the `grid`.
    """
    pages, letters, slopes = _read(path)
    if slopes is not None:
        raise InputError(f"{path} is a stack of refocused images, not of views.")
    if len(letters) == 2 and set(letters) <= set("QIN"):
        found = find_order(pages, stated=order)
    else:
        row = pages.reshape(-1, *pages.shape[len(letters) :])
        pages, found = fold(row, path, grid, order)
    return LightField(pages), found


def write_focal_stack(stack: ArrayLike, slopes: ArrayLike, path: str | Path) -> None:
    """Write refocused images as a TIFF file of float32 pages that ImageJ can open.

    Parameters
    ----------
    stack : array_like, shape (n, t, s) or (n, t, s, channels)
        Refocused images, up to 4 channels; a single channel loses its axis.
    slopes : sequence of float
        Slope of each image, stored in the file's description and in the labels of its pages.
    path : str or Path

    Raises
    ------
    InputError
        If stack and slopes do not match, or are larger than ImageJ can open.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.formats import read_focal_stack, write_focal_stack
    >>> write_focal_stack(np.ones((2, 20, 30), np.float32), [0.0, 1.0], "stack.tif")
    >>> stack, slopes = read_focal_stack("stack.tif")
    >>> stack.shape, [float(slope) for slope in slopes]
    ((2, 20, 30), [0.0, 1.0])
    """
    stack = np.asarray(stack, np.float32)
    numbers = [float(slope) for slope in np.atleast_1d(slopes)]
    if stack.ndim == 4 and stack.shape[3] == 1:
        stack = stack[..., 0]
    fits = stack.ndim in (3, 4) and stack.size and stack.shape[3:] <= (4,)
    if not fits or len(stack) != len(numbers):
        raise InputError(
            f"A focal stack needs one image for each slope, in up to 4 channels, got "
            f"shape {stack.shape} and {len(numbers)} slopes."
        )
    if stack.nbytes > 2**32 - 2**20:  # ImageJ opens classic TIFF, with offsets of 32 bits
        raise InputError(f"A focal stack must stay below 4 GiB, got {stack.nbytes / 2**30:.1f}.")
    axes = "ZYX"
    if stack.ndim == 4:  # ImageJ has no float colour: each channel is a separate page
        stack, axes = np.moveaxis(stack, 3, 1), "ZCYX"
    channels = stack.shape[1] if stack.ndim == 4 else 1
    metadata = {
        "axes": axes,
        "slopes": json.dumps(numbers),
        "Labels": [f"slope {slope:g}" for slope in numbers for _ in range(channels)],
    }
    with atomic_write(path) as aside:
        tifffile.imwrite(aside, stack, imagej=True, photometric="minisblack", metadata=metadata)


def read_focal_stack(path: str | Path) -> tuple[np.ndarray, np.ndarray | None]:
    """Read a focal stack, with the slopes that `write_focal_stack` stored, if any.

    Returns
    -------
    stack : ndarray of float32, shape (n, t, s) or (n, t, s, channels)
        Unsigned levels of 8 or 16 bits are scaled to 0 to 1, floats stay as they are.
    slopes : ndarray of float64, shape (n,), or None

    Raises
    ------
    InputError
        If the file cannot be read, or its pages have more than one axis.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.formats import read_focal_stack, write_focal_stack
    >>> write_focal_stack(np.ones((2, 20, 30), np.float32), [0.0, 1.0], "stack.tif")
    >>> read_focal_stack("stack.tif")[0].shape
    (2, 20, 30)
    """
    pages, letters, stated = _read(path)
    pages = pages if letters else pages[None]
    if len(letters) > 1:
        raise InputError(
            f"A focal stack has its images in one row, got shape {pages.shape} in {path}."
        )
    if stated is None:
        return pages, None
    described = parse_json(str(stated), path)
    slopes = np.array(build(list[float], described, f"{path}: slopes"))
    if slopes.shape != (len(pages),):
        raise InputError(f"{path} has {len(pages)} images, but slopes of shape {slopes.shape}.")
    return pages, slopes


def _read(path: str | Path) -> tuple[np.ndarray, str, Any]:
    """Pages, letters of their page axes, and slopes that the file states."""
    pixels, letters, metadata = read_tiff(path, opaque=True)
    return to_unit(pixels, path), letters, metadata.get("slopes")
