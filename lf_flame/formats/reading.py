"""One function for reading all kinds of light-field files."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from lf_flame._common.images import TIFF_SUFFIXES, to_unit
from lf_flame.errors import InputError
from lf_flame.formats.arrays import (
    ARRAY_SUFFIXES,
    Pixels,
    cut_views,
    read_array,
    read_lenslets,
    read_mosaic,
    read_pages,
    record_of,
)
from lf_flame.formats.focused.views import plan_focused
from lf_flame.formats.images import (
    CODED,
    IMAGE_SUFFIXES,
    LYTRO_SUFFIXES,
    is_lytro,
    is_stack,
    note_on_coding,
)
from lf_flame.formats.raw.reading import plan_raw, read_frame
from lf_flame.formats.view_files.folder import scan_view_folder
from lf_flame.formats.view_files.orders import (
    AS_STORED,
    Grid,
    ViewOrder,
    arranged,
    check_grid,
    find_order,
    fold,
    read_grid,
    stated_order,
)
from lf_flame.lightfield import LightField


def read_light_field(
    path: str | Path,
    views: int | None = None,
    order: str | None = None,
    *,
    grid: Grid | str | None = None,
    names: str | None = None,
    axes: str | None = None,
    array: str | None = None,
    mosaic: Grid | str | None = None,
    white: str | Path | None = None,
    lenslets: str | Path | None = None,
    dark: str | Path | None = None,
    pitch: float | None = None,
    layout: str | None = None,
    bayer: str | None = None,
    focused: str | Path | None = None,
    virtual_depth: float | None = None,
) -> LightField:
    """Read a light field from a file or folder of any supported kind.

    ====================================  ===================================================
    a folder                              one image for each view: `scan_view_folder`
    ``.npy``, ``.npz``, ``.h5``,          an array of views, or a raw array
    ``.hdf5``, ``.mat``
    ``.tif``, ``.tiff`` of many pages     one view per page
    an image and `mosaic`                 views side by side
    an image and `white`, `lenslets` or   a raw lenslet image: `read_raw`
    `pitch`; ``.lfp``, ``.lfr``
    an image and `focused`                raw image of focused lenslets (Raytrix)
    any other image and `views`           a lenslet image, N x N pixels per lenslet
    ====================================  ===================================================

    Parameters
    ----------
    path : str or Path
    views : int, optional
        Number of pixels under a lenslet along each axis, for a lenslet image or a raw array; number
        of views to decode, for a raw image.
    order : str, optional
        Meaning of the two numbers of views, such as ``row,-col``; see `scan_view_folder`. Default:
        for folders, pages, arrays with an axis n, and mosaics, the order that the parallax between
        views shows; otherwise the stored order.
    grid : (int, int) or str, optional
        Number of rows and columns of views that are numbered one by one, or of which some are
        missing, such as (1, 9) or ``9x9``: in a folder, pages or an array with an axis n. Default:
        a square.
    names : str, optional
        Pattern of the views' names, as in `scan_view_folder`.
    axes : str, optional
        Meaning of an array's axes, one letter each: v and u, row and column of the view, or n, its
        running number; t and s, row and column of the pixel; c, the channel. Default: ``vuts``,
        ``vutsc``, or a raw array; an array of unlikely shape for these is refused.
    array : str, optional
        Name of the array with the views, in a file of several. Default: ``views`` or ``LF``.
    mosaic : (int, int) or str, optional
        Number of rows and columns of views that lie side by side in one image, as ``8x8``.
    white, lenslets, pitch, layout, bayer : optional
        White image (flat field), image of the lenslets' centres, pitch in pixels, layout and
        mosaic of a raw image, as in `read_raw`.
    dark : str or Path, optional
        Light field without light, of the same form and size, which is subtracted.
    focused : str or Path, optional
        Calibration of a Raytrix camera (``.xml``); or a white image of any camera with focused
        lenslets, in which the micro-images are found, and which is also `white` if none is given.
        The picture becomes 5 x 5 `views`, or 1 in which everything is sharp.
    virtual_depth : float, optional
        Virtual depth of all focused lenslets, and at which views coincide: a plane. Default: found
        for each lenslet by the displacement between micro-images; views coincide at 3, or at -3 if
        most depths are negative.

    Returns
    -------
    LightField
        Values from 0 to 1 where they are stored as levels of 8 or 16 bits; floats as they are.
        Missing views have weight 0.

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
    options = locals()
    return find_light_field(options.pop("path"), **options).light_field


@dataclass(frozen=True)
class Found:
    """A light field that was read, and how.

    `order` is that in which the views are stored. `notes` are sentences for the user. `again` reads
    another file of the same kind by what was found in this one: lenslets, and order of views.
    `coded` notes that the (first) image is probably gamma-coded, if it is.
    """

    light_field: LightField
    order: ViewOrder
    notes: list[str]
    again: Callable[[Path], LightField]
    coded: str = ""

    def doubts(self, path: Path) -> list[str]:
        """Sentences on what is excluded or unknown, and on an order that parallax contradicts."""
        notes = [self.light_field.excluded, self.light_field.unknown]
        seen = find_order(self.light_field.views) if self.order is AS_STORED else self.order
        if self.order is AS_STORED and seen.order != AS_STORED.order:
            notes.append(
                f"The views of {path} do not move like rows and columns [v, u, t, s]: "
                f"{seen.reason}, they are stored as {seen.order}. Slopes are wrong unless "
                f"--order={seen.order}, or other --axes of an array, says so"
            )
        return list(filter(None, notes))


def find_light_field(path: str | Path, **options: Any) -> Found:
    """Read a light field; arguments and errors are those of `read_light_field`."""
    path, options = Path(path), {name: x for name, x in options.items() if x is not None}
    kind, read, takes = kind_of(path, options)
    for name in options:
        if name not in takes.split():
            raise InputError(
                f"--{name.replace('_', '-')} does not apply to {path}, which is read as {kind}."
            )
    dark = None if read in (_read_raw, _read_focused) else options.pop("dark", None)
    found = read(path, **options)
    if record_of(path).get("linear") is False:
        found = replace(
            found, coded=f"{path} was made of images that are probably gamma-coded. {CODED}"
        )
    elif not path.is_dir():
        found = replace(found, coded=note_on_coding(path))
    if dark is None:
        return found
    black = found.again(Path(dark))  # without light there is no parallax that shows its order
    return replace(
        found,
        light_field=_subtract(found.light_field, black, dark),
        again=lambda other: _subtract(found.again(other), black, dark),
    )


def kind_of(path: Path, options: dict[str, Any]) -> tuple[str, Callable[..., Found], str]:
    """Name of the kind of a file, its reader, and the options that apply to it."""
    if not path.exists():
        raise InputError(f"There is no light field {path}: no such file or folder.")
    suffix = path.suffix.lower()
    if is_lytro(path):
        return "a raw picture of a Lytro camera", _read_raw, "white lenslets views dark"
    if path.is_dir():
        return "a folder of views", _read_folder, "order grid names dark"
    if suffix in ARRAY_SUFFIXES:
        return "an array", partial(_read_pixels, read_array), "axes array views order grid dark"
    if suffix not in IMAGE_SUFFIXES:
        raise InputError(
            f"{path} is not a light field: it must be a folder of views (unpacked), an "
            f"array ({', '.join(ARRAY_SUFFIXES)}), an image ({', '.join(IMAGE_SUFFIXES)}) or a "
            f"Lytro picture ({', '.join(LYTRO_SUFFIXES)})."
        )
    if "focused" in options:
        takes = "focused virtual_depth views white bayer dark"
        return "a raw image of focused lenslets", _read_focused, takes
    if {"white", "lenslets", "pitch"} & set(options):
        return "a raw image", _read_raw, "white lenslets pitch layout bayer views dark"
    if "mosaic" in options:
        return "a mosaic of views", partial(_read_pixels, read_mosaic), "mosaic order dark"
    if suffix in TIFF_SUFFIXES and ("grid" in options or is_stack(path)):
        return "pages of views", partial(_read_pixels, read_pages), "order grid dark"
    kind = "a lenslet image, as there is neither a white image, lenslets nor a pitch"
    return kind, partial(_read_pixels, read_lenslets), "views order dark"


AS_DECODED = ViewOrder("row,col", "as decoded")


def _read_raw(path: Path, **options: Any) -> Found:
    plan, image = plan_raw(path, **options)
    notes = [f"{path}: {plan.grid.describe()}"]
    if plan.grid.layout == "hexagonal":
        notes.append('A camera file for this array must state layout = "hexagonal"')
    elif abs(plan.grid.row_pitch / plan.grid.pitch - 1) > 0.01:
        notes.append("Row and column pitch differ: lengths in mm are right along the rows only")
    if "pitch" in options and {"white", "lenslets"}.isdisjoint(options):
        notes.append("The rotation and the position of the array were not searched for (--white)")
    if not is_lytro(path) and "dark" not in options:
        notes.append("Black is taken as level 0, as no dark image is given (--dark)")
    return Found(plan.decode(image), AS_DECODED, notes, lambda one: plan.decode(read_frame(one)))


def _read_focused(path: Path, **options: Any) -> Found:
    plan, image = plan_focused(path, **options)
    light_field = plan.decode(image)
    notes = [f"{path}: {plan.lenslets.describe()}", *filter(None, [plan.found])]
    return Found(light_field, AS_DECODED, notes, lambda one: plan.decode(read_frame(one)))


def _read_folder(path: Path, **options: Any) -> Found:
    folder = scan_view_folder(path, **options)
    same = options | {"order": folder.found.order, "grid": folder.files.shape}
    return Found(
        folder.read(),
        folder.found,
        folder.describe().splitlines(),
        lambda one: scan_view_folder(one, **same).read(),
        note_on_coding(next(file for file in folder.files.flat if file is not None)),
    )


def _read_pixels(
    read: Callable[..., Pixels], path: Path, *, views=None, grid=None, order=None, **options: Any
) -> Found:
    """Read a file with all views in one array of pixels, which `read` returns as stored."""
    grid = None if grid is None else read_grid(grid)
    pixels = read(path, **options)
    axes = pixels.axes
    of_views = "n" if "n" in axes else "vu" if set(axes) & set("vu") else ""
    wanted = of_views + "ts" + ("c" if "c" in axes else "")
    if sorted(axes) != sorted(wanted) or len(axes) != pixels.values.ndim:
        raise InputError(
            f"axes must be one letter for each axis of {path}, whose shape is "
            f"{pixels.values.shape}: v and u or n for views (none in a raw array), t and s for "
            f"pixels, c for channels, got {axes!r}."
        )
    stored = to_unit(pixels.values, path).transpose([axes.index(letter) for letter in wanted])
    stored = stored[..., 0] if "c" in axes and stored.shape[-1] == 1 else stored  # grey
    if of_views == "n":
        stored, found = fold(stored, path, grid, order)
    else:
        stored = stored if of_views else cut_views(stored, views, path)
        is_searched = order is None and pixels.searched
        found = find_order(stored) if is_searched else stated_order(order)
    beside = {"weights": pixels.weights, "valid": pixels.valid}
    given = {k: arranged(np.atleast_2d(x), found.order) for k, x in beside.items() if x is not None}
    light_field = LightField(arranged(stored, found.order), **given)
    check_grid(grid, light_field.shape[:2], path)
    # Any picture is read as 1 view, and so is an array of one.
    if views not in (None, 1) and light_field.shape[:2] != (views, views):
        v, u = light_field.shape[:2]
        raise InputError(
            f"{path} contains {v} x {u} views, but --views (or else the camera) states {views}."
        )
    same = options | {"views": views, "grid": grid, "order": found.order}
    notes = found.describe() if light_field.shape[:2] != (1, 1) else []
    return Found(light_field, found, notes, lambda one: _read_pixels(read, one, **same).light_field)


def _subtract(light_field: LightField, black: LightField, dark: object) -> LightField:
    """Subtract a light field without light; pixels missing or unknown in either stay so."""
    if black.views.shape != light_field.views.shape:
        raise InputError(
            f"The dark light field {dark} must have the light field's shape "
            f"{light_field.views.shape}, got {black.views.shape}."
        )
    views = light_field.views - black.views
    if views.max() < 0:
        raise InputError(f"{dark} is brighter than all of the light field: in other units?")
    both = {
        name: np.prod(some, axis=0, dtype=some[0].dtype)
        for name in ("weights", "valid")
        if (some := [x for one in (light_field, black) if (x := getattr(one, name)) is not None])
    }
    return replace(light_field, views=views, **both)
