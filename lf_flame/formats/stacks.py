"""Multi-page TIFF files: views of a light field, and refocused images with their slopes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import ArrayLike

from lf_flame._common.atomic_files import atomic_write
from lf_flame._common.config import build_record
from lf_flame._common.images import open_tiff, pictures, read_pages, to_unit, transparency
from lf_flame._common.input_files import parse_json
from lf_flame._common.memory import check_memory
from lf_flame.errors import InputError
from lf_flame.formats.view_files.orders import (
    Grid,
    arranged_light_field,
    as_grid,
    check_order,
)
from lf_flame.formats.view_files.parallax_order import FoundOrder, find_order, order_memory
from lf_flame.formats.view_files.running_numbers import fold
from lf_flame.lightfield import LightField

MOST_CHANNELS = 4
"""Largest size of an axis C that may hold colours instead of pages."""

COLOURS = 3
"""Size of an axis C that holds the colours of a single image."""

UNNAMED = frozenset("QI")
"""Letters of page axes without a stated meaning, which may be rows and columns of views."""

LARGEST_IMAGEJ_BYTES = 2**32 - 2**20
"""Largest size in bytes that ImageJ opens: classic TIFF, with offsets of 32 bits."""


def is_stack(path: str | Path) -> bool:
    """Whether a TIFF file holds more than one image; one in three channels is a colour image.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    with open_tiff(path) as file:
        alike = pictures(file, path)
        lengths = alike[0].get_shape(squeeze=False)
        sizes = dict(zip(alike[0].get_axes(squeeze=False), lengths, strict=True))
    colours = "C" if sizes.get("C") == COLOURS and sizes.get("S", 1) == 1 else ""
    pages = set(sizes) - set("YXS" + colours)
    return len(alike) > 1 or any(sizes[axis] > 1 for axis in pages)


def read_view_stack(
    path: str | Path, order: str | None = None, *, grid: Grid | str | None = None
) -> LightField:
    """Read the pages of a TIFF file as views.

    Parameters
    ----------
    path : str or Path
        TIFF file. Its pages form rows and columns if the file states two page axes that are not
        times or depths; otherwise a running number, which is a square if the parallax shows one.
    order : str, optional
        Meaning of the page numbers, as in `lf_flame.formats.scan_view_folder`: ``row,col`` is row
        by row. Default: the order that the parallax shows.
    grid : (int, int) or str, optional
        Number of rows and columns of views, such as (1, 9) or ``1x9``.

    Returns
    -------
    LightField
        Views; unsigned levels of 8 or 16 bits are scaled to 0 to 1, floats stay as they are.

    Raises
    ------
    InputError
        If the file cannot be read, its pages show no square of views and no grid is stated, or
        it is a focal stack.

    Examples
    --------
    >>> import numpy as np
    >>> import tifffile
    >>> from lf_flame.formats import read_view_stack
    >>> tifffile.imwrite("pages.tif", np.random.default_rng(1).uniform(size=(9, 20, 30)))
    >>> read_view_stack("pages.tif", grid=(3, 3))
    LightField(3 x 3 views of 20 x 30 pixels, grey)
    """
    lines, found = read_view_lines(path, order, grid)
    return arranged_light_field(lines, found.order)


def read_view_lines(
    path: str | Path, order: str | None, grid: Grid | str | None
) -> tuple[LightField, FoundOrder]:
    """Read the pages of a TIFF file as views in the order of the pages, and find their order.

    Arguments and errors are those of `read_view_stack`.
    """
    pages, image_axes, metadata, letters = _read(path)
    if "slopes" in metadata:
        raise InputError(f"{path} is a stack of refocused images, not of views.")
    shape, image = as_grid(grid), pages.shape[-image_axes:]
    check_memory(2 * pages.nbytes + order_memory(image), path)
    if shape is None and len(letters) == 2 and set(letters) <= UNNAMED:
        found = find_order(pages) if order is None else FoundOrder(check_order(order), "as stated")
        return LightField(pages), found
    lines, found = fold(pages.reshape(-1, *image), path, shape, order)
    return LightField(lines), found


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
    if (
        stack.ndim not in (3, 4)
        or stack.size == 0
        or len(stack) != len(numbers)
        or stack.shape[3:] > (MOST_CHANNELS,)
    ):
        raise InputError(
            f"A focal stack needs one image for each slope, in up to {MOST_CHANNELS} channels, got "
            f"shape {stack.shape} and {len(numbers)} slopes."
        )
    if stack.nbytes > LARGEST_IMAGEJ_BYTES:
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
    pages, image_axes, metadata, _ = _read(path)
    if pages.ndim == image_axes:
        pages = pages[None]
    if pages.ndim != image_axes + 1:
        raise InputError(
            f"A focal stack has its images in one row, got shape {pages.shape} in {path}."
        )
    if "slopes" not in metadata:
        return pages, None
    described = parse_json(str(metadata["slopes"]), path)
    slopes = np.array(build_record(list[float], described, f"{path}: slopes"))
    if slopes.shape != (len(pages),):
        raise InputError(f"{path} has {len(pages)} images, but slopes of shape {slopes.shape}.")
    return pages, slopes


def _read(path: str | Path) -> tuple[np.ndarray, int, dict, str]:
    """Read the pages, with their channels last.

    Returns the pages, the number of axes of one image, ImageJ's description, and the letters of
    the page axes.
    """
    with open_tiff(path) as file:
        metadata = file.imagej_metadata or {}
        alike = pictures(file, path)
        transparent = transparency(alike[0].keyframe)
        pages, axes = read_pages(alike, path)
    channels = _channel_axis(axes, pages.shape, "slopes" in metadata)
    image = [axes.index("Y"), axes.index("X")] + ([] if channels is None else [channels])
    counted = [k for k in range(pages.ndim) if k not in image]
    several = [k for k in counted if pages.shape[k] > 1]
    shape = [pages.shape[k] for k in several + image]
    levels = pages.transpose(counted + image).reshape(shape)
    if channels is not None and transparent:
        levels = levels[..., :-1]
    letters = "".join(axes[k] for k in several)
    return to_unit(levels, path), len(image), metadata, letters


def _channel_axis(axes: str, shape: tuple[int, ...], focal: bool) -> int | None:
    """Index of the colour axis by tifffile's letters: samples, or few channels beside pages."""
    sizes = dict(zip(axes, shape, strict=True))
    image = sizes["Y"] * sizes["X"]
    if sizes.get("S", 1) > 1:
        return axes.index("S")
    channels = sizes.get("C", 1)
    if 1 < channels <= MOST_CHANNELS and (focal or np.prod(shape) > channels * image):
        return axes.index("C")
    return None
