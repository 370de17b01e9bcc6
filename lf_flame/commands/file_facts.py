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

MOST_NAMED = 5
"""Largest number of files of a folder that are named."""


def describe(source: Path, white: Path | None = None, lenslets: Path | None = None) -> Found:
    """Find out what a file or folder is; of a raw image, by an image that shows its lenslets."""
    from lf_flame.formats.focused.raytrix import is_raytrix
    from lf_flame.formats.images import IMAGE_SUFFIXES
    from lf_flame.formats.lytro.decoding import is_lytro
    from lf_flame.formats.lytro.white import holds_white_files
    from lf_flame.formats.view_files.folder import is_view_folder

    if white is not None or lenslets is not None:
        return _raw_image(source, white, lenslets)
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


def _raw_image(source: Path, white: Path | None, lenslets: Path | None) -> Found:
    """Raw image with a white image or one of the lenslets: it is decoded, so that all fits."""
    from lf_flame.formats import read_raw

    light_field, grid = read_raw(source, white, lenslets=lenslets)
    v, u, t, s, *channels = light_field.views.shape
    found = Found("raw image of a plenoptic camera", shape=(v, u, t, s))
    found.facts["lenslets"] = grid.describe()
    found.facts["views"] = f"{v} x {u}, of {t} x {s} pixels, {'colour' if channels else 'grey'}"
    if light_field.uncounted:
        found.facts["weights"] = light_field.uncounted
    if light_field.unknown:
        found.facts["unknown pixels"] = light_field.unknown
    given = (("--white", white), ("--lenslets", lenslets))
    options = [word for name, file in given if file is not None for word in (name, file)]
    if white is None:
        found.missing.append("the white image (--white), without which outer views are too dark.")
    found.command = typed("refocus", source, *options)
    return found


def _image(source: Path) -> Found:
    """Raw image, white image, spots, lenslet image, any other picture, or stack of pages."""
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
        grid = estimate_grid(image)
    except InputError:
        return _unknown_image(source, image, found)
    found.facts["lenslets"] = grid.describe()
    found.notes.append(
        "the lenslets are those that this picture shows; a white image or closed-aperture spots "
        "(--white, --lenslets) show them for certain."
    )
    options = []
    try:
        refuse_mosaic(image, grid, "raw")
    except InputError as error:
        found.notes.append(str(error))
        options += ["--bayer", "PATTERN"]  # the note names two
    views = round(grid.pitch)
    on_pixels = abs(grid.pitch - views) < 0.02 and abs(grid.rotation) < 1e-3
    in_blocks = not any(n % views for n in image.shape[:2])
    found.notes.append(_if_focused(source))
    if grid.layout == "rectangular" and on_pixels and in_blocks and not options:
        found.kind = "lenslet image"
        found.command = typed("refocus", source, "--views", str(views))
        return found
    if _shows_spots(image):
        found.kind = "calibration with a closed aperture: spots at the lenslets' centres"
        found.missing.append("the raw image that it belongs to.")
        found.command = typed("refocus", "RAW.tif", "--lenslets", source, *options)
        return found
    found.kind = "raw image of a plenoptic camera, or its white image"
    found.missing.append(
        "the white image (flat field) of the camera, in the same form; or one of the lenslets "
        "alone (--lenslets), which may be the raw image itself."
    )
    found.command = typed("refocus", source, "--white", "WHITE.png", *options)
    return found


def _unknown_image(source: Path, image: "np.ndarray", found: Found) -> Found:
    """Picture that shows no lenslets: what it may be, and what cannot be known."""
    fit = _divisors(image)
    found.facts["lenslets"] = "none are seen for certain"
    if fit:
        found.notes.append(
            f"if this is a lenslet image, N x N pixels to a lenslet, N divides both sides: "
            f"{', '.join(map(str, sorted(fit)))}; what repeats every {fit[0]} pixels stands out "
            f"most, but contents may do that too: only the camera's data say which N it is."
        )
    found.missing.append(
        "what shows the lenslets: the white image of a raw image (--white), spots (--lenslets), "
        "the number of pixels under a lenslet of a lenslet image (--views), or the rows x columns "
        "of views that lie side by side (--mosaic 8x8)."
    )
    found.notes.append(_if_focused(source))
    found.command = typed("refocus", source, "--white", "WHITE.png")
    return found


def _divisors(image: "np.ndarray") -> list[int]:
    """Numbers from 2 to 64 that divide both sides, by how sharply the picture repeats so."""
    import numpy as np

    grey = np.atleast_3d(image).mean(axis=2)
    spectra = [np.abs(np.fft.rfft(grey, axis=axis)).mean(axis=1 - axis) for axis in (0, 1)]

    def sharpness(n: int) -> float:
        """Line of the period over its neighbours, in the direction where it is weaker."""
        ratios = []
        for side, spectrum in zip(grey.shape, spectra, strict=True):
            at, reach = side // n, max(3, side // n // 3)
            near = np.concatenate([spectrum[max(at - reach, 1) : at - 1],
                                   spectrum[at + 2 : at + reach + 1]])  # fmt: skip
            tiny = np.finfo(float).tiny
            ratios.append(spectrum[at] / max(near.mean(), tiny) if near.size else 0.0)
        return min(ratios)

    fit = [n for n in range(2, 65) if not any(side % n for side in grey.shape)]
    return sorted(fit, key=sharpness, reverse=True)


def _shows_spots(image: "np.ndarray") -> bool:
    """Whether most of a picture is dark, and what is bright is little of it."""
    import numpy as np

    lit = image > 0.3 * np.percentile(image, 99.8)
    return bool(lit.mean() < 0.15)


def _if_focused(source: Path) -> str:
    command = typed("refocus", source, "--focused", "CALIBRATION.xml")
    return (
        f"a picture does not say whether the lenslets are focused, as those of a Raytrix camera "
        f"are; for such a camera type: {command} (or its white image in place of the calibration)."
    )


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
