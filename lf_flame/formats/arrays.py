"""Files with all views in one array of pixels: its axes, and further content of the file."""

from contextlib import suppress
from math import gcd, isqrt
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lf_flame._common.arrays_in_files import ArrayFile, FileOfArrays
from lf_flame._common.images import FLOAT, read_tiff
from lf_flame._common.input_files import parse_json
from lf_flame.errors import InputError
from lf_flame.formats.array_files import Hdf5File, MatlabFile, is_matlab_hdf5
from lf_flame.formats.images import read_image
from lf_flame.formats.raw.lenslet_grid import grid_from_pitch
from lf_flame.formats.raw.sensor_images import check_colours
from lf_flame.formats.view_files.orders import Grid, read_grid
from lf_flame.lightfield import LightField

ARRAY_SUFFIXES = (".npy", ".npz", ".h5", ".hdf5", ".mat")
"""File endings of arrays."""

VIEWS, TOOLBOX, RECORD = "views", "LF", "record"
"""Names of views in files of this package, and in those of HCI and LFToolbox; and of the record in
a ``.npz`` file, JSON in bytes."""


class Pixels(NamedTuple):
    """Pixels of all views as a file stores them, and their axes as in `read_light_field`.

    `searched` says that the parallax shows the order of views.
    """

    values: np.ndarray
    axes: str
    weights: np.ndarray | None = None
    valid: np.ndarray | None = None
    searched: bool = False


def cut_views(raw: np.ndarray, views: int | None, source: str | Path) -> np.ndarray:
    """Cut a raw lenslet array into views; if `views` does not fit, the error says what would."""
    if views is None or views < 1 or any(n % views for n in raw.shape[:2]):
        common = gcd(*raw.shape[:2])
        fit = [str(n) for n in range(2, common + 1) if common % n == 0][:12]
        raise InputError(
            f"To read {source} as a lenslet image, state the number of pixels under a lenslet "
            f"(views), as in the camera's data sheet, which divides its {raw.shape[0]} x "
            f"{raw.shape[1]} pixels ({', '.join(fit) or 'only 1 does'}), got {views}; to decode a "
            f"raw image, give a white image, the lenslets or the pitch; `lf-flame convert` reads "
            f"focused lenslets, such as those of Raytrix (--focused), and mosaics (--mosaic)."
        )
    if raw.ndim == 2 and views >= 5:  # with fewer pixels under a lenslet, views look like colours
        check_colours(raw, grid_from_pitch(raw.shape, views), "lenslet")
    return LightField.from_raw(raw, views=views).views


# Images -------------------------------------------------------------------------------------------


def read_lenslets(path: str | Path) -> Pixels:
    """Read a rectified lenslet image (ESLF of the Lytro cameras), N x N pixels per lenslet."""
    image = read_image(path)
    return Pixels(image, "tsc"[: image.ndim])


def read_mosaic(path: str | Path, *, mosaic: Grid | str) -> Pixels:
    """Read a picture that contains rows and columns of whole views.

    In a lenslet image, pixels of one lenslet are neighbours; here, pixels of one view.
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
    return Pixels(picture.reshape(size), "vtusc"[: len(size)], searched=True)


def read_pages(path: str | Path) -> Pixels:
    """Read the pages of a TIFF file: rows and columns if it has two page axes, or a number."""
    pages, letters, metadata = read_tiff(path, opaque=True)
    if "slopes" in metadata:
        raise InputError(f"{path} is a stack of refocused images, not of views.")
    if len(letters) == 2:
        return Pixels(pages, "vutsc"[: pages.ndim], searched=True)
    row = pages.reshape(-1, *pages.shape[len(letters) :])
    return Pixels(row, "ntsc"[: row.ndim])


# Arrays -------------------------------------------------------------------------------------------


def read_array(path: str | Path, *, axes: str | None = None, array: str | None = None) -> Pixels:
    """Read an array of pixels from a NumPy, HDF5 or MATLAB file.

    The array is the one named ``views`` or ``LF``, or the only one. Arrays of MATLAB have the axes
    that MATLAB shows. In NumPy files arrays ``weights`` and ``valid`` are those of the light field.
    An array ``LF`` of four channels in a ``.mat`` file is one of LFToolbox, whose last channel is a
    weight.
    """
    file = _open(path)
    name = _choose_array(file, array)
    stored = file.header(name).dtype.itemsize
    # As stored, as floats, and once more after the axes are reordered.
    (held,) = file.read([name], copies=1 + (1 + (stored < FLOAT)) * FLOAT / stored)
    beside = set(file.names) - {name} if isinstance(file, ArrayFile) else set()
    weights, valid = (file.read([x])[0] if x in beside else None for x in ("weights", "valid"))
    if name == TOOLBOX and axes is None and Path(path).suffix.lower() == ".mat":
        held, weights, valid = _without_weight(held)
    if axes is None and name == VIEWS and held.ndim > 3 and record_of(Path(path)):
        axes = "vutsc"[: held.ndim]  # as `write_light_field` writes them
    axes = _default_axes(held.shape, path) if axes is None else axes.lower()
    return Pixels(held, axes, weights, valid)


def _open(path: str | Path) -> FileOfArrays:
    """Open a file of arrays by its ending, and one of MATLAB by its content."""
    suffix = Path(path).suffix.lower()
    if suffix in (".h5", ".hdf5") or (suffix == ".mat" and is_matlab_hdf5(path)):
        return Hdf5File(path)
    return MatlabFile(path) if suffix == ".mat" else ArrayFile(path)


def record_of(path: Path) -> dict[str, Any]:
    """Record in a file of `write_light_field`; empty without one that can be read."""
    record = None
    with suppress(InputError):  # the views are of use without it
        if path.suffix.lower() == ".npz" and RECORD in (file := ArrayFile(path)).names:
            record = parse_json(file.read([RECORD])[0].tobytes().decode("utf-8", "replace"), path)
    return record if isinstance(record, dict) else {}


def _choose_array(file: FileOfArrays, stated: str | None) -> str:
    """Choose the array that contains the views, by its name unless it is the only one."""
    for name in (VIEWS, TOOLBOX) if stated is None else (stated,):
        if name in file.names:
            return name
    shapes = {}
    for name in file.names:
        with suppress(InputError):  # texts and objects are no views
            shapes[name] = file.header(name).shape
    if stated is None and len(shapes) == 1:
        return next(iter(shapes))
    held = [f"{name} {shape}" for name, shape in list(shapes.items())[:5]] or ["none"]
    raise InputError(
        f"{file.path} must contain an array of numbers named {stated or VIEWS}, got "
        f"{', '.join(held)}{' ...' if len(shapes) > 5 else ''}; name one by `lf-flame convert "
        f"--array` (in Python array=...)."
    )


def _without_weight(array: np.ndarray) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
    """Split an array of LFToolbox, three colours and a weight: views, their weights, known pixels.

    The weight is the white image, by which LFToolbox divided: inverse to the variance of noise.
    Views get the mean of theirs; a pixel of weight 0 in a view of another weight is unknown.
    """
    if array.ndim != 5 or array.shape[4] != 4:
        return array, None, None
    weights = array[..., 3].mean(axis=(2, 3), dtype=np.float64)
    weights /= max(weights.max(), np.finfo(float).tiny)
    valid = (array[..., 3] > 0) | (weights == 0)[..., None, None]
    return array[..., :3], weights, valid


def _default_axes(shape: tuple[int, ...], path: str | Path) -> str:
    """Axes of an array for which none are stated; refuse a shape that is unlikely for them.

    Likely are fewer views than pixels, and at most four channels; a square number of views next to
    3 or 4 others is a running number next to colours.
    """
    axes = {2: "ts", 3: "tsc", 4: "vuts", 5: "vutsc"}.get(len(shape))  # without views: a raw array
    if axes is None or 0 in shape:
        raise InputError(
            f"{path} must contain views[v, u, t, s] (with a last axis of channels or without), or "
            f"a raw lenslet array, got shape {shape}."
        )
    size = dict(zip(axes, shape, strict=True))
    few, many = sorted((size.get("v", 1), size.get("u", 1)))
    is_coloured = few in (3, 4) and many >= 25 and isqrt(many) ** 2 == many
    is_many = few * many >= max(2, size["t"] * size["s"])
    is_pictures = len(shape) == 4 and shape[3] in (3, 4) and shape[1] > 4  # n, t, s, colours
    if is_coloured or is_many or is_pictures or size.get("c", 1) > 4:
        raise InputError(
            f"{path} contains an array of shape {shape}, which is unlikely to be {axes}: state its "
            f"axes with `lf-flame convert --axes` (v, u or a running n: views; t, s: rows and "
            f"columns of pixels; c: channels)."
        )
    return axes
