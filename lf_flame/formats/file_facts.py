"""Facts of files: what a file is, what is missing to read it, and which command comes next."""

import shlex
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from lf_flame._common.images import TIFF_SUFFIXES, read_shape
from lf_flame._common.input_files import printable
from lf_flame.errors import InputError
from lf_flame.formats.coding import note_on_coding
from lf_flame.formats.focused.lenslets import is_raytrix, read_raytrix
from lf_flame.formats.images import IMAGE_SUFFIXES, is_lytro, read_image
from lf_flame.formats.lytro.metadata import LytroMetadata
from lf_flame.formats.lytro.picture import read_lytro
from lf_flame.formats.lytro.white import holds_white_files, white_files
from lf_flame.formats.raw.lenslet_grid import LensletGrid
from lf_flame.formats.raw.lenslet_search import estimate_grid
from lf_flame.formats.raw.reading import read_raw
from lf_flame.formats.raw.sensor_images import check_colours
from lf_flame.formats.reading import find_light_field, note_on_order
from lf_flame.formats.stacks import is_stack, read_focal_stack
from lf_flame.formats.view_files.folder import is_view_folder, scan_view_folder
from lf_flame.lightfield import LightField


@dataclass
class Found:
    """Kind and facts of a file.

    `facts` are printed in their order; `notes` and `missing` (files or options that are needed) are
    sentences; `command` is what to type next, and `shape` the light field's (v, u, t, s), if known.
    """

    kind: str
    facts: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    command: str = ""
    shape: tuple[int, ...] = ()

    def text(self, source: Path) -> str:
        """Describe it in lines: kind, facts, what is missing, and the next command."""
        lines = [f"{printable(source)}: {self.kind}"]
        for name, fact in self.facts.items():
            lines.append(f"  {printable(name, 40):<14}{printable(fact)}")
        marked = [("note", one) for one in self.notes] + [("missing", one) for one in self.missing]
        marked += [("next", self.command)] if self.command else []
        return "\n".join([*lines, *(f"{mark}: {printable(one, 600)}" for mark, one in marked)])

    def add_light_field(self, light_field: LightField) -> None:
        """Add size and shape of a light field, and what of it is excluded or unknown."""
        v, u, t, s, *channels = light_field.views.shape
        self.shape = (v, u, t, s)
        colour = f"{channels[0]} channels" if channels else "grey"
        self.facts["views"] = f"{v} x {u}, of {t} x {s} pixels, {colour}"
        if light_field.uncounted:
            self.facts["weights"] = light_field.uncounted
        if light_field.unknown:
            self.facts["unknown"] = light_field.unknown


def typed(*words: str | Path) -> str:
    """Command line, with its words quoted for a shell."""
    return " ".join(["lf-flame", *(shlex.quote(str(word)) for word in words)])


def describe(
    source: Path,
    white: Path | None = None,
    lenslets: Path | None = None,
    dark: Path | None = None,
    bayer: str | None = None,
) -> Found:
    """Find out what a file or folder is; of a raw image, by images of the same camera."""
    given = {"--white": white, "--lenslets": lenslets, "--dark": dark, "--bayer": bayer}
    options = [word for pair in given.items() if pair[1] is not None for word in pair]
    if white is not None or lenslets is not None:
        light_field, grid = read_raw(source, white, lenslets=lenslets, dark=dark, bayer=bayer)
        return _raw_image(source, light_field, grid, options)
    if options:
        raise InputError(f"{options[0]} needs --white or --lenslets, which show the lenslets.")
    if is_lytro(source):
        return _lytro_picture(source)
    if source.suffix.lower() == ".tar" or (source.is_dir() and holds_white_files(source)):
        return _lytro_white_files(source)
    if is_view_folder(source):
        return _folder(source)
    if is_raytrix(source):
        facts = {"lenslets": read_raytrix(source, (1, 1)).describe()}
        command = typed("convert", "RAW.png", "views.npz", "--focused", source)
        return Found("calibration of a Raytrix camera", facts, command=command)
    if source.suffix.lower() in IMAGE_SUFFIXES:
        return _image(source)
    return _views(source)


def _folder(source: Path) -> Found:
    """Folder of views."""
    folder = scan_view_folder(source)
    rows, columns, channels = read_shape(next(file for file in folder.files.flat if file))
    v, u = folder.files.shape
    colour = "grey" if channels < 3 else "colour"
    notes = [*folder.describe().splitlines()[2:], note_on_coding(source)]
    return Found(
        "folder with one image for each view",
        {
            "views": f"{v} x {u}, of {rows} x {columns} pixels, {colour}",
            "order": str(folder.found),
        },
        list(filter(None, notes)),
        command=typed("refocus", source),
        shape=(v, u, rows, columns),
    )


def _raw_image(source: Path, light_field: LightField, grid: LensletGrid, options: list) -> Found:
    """Raw image with a white image or one of the lenslets: it is decoded, so that all fits."""
    found = Found("raw image of a plenoptic camera", {"lenslets": grid.describe()})
    found.add_light_field(light_field)
    if "--white" not in options:
        found.missing.append("the white image (--white), without which outer views are too dark.")
    found.command = typed("refocus", source, *options)
    return found


def _image(source: Path) -> Found:
    """Raw image, white image, spots, lenslet image, any other picture, or stack of pages."""
    if source.suffix.lower() in TIFF_SUFFIXES and is_stack(source):
        pages, slopes = read_focal_stack(source)
        if slopes is None:
            return _views(source)
        held = f"{len(pages)}, at slopes from {slopes.min():g} to {slopes.max():g}"
        return Found("stack of refocused images", {"images": held})
    image = read_image(source)
    height, width = image.shape[:2]
    found = Found("image")
    found.facts["pixels"] = f"{height} x {width}, {'grey' if image.ndim == 2 else 'colour'}"
    found.facts["values"] = f"{image.min():.4g} to {image.max():.4g}"
    focused = typed("convert", source, "views.npz", "--focused", "CALIBRATION.xml")
    focused = (
        f"a picture does not say whether the lenslets are focused, as those of a Raytrix camera "
        f"are; for such a camera type: {focused} (or its white image in place of the calibration)."
    )
    try:
        grid = estimate_grid(image)
    except InputError:
        found.facts["lenslets"] = "none are seen for certain"
        if fit := [str(n) for n in range(2, 65) if not (height % n or width % n)]:
            found.notes.append(
                f"if this is a lenslet image, N x N pixels to a lenslet, N divides both sides: "
                f"{', '.join(fit)}; only the camera's data say which N it is."
            )
        found.notes.append(focused)
        found.missing.append(
            "what shows the lenslets: the white image of a raw image (--white), spots "
            "(--lenslets), the number of pixels under a lenslet of a lenslet image (--views), or "
            "the rows x columns of views that lie side by side (`lf-flame convert --mosaic 8x8`)."
        )
        found.command = typed("refocus", source, "--white", "WHITE.png")
        return found
    found.facts["lenslets"] = grid.describe()
    found.notes.append(
        "the lenslets are those that this picture shows; a white image or closed-aperture spots "
        "(--white, --lenslets) show them for certain."
    )
    options = []
    try:
        check_colours(image, grid, "raw")
    except InputError as error:
        found.notes.append(str(error))
        options = ["--bayer", "PATTERN"]  # the note names two
    found.notes.append(focused)
    views = round(grid.pitch)
    on_pixels = abs(grid.pitch - views) < 0.02 and abs(grid.rotation) < 1e-3
    in_blocks = on_pixels and not (height % views or width % views)
    if grid.layout == "rectangular" and in_blocks and not options:
        found.kind = "lenslet image"
        found.command = typed("refocus", source, "--views", str(views))
    elif np.mean(image > 0.3 * np.percentile(image, 99.8)) < 0.15:  # most of it is dark
        found.kind = "calibration with a closed aperture: spots at the lenslets' centres"
        found.missing.append("the raw image that it belongs to.")
        found.command = typed("refocus", "RAW.tif", "--lenslets", source, *options)
    else:
        found.kind = "raw image of a plenoptic camera, or its white image"
        found.missing.append(
            "the white image (flat field) of the camera, in the same form; or one of the lenslets "
            "alone (--lenslets), which may be the raw image itself."
        )
        found.command = typed("refocus", source, "--white", "WHITE.png", *options)
    return found


def _views(source: Path) -> Found:
    """Any other file, which is read as a light field."""
    light_field, order, *_ = find_light_field(source)
    found = Found("light field")
    found.add_light_field(light_field)
    found.facts["values"] = f"{light_field.views.min():.4g} to {light_field.views.max():.4g}"
    found.facts["order"] = str(order)
    told = [*order.describe()[1:], note_on_order(light_field, order, source)]
    found.notes += [note for note in told if note]
    found.command = typed("refocus", source)
    return found


# Lytro cameras ------------------------------------------------------------------------------------


def _lytro_picture(source: Path) -> Found:
    """Picture of a Lytro camera, what is known of its white image, and the next command."""
    picture = read_lytro(source)
    metadata = picture.metadata
    command = typed("refocus", source)
    found = Found("picture of a Lytro camera", _lytro_facts(metadata), command=command)
    if picture.white_image is not None:
        found.facts["white image"] = "in the file"
        return found
    archive = f"caldata-{metadata.serial or 'SERIAL'}.tar"
    found.missing.append(
        f"a white image of this camera, without which vignetting is not corrected: {archive}, "
        f"or the folder of its MOD_*.RAW and MOD_*.TXT; `{command}` does without."
    )
    if metadata.grid is None:
        found.missing.append("the place of the lenslets, so that a white image is needed.")
    found.command = typed("refocus", source, "--white", archive)
    return found


def _lytro_facts(metadata: LytroMetadata) -> dict[str, str]:
    """Facts of a frame, by name."""
    rows, columns = metadata.shape
    black, white = (
        "/".join(f"{x:g}" for x in sorted(set(levels.ravel().tolist())))
        for levels in (metadata.black, metadata.white)
    )
    facts = {
        "camera": _joined(
            ("{}", metadata.model or None),
            ("serial number {}", metadata.serial or None),
        ),
        "sensor": f"{columns} x {rows} pixels of {metadata.bits} bits, {metadata.bayer} mosaic, "
        f"black {black}, white {white}",
        "exposure": _joined(
            ("{:.4g} s", metadata.exposure_s),
            ("f/{:.3g}", metadata.f_number),
            ("ISO {:g}", metadata.iso),
        ),
        "lens": _joined(
            ("{:.4g} mm", metadata.focal_mm),
            ("zoom step {:g}", metadata.zoom_step),
            ("focus step {:g}", metadata.focus_step),
        ),
        "lenslets": metadata.grid.describe() if metadata.grid else "",
    }
    return {name: fact for name, fact in facts.items() if fact}


def _joined(*parts: tuple[str, float | str | None]) -> str:
    return ", ".join(form.format(value) for form, value in parts if value is not None)


def _lytro_white_files(source: Path) -> Found:
    """White images of a Lytro camera."""
    metadata = [one.metadata for one in white_files(source)]
    if not metadata:
        raise InputError(
            f"{source} holds no white images of a Lytro camera (MOD_*.RAW, MOD_*.TXT)."
        )
    rows, columns = metadata[0].shape
    facts = {
        "images": f"{len(metadata)}, {columns} x {rows} pixels of {metadata[0].bits} bits",
        "cameras": ", ".join(sorted({one.serial or "unknown" for one in metadata})[:10]),
    }
    for name in ("zoom_step", "focus_step"):
        steps = {getattr(one, name) for one in metadata} - {None}
        if steps:
            facts[f"{name.replace('_', ' ')}s"] = (
                f"{len(steps)}, from {min(steps):g} to {max(steps):g}"
            )
    command = typed("refocus", "PICTURE.lfr", "--white", source)
    return Found("white images of a Lytro camera", facts, command=command)
