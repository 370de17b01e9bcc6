"""One function for reading all kinds of light-field files."""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lf_flame._common.images import TIFF_SUFFIXES
from lf_flame.errors import InputError
from lf_flame.formats.arrays import ARRAY_SUFFIXES, HDF5_SUFFIXES, read_stored_array
from lf_flame.formats.hci_files import find_hci_order, is_hci
from lf_flame.formats.images import IMAGE_SUFFIXES
from lf_flame.formats.lenslet_image import read_lenslet_image
from lf_flame.formats.lytro.decoding import is_lytro, plan_lytro
from lf_flame.formats.lytro.picture import LYTRO_SUFFIXES
from lf_flame.formats.stacks import is_stack, read_view_lines
from lf_flame.formats.view_files.mosaic import read_view_mosaic
from lf_flame.formats.view_files.orders import Grid, arranged_light_field
from lf_flame.formats.view_files.parallax_order import FoundOrder, find_order
from lf_flame.formats.view_files.scan import scan_view_folder
from lf_flame.formats.view_files.sources import ARCHIVE, LIST, is_view_folder
from lf_flame.lightfield import LightField


def read_light_field(
    path: str | Path,
    views: int | None = None,
    order: str | None = None,
    *,
    grid: Grid | str | None = None,
    axes: str | None = None,
    dark: str | Path | None = None,
    mosaic: Grid | str | None = None,
    array: str | None = None,
) -> LightField:
    """Read a light field from a file or folder of any supported kind.

    ==================================  ==============================================
    a folder, ``.zip``, ``.csv``        `read_view_folder`, one image for each view
    ``.npy``, ``.npz``, ``.h5``,        `read_array`
    ``.hdf5``, ``.mat``
    ``.tif``, ``.tiff`` of many pages   `read_view_stack`
    an image and `mosaic`               `read_view_mosaic`, views side by side
    ``.lfp``, ``.lfr``, ``.raw``        `read_raw`, a raw picture of a Lytro camera
    any other image                     `read_lenslet_image`, N x N pixels to a lenslet
    ==================================  ==============================================

    Parameters
    ----------
    path : str or Path
    views : int, optional
        Number of pixels under a lenslet along each axis, for a lenslet image or a raw array.
    order : str, optional
        Meaning of the numbers of views, such as ``row,-col``; see `scan_view_folder`. Default: for
        folders, pages, arrays with an axis n, mosaics and HDF5 files of the HCI data set, the order
        that the parallax between views shows; otherwise the stored order.
    grid : (int, int) or str, optional
        Number of rows and columns of a light field whose views are numbered one by one, in any
        order, such as (1, 9) or ``1x9``: in a folder, pages or an array with an axis n. Default:
        a square, if the parallax shows one.
    axes : str, optional
        Meaning of an array's axes, as in `read_array`. Default: ``vuts`` or ``vutsc``.
    dark : str or Path, optional
        Light field without light, of the same form and size, which is subtracted.
    mosaic : (int, int) or str, optional
        Number of rows and columns of views that lie side by side in one image, as (8, 8) or
        ``8x8``.
    array : str, optional
        Name of the array with the views, in a file of several.

    Returns
    -------
    LightField

    Raises
    ------
    InputError
        If the path does not exist or cannot be read, or an argument does not fit.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import LightField, formats
    >>> light_field = LightField(np.random.default_rng(1).uniform(size=(3, 3, 20, 30)))

    >>> np.save("views.npy", light_field.views)
    >>> formats.read_light_field("views.npy")
    LightField(3 x 3 views of 20 x 30 pixels, grey)
    """
    path, stated = Path(path), Stated(views, order, grid, axes, mosaic, array)
    if path.exists() and not is_lytro(path) and is_view_folder(path):
        return _read_folder(path, dark, stated)
    return read_ordered(path, dark, stated)[0]


class Stated(NamedTuple):
    """Arguments of `read_light_field` on the form of a file; None for those left out."""

    views: int | None = None
    order: str | None = None
    grid: Grid | str | None = None
    axes: str | None = None
    mosaic: Grid | str | None = None
    array: str | None = None

    def refuse(self, path: Path, *names: str) -> None:
        """Refuse the named arguments, which fit light fields of another form."""
        for name in names:
            if getattr(self, name) is not None:
                raise InputError(f"{MEANT_FOR[name]}, not in {path}.")


def read_ordered(
    path: str | Path, dark: str | Path | None, stated: Stated
) -> tuple[LightField, FoundOrder | None]:
    """Read a light field from one file, and the order of its views if the parallax shows it.

    Arguments and errors are those of `read_light_field`.

    Returns
    -------
    LightField
    FoundOrder or None
        Order that was found; None where it was stated, or the views are used as stored.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"There is no light field {path}: no such file or folder.")
    if is_lytro(path):
        return _read_lytro(path, dark, stated), None
    stored, found = _read_stored(path, stated)
    numbered = found is not None
    if stated.order is None and found is None:
        found = _find_order(path, stored, stated)
    order = stated.order if found is None else found.order
    light_field = arranged_light_field(stored, order)
    if dark is not None:
        # A dark image has no parallax that would show its grid and order.
        counted = light_field.views.shape[:2] if numbered else stated.grid
        of_dark = stated._replace(order=order or "row,col", grid=counted)
        light_field = subtract_dark(light_field, dark, of_dark)
    return light_field, None if stated.order is not None else found


MEANT_FOR = {
    "axes": f"axes are those of an array ({', '.join(ARRAY_SUFFIXES)})",
    "array": f"array names one of several in a file ({', '.join(ARRAY_SUFFIXES)})",
    "mosaic": f"mosaic counts views side by side in an image ({', '.join(IMAGE_SUFFIXES)})",
    "grid": "grid counts views in a folder, pages or an array",
}
"""Purpose of each argument that fits some files only, for messages."""


def _read_lytro(path: Path, dark: str | Path | None, stated: Stated) -> LightField:
    stated.refuse(path, "axes", "array", "mosaic")
    if stated.order is not None or stated.grid is not None:
        raise InputError(f"order and grid do not apply to the Lytro picture {path}.")
    plan, image = plan_lytro(path, None, stated.views, dark=dark)
    return plan.decode(image)


def _read_folder(path: Path, dark: str | Path | None, stated: Stated) -> LightField:
    stated.refuse(path, "axes", "array", "mosaic")
    folder = scan_view_folder(path, stated.order, grid=stated.grid)
    # A dark image has no parallax from which its order could be found.
    found = Stated(order=folder.found.order, grid=folder.counted)
    return subtract_dark(folder.read(), dark, found)


def _read_stored(path: Path, stated: Stated) -> tuple[LightField, FoundOrder | None]:
    """Read an array, pages, a mosaic or a lenslet image, with the views in the order stored.

    The second result is the order of views with a running number.
    """
    suffix = path.suffix.lower()
    views, grid, mosaic = stated.views, stated.grid, stated.mosaic
    if suffix in ARRAY_SUFFIXES:
        stated.refuse(path, "mosaic")
        return read_stored_array(
            path, views, axes=stated.axes, grid=grid, array=stated.array, order=stated.order
        )
    stated.refuse(path, "axes", "array")
    if mosaic is not None and suffix in IMAGE_SUFFIXES:
        stated.refuse(path, "grid")
        return read_view_mosaic(path, mosaic), None
    stated.refuse(path, "mosaic")
    if suffix in TIFF_SUFFIXES and (grid is not None or is_stack(path)):
        return read_view_lines(path, stated.order, grid)
    stated.refuse(path, "grid")
    if suffix in IMAGE_SUFFIXES:
        return read_lenslet_image(path, views), None
    raise InputError(
        f"{path} is no light field: it must be a folder of views (or {ARCHIVE} of one, or {LIST}), "
        f"an array ({', '.join(ARRAY_SUFFIXES)}), an image ({', '.join(IMAGE_SUFFIXES)}) or a "
        f"Lytro picture ({', '.join(LYTRO_SUFFIXES)})."
    )


def _find_order(path: Path, stored: LightField, stated: Stated) -> FoundOrder | None:
    """Order of the views as the parallax shows it; None if they are used as stored."""
    if stated.mosaic is not None:
        return find_order(stored.views)
    if stated.axes is None and path.suffix.lower() in HDF5_SUFFIXES and is_hci(path):
        return find_hci_order(path, stored.views)
    return None


def note_on_order(light_field: LightField, path: Path) -> str:
    """Say where the parallax contradicts the order in which a file holds its views, or nothing.

    Parameters
    ----------
    light_field : LightField
        Views as stored, which no order was stated or found for.
    path : Path
        File that they were read from.
    """
    if is_lytro(path):
        return ""  # the views were made here
    found = find_order(light_field.views)
    if found.order == "row,col":
        return ""
    return (
        f"The views of {path} do not move as those of rows and columns [v, u, t, s]: "
        f"{found.reason}, they are stored as {found.order}. Slopes are wrong unless "
        f"--order={found.order}, or other --axes of an array, says so"
    )


def subtract_dark(light_field: LightField, dark: str | Path | None, stated: Stated) -> LightField:
    """Subtract a light field without light, read from a file or folder of the same form.

    Parameters
    ----------
    light_field : LightField
    dark : str or Path or None
        Light field without light; None subtracts nothing.
    stated : Stated
        As for `read_light_field`; order and grid are those found for the light field itself.

    Returns
    -------
    LightField
        A view that is missing in either has weight 0, and a pixel unknown in either is unknown.

    Raises
    ------
    InputError
        If the dark light field cannot be read, or its shape differs.
    """
    if dark is None:
        return light_field
    black = read_light_field(dark, **stated._asdict())
    if black.views.shape != light_field.views.shape:
        raise InputError(
            f"The dark light field {dark} must have the light field's shape "
            f"{light_field.views.shape}, got {black.views.shape}."
        )
    weights = [one.weights for one in (light_field, black) if one.weights is not None]
    valid = [one.valid for one in (light_field, black) if one.valid is not None]
    return replace(
        light_field,
        views=light_field.views - black.views,
        weights=np.prod(weights, axis=0) if weights else None,
        valid=np.all(valid, axis=0) if valid else None,
    )
