"""Facts of files: what a file is, what is missing to read it, and which command comes next.

As in `lf_flame.commands.cli`, heavy modules are imported inside.
"""

from pathlib import Path
from typing import TYPE_CHECKING

from lf_flame.commands.findings import Found, typed
from lf_flame.commands.lytro_facts import lytro_picture, lytro_white_files
from lf_flame.errors import InputError

if TYPE_CHECKING:
    import numpy as np

MIDDLE = 512
"""Side in pixels of the central part of an image in which lenslets are looked for."""

MOST_NAMED = 5
"""Largest number of files of a folder that are named."""


def describe(source: Path) -> Found:
    """Find out what a file or folder is.

    Raises
    ------
    InputError
        If it is nothing that the package knows, or cannot be read.
    """
    from lf_flame.formats.focused.raytrix import is_raytrix
    from lf_flame.formats.images import IMAGE_SUFFIXES
    from lf_flame.formats.lytro.decoding import is_lytro
    from lf_flame.formats.lytro.white import holds_white_files
    from lf_flame.formats.view_files.folder import is_view_folder

    if is_lytro(source):
        return lytro_picture(source)
    if source.suffix.lower() == ".tar" or (source.is_dir() and holds_white_files(source)):
        return lytro_white_files(source)
    if is_view_folder(source):
        return _folder(source)
    if is_raytrix(source):
        return _calibration(source)
    if source.suffix.lower() in IMAGE_SUFFIXES:
        return _image(source)
    return _views(source)


def _folder(source: Path) -> Found:
    """Folder, archive or list of views."""
    from lf_flame._common.images import read_shape
    from lf_flame.formats import scan_view_folder
    from lf_flame.formats.coding import notes_on_coding

    try:
        folder = scan_view_folder(source)
    except InputError as error:
        if not source.is_dir():
            raise
        return _other_folder(source, error)
    rows, columns, channels = read_shape(next(file for file in folder.files.flat if file))
    kind = "folder" if source.is_dir() else f"{source.suffix.lower()} file"
    found = Found(f"{kind} with one image for each view")
    v, u = folder.files.shape
    found.shape = (v, u, rows, columns)
    colour = "grey" if channels < 3 else "colour"
    found.facts["views"] = f"{v} x {u}, of {rows} x {columns} pixels, {colour}"
    found.facts["order"] = f"{folder.found.order}, {folder.found.reason}"
    found.notes += folder.found.describe()[1:]
    if folder.missing:
        found.facts["missing"] = f"{len(folder.missing)} views, which have weight 0"
    if folder.left_out:
        found.facts["left out"] = f"{folder.left_out} other files"
    found.notes += notes_on_coding(source)
    found.command = typed("refocus", source)
    return found


def _other_folder(source: Path, error: InputError) -> Found:
    """Folder without views, which may hold single files to be looked at."""
    from lf_flame.formats.arrays import ARRAY_SUFFIXES
    from lf_flame.formats.images import IMAGE_SUFFIXES
    from lf_flame.formats.lytro.picture import LYTRO_SUFFIXES

    known = (*LYTRO_SUFFIXES, *ARRAY_SUFFIXES, *IMAGE_SUFFIXES)
    paths = sorted(path for path in source.iterdir() if path.suffix.lower() in known)
    if not paths:
        raise error
    found = Found("folder of single files")
    more = f" and {len(paths) - MOST_NAMED} more" if len(paths) > MOST_NAMED else ""
    found.facts["files"] = ", ".join(path.name for path in paths[:MOST_NAMED]) + more
    found.notes.append(f"the files are not read as the views of one light field. {error}")
    found.command = typed("info", paths[0])
    return found


def _calibration(source: Path) -> Found:
    """Calibration of a Raytrix camera."""
    from lf_flame.formats import read_raytrix

    lenslets = read_raytrix(source, (1, 1)).describe()
    return Found(
        "calibration of a Raytrix camera",
        {"lenslets": lenslets},
        command=typed("refocus", "RAW.png", "--focused", source),
    )


def _image(source: Path) -> Found:
    """Raw image, lenslet image or stack of pages."""
    from lf_flame.formats import estimate_grid, read_focal_stack
    from lf_flame.formats.images import TIFF_SUFFIXES, read_image
    from lf_flame.formats.raw.checks import refuse_mosaic
    from lf_flame.formats.stacks import is_stack

    if source.suffix.lower() in TIFF_SUFFIXES and is_stack(source):
        pages, slopes = read_focal_stack(source)
        if slopes is None:
            return _views(source)
        held = f"{len(pages)}, at slopes from {slopes.min():g} to {slopes.max():g}"
        return Found("stack of refocused images", {"images": held})
    image = read_image(source)
    found = Found("image")
    colour = "grey" if image.ndim == 2 else "colour"
    found.facts["pixels"] = f"{image.shape[0]} x {image.shape[1]}, {colour}"
    found.facts["values"] = f"{image.min():.4g} to {image.max():.4g}"
    try:
        grid = estimate_grid(_middle(image))
    except InputError:
        found.facts["lenslets"] = "none are seen"
        found.missing.append(_how_to_decode(image.shape))
        found.notes.append(_if_focused(source))
        found.command = typed("refocus", source, "--white", "WHITE.png")
        return found
    found.facts["lenslets"] = grid.describe()
    views = round(grid.pitch)
    on_pixels = abs(grid.pitch - views) < 0.02 and abs(grid.rotation) < 1e-3
    in_blocks = not any(n % views for n in image.shape[:2])
    options = ["--white", "WHITE.png"]
    try:
        refuse_mosaic(_middle(image), grid, "raw")
    except InputError as error:
        found.notes.append(str(error))
        options += ["--bayer", "PATTERN"]  # the note names two
    if grid.layout == "rectangular" and on_pixels and in_blocks and not found.notes:
        found.kind = "lenslet image"
        found.notes.append(_if_focused(source))
        found.command = typed("refocus", source, "--views", str(views))
        return found
    found.kind = "raw image of a plenoptic camera, or its white image"
    found.missing.append("the white image (flat field) of the camera, in the same form.")
    found.notes.append(_if_focused(source))
    found.command = typed("refocus", source, *options)
    return found


def _if_focused(source: Path) -> str:
    command = typed("refocus", source, "--focused", "CALIBRATION.xml")
    return (
        f"a picture does not tell whether the lenslets are focused, as those of a Raytrix camera "
        f"are; for such a camera type: {command} (or its white image in place of the calibration)."
    )


def _how_to_decode(shape: tuple[int, ...]) -> str:
    fit = [str(n) for n in range(2, 65) if not any(side % n for side in shape[:2])]
    return (
        f"what shows the lenslets: the white image of a raw image (--white), or the number of "
        f"pixels under a lenslet of a lenslet image (--views: {', '.join(fit) or 'none fits'}); or "
        f"the rows x columns of views that lie side by side (--mosaic 8x8)."
    )


def _middle(image: "np.ndarray") -> "np.ndarray":
    """Central part of an image, in which lenslets are looked for quickly."""
    starts = [max(0, (n - MIDDLE) // 4 * 2) for n in image.shape[:2]]
    return image[tuple(slice(start, start + MIDDLE) for start in starts)]


def _views(source: Path) -> Found:
    """Any other file, which is read as a light field."""
    from lf_flame.formats.reading import find_light_field, note_on_order

    light_field, order, *_ = find_light_field(source)
    v, u, t, s, *channels = light_field.views.shape
    found = Found("light field", shape=(v, u, t, s))
    colour = f"{channels[0]} channels" if channels else "grey"
    found.facts["views"] = f"{v} x {u}, of {t} x {s} pixels, {colour}"
    found.facts["values"] = f"{light_field.views.min():.4g} to {light_field.views.max():.4g}"
    if light_field.uncounted:
        found.facts["weights"] = light_field.uncounted
    if light_field.unknown:
        found.facts["unknown pixels"] = light_field.unknown
    if order is not None:
        found.facts["order"] = f"{order.order}, {order.reason}"
    told = [note_on_order(light_field, source)] if order is None else order.describe()[1:]
    found.notes += [note for note in told if note]
    found.command = typed("refocus", source)
    return found
