"""Facts of files: what a file is, what is missing to read it, and which command comes next."""

import shlex
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lf_flame._common.images import TIFF_SUFFIXES
from lf_flame._common.input_files import printable
from lf_flame.errors import InputError
from lf_flame.formats.coding import note_on_coding
from lf_flame.formats.focused.lenslets import is_raytrix, read_raytrix
from lf_flame.formats.images import IMAGE_SUFFIXES, is_lytro, read_image
from lf_flame.formats.lytro.picture import read_lytro
from lf_flame.formats.lytro.white import holds_white_files, white_files
from lf_flame.formats.raw.lenslet_search import estimate_grid
from lf_flame.formats.raw.sensor_images import check_colours
from lf_flame.formats.reading import find_light_field, kind_of
from lf_flame.formats.stacks import is_stack, read_focal_stack


@dataclass
class FileFacts:
    """Kind and facts of a file.

    `facts` are printed in their order, if they are not empty; `notes` and `missing` (files or
    options that are needed) are sentences; `command` is what to type next, and `shape` the light
    field's (v, u, t, s), if known.
    """

    kind: str
    facts: dict[str, str] = field(default_factory=dict)
    command: str = ""
    notes: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    shape: tuple[int, ...] = ()

    def text(self, source: Path) -> str:
        """Describe it in lines: kind, facts, what is missing, and the next command."""
        lines = [f"{printable(source)}: {self.kind}"]
        facts = {name: fact for name, fact in self.facts.items() if fact}
        lines += [f"  {name:<14}{printable(fact)}" for name, fact in facts.items()]
        marked = {"note": self.notes, "missing": self.missing, "next": [self.command]}
        lines += [
            f"{mark}: {printable(x, 600)}" for mark, some in marked.items() for x in some if x
        ]
        return "\n".join(lines)


def typed(*words: str | Path) -> str:
    """Command line, with its words quoted for a shell."""
    return " ".join(["lf-flame", *(shlex.quote(str(word)) for word in words)])


def describe(source: Path, **options: Any) -> FileFacts:
    """Find out what a file or folder is; `options` are those of `find_light_field`."""
    options = {name: value for name, value in options.items() if value is not None}
    suffix = source.suffix.lower()
    if options:
        return _light_field(source, options)
    if is_lytro(source):
        return _lytro_picture(source)
    if suffix == ".tar" or (source.is_dir() and holds_white_files(source)):
        known = [one.metadata for one in white_files(source)]
        serials = sorted({one.serial or "unknown" for one in known})
        facts = {"images": f"{len(known)}", "cameras": ", ".join(serials[:10])}
        command = typed("refocus", "PICTURE.lfr", "--white", source)
        return FileFacts("white images of a Lytro camera", facts, command)
    if is_raytrix(source):
        facts = {"lenslets": read_raytrix(source, (1, 1)).describe()}
        command = typed("convert", "RAW.png", "views.npz", "--focused", source)
        return FileFacts("calibration of a Raytrix camera", facts, command)
    if suffix in TIFF_SUFFIXES and is_stack(source):
        pages, slopes = read_focal_stack(source)
        if slopes is not None:
            held = f"{len(pages)}, at slopes from {slopes.min():g} to {slopes.max():g}"
            return FileFacts("stack of refocused images", {"images": held})
    elif suffix in IMAGE_SUFFIXES:
        return _image(source)
    return _light_field(source, {})


def _light_field(source: Path, options: dict[str, Any]) -> FileFacts:
    """Read a light field of any kind, so that all that belongs to it fits."""
    found = find_light_field(source, **options)
    counted, (v, u, t, s, *channels) = found.light_field.counted, found.light_field.shape
    colour = f"{channels[0]} channels" if channels else "grey"
    facts = {
        "views": f"{v} x {u}, of {t} x {s} pixels, {colour}",
        "values": f"{counted.min():.4g} to {counted.max():.4g}",
    }
    given = [word for name, value in options.items() for word in (f"--{name}", value)]
    notes = [*found.notes, *found.doubts(source), note_on_coding(source)]
    command = typed("refocus", source, *given)
    kind = f"light field, {kind_of(source, options)[0]}"
    made = FileFacts(kind, facts, command, notes, shape=(v, u, t, s))
    if "lenslets" in options and "white" not in options:
        made.missing.append("the white image (--white), without which outer views are too dark.")
    return made


def _image(source: Path) -> FileFacts:
    """Any single picture; only its user knows which of several kinds it is."""
    image = read_image(source)
    height, width = image.shape[:2]
    fit = [str(n) for n in range(2, 65) if not (height % n or width % n)]
    focused = typed("convert", source, "views.npz", "--focused", "CALIBRATION.xml")
    found = FileFacts("image")
    found.facts["pixels"] = f"{height} x {width}, {'grey' if image.ndim == 2 else 'colour'}"
    found.facts["values"] = f"{image.min():.4g} to {image.max():.4g}"
    found.facts["lenslets"] = "none are seen for certain"
    bayer = []
    try:
        grid = estimate_grid(image)
        found.kind = "image with lenslets"
        found.facts["lenslets"] = grid.describe()
        spots = typed("refocus", "RAW.tif", "--lenslets", source)
        found.notes.append(
            f"the lenslets are those that this picture shows; a white image or closed-aperture "
            f"spots show them for certain. If this is such a picture, type: {spots} (or --white)."
        )
        check_colours(image, grid, "raw")
    except InputError as error:
        if found.notes:  # the lenslets were found
            found.notes.append(str(error))
            bayer = ["--bayer", "PATTERN"]  # the note names two
    found.notes += [
        f"if this is a lenslet image, N x N pixels to a lenslet, N divides both sides: "
        f"{', '.join(fit) or 'only 1 does'}; only the camera's data say which N it is.",
        f"a picture does not say whether the lenslets are focused, as those of a Raytrix camera "
        f"are; for such a camera type: {focused} (or its white image in place of the calibration).",
    ]
    found.missing.append(
        "what shows the lenslets: the white image (flat field) of a raw image (--white; --dark, if "
        "there is one), spots or the raw image itself (--lenslets), the number of pixels under "
        "a lenslet of a lenslet image (--views), or the rows x columns of views that lie side by "
        "side (`lf-flame convert --mosaic 8x8`)."
    )
    found.command = typed("refocus", source, "--white", f"WHITE{source.suffix}", *bayer)
    return found


def _lytro_picture(source: Path) -> FileFacts:
    """Picture of a Lytro camera, what is known of its white image, and the next command."""
    picture = read_lytro(source)
    known, (rows, columns) = picture.metadata, picture.metadata.shape
    lists: dict[str, list[tuple[str, Any]]] = {
        "camera": [("{}", known.model or None), ("serial number {}", known.serial or None)],
        "sensor": [(f"{columns} x {rows} pixels of {known.bits} bits, {known.bayer} mosaic", 0)],
        "lens": [
            ("zoom step {:g}", known.zoom_step),
            ("focus step {:g}", known.focus_step),
        ],
    }
    facts = {
        name: ", ".join(form.format(value) for form, value in parts if value is not None)
        for name, parts in lists.items()
    }
    found = FileFacts("picture of a Lytro camera", facts, typed("refocus", source))
    if picture.white_image is not None:
        found.facts["white image"] = "in the file"
        return found
    archive = f"caldata-{known.serial or 'SERIAL'}.tar"
    found.missing.append(
        f"a white image of this camera, without which vignetting is not corrected: {archive}, "
        f"or the folder of its MOD_*.RAW and MOD_*.TXT; `{found.command}` does without."
    )
    found.command = typed("refocus", source, "--white", archive)
    return found
