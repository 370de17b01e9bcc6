"""Facts of files: what a file is, what is missing to read it, and which command comes next."""

import shlex
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lf_flame._common.images import TIFF_SUFFIXES, open_tiff
from lf_flame._common.input_files import printable
from lf_flame.errors import InputError
from lf_flame.formats.arrays import cut_views, record_of
from lf_flame.formats.focused.lenslets import read_raytrix
from lf_flame.formats.images import IMAGE_SUFFIXES, is_lytro, is_stack, read_focal_stack, read_image
from lf_flame.formats.lytro.picture import read_lytro
from lf_flame.formats.lytro.white import white_files
from lf_flame.formats.raw.lenslet_search import estimate_grid
from lf_flame.formats.reading import find_light_field, kind_of


@dataclass
class FileFacts:
    """Kind and facts of a file; empty ones are not printed.

    `missing`: files, options needed; `command`: what to type next; `shape`: (v, u, t, s), if known.
    """

    kind: str
    facts: dict[str, str]
    command: str = ""
    notes: list[str] = field(default_factory=list)
    missing: str = ""
    shape: tuple[int, ...] = ()

    def text(self, source: Path) -> str:
        """Describe it in lines: kind, facts, notes, what is missing, and the next command."""
        lines = [f"{printable(source)}: {self.kind}"]
        lines += [f"  {name:<14}{printable(fact)}" for name, fact in self.facts.items() if fact]
        said = [("note", x) for x in self.notes]
        said += [("missing", self.missing), ("next", self.command)]
        return "\n".join(lines + [f"{mark}: {printable(x, 800)}" for mark, x in said if x])


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
    white = white_files(source) if suffix == ".tar" or source.is_dir() else []
    if white:
        serials = sorted({known.serial or "unknown" for known, _, _ in white})
        facts = {"images": f"{len(white)}", "cameras": ", ".join(serials[:10])}
        command = typed("refocus", "PICTURE.lfr", "--white", source)
        return FileFacts("white images of a Lytro camera", facts, command)
    if suffix == ".xml":
        facts = {"lenslets": read_raytrix(source, (1, 1)).describe()}
        command = typed("convert", "RAW.png", "views.npz", "--focused", source)
        return FileFacts("calibration of a Raytrix camera", facts, command)
    if suffix in TIFF_SUFFIXES:
        with open_tiff(source) as file:  # of other stacks each page is a view, perhaps in rows
            is_focal = "slopes" in (file.imagej_metadata or {})
        pages, slopes = read_focal_stack(source) if is_focal else ((), None)
        if slopes is not None:
            held = f"{len(pages)}, at slopes from {slopes.min():g} to {slopes.max():g}"
            return FileFacts("stack of refocused images", {"images": held})
    if suffix in IMAGE_SUFFIXES and not (suffix in TIFF_SUFFIXES and is_stack(source)):
        return _image(source)
    return _light_field(source, {})


def _light_field(source: Path, options: dict[str, Any]) -> FileFacts:
    """Read a light field of any kind, so that all that belongs to it fits."""
    found = find_light_field(source, **options)
    values, (v, u, t, s, *channels) = found.light_field.used_values, found.light_field.shape
    colour = f"{channels[0]} channels" if channels else "grey"
    record = record_of(source)
    facts = {
        "views": f"{v} x {u}, of {t} x {s} pixels, {colour}",
        "values": f"{values.min():.4g} to {values.max():.4g}",
        "made by": ", ".join(str(record[x]) for x in ("command", "date") if x in record),
    }
    given = [word for name, value in options.items() for word in (f"--{name}", value)]
    notes = [*found.notes, *found.doubts(source), found.coded]
    has_light = "lenslets" not in options or "white" in options
    missing = "" if has_light else "a white image (--white): without it outer views are too dark."
    kind = f"light field, {kind_of(source, options)[0]}"
    return FileFacts(kind, facts, typed("refocus", source, *given), notes, missing, (v, u, t, s))


def _image(source: Path) -> FileFacts:
    """Any single picture; only its user knows which of several kinds it is."""
    image = read_image(source)
    height, width = image.shape[:2]
    facts = {
        "pixels": f"{height} x {width}, {'grey' if image.ndim == 2 else 'colour'}",
        "values": f"{image.min():.4g} to {image.max():.4g}",
        "lenslets": "none are found reliably",
    }
    found = FileFacts("image", facts, typed("refocus", source, "--white", f"WHITE{source.suffix}"))
    try:
        cut_views(image, None, source)
    except InputError as error:  # the reader's own list of what it takes
        found.missing = str(error)
    with suppress(InputError):
        facts["lenslets"] = estimate_grid(image).describe()
        found.kind = "image with lenslets"
        spots = typed("refocus", "RAW.tif", "--lenslets", source)
        found.notes.append(
            f"the lenslets are those that this picture shows; a white image or closed-aperture "
            f"spots show them reliably. If this is such a picture, type: {spots} (or --white)."
        )
    return found


def _lytro_picture(source: Path) -> FileFacts:
    """Picture of a Lytro camera, what is known of its white image, and the next command."""
    picture = read_lytro(source)
    known, (rows, columns) = picture.metadata, picture.metadata.shape
    facts = {
        "camera": f"{known.model or 'unknown'}, serial number {known.serial or 'unknown'}",
        "sensor": f"{columns} x {rows} pixels of {known.bits} bits, {known.bayer} mosaic",
        "white image": "in the file" if picture.white_image is not None else "",
    }
    found = FileFacts("picture of a Lytro camera", facts, typed("refocus", source))
    if picture.white_image is None:
        archive = f"caldata-{known.serial or 'SERIAL'}.tar"
        found.missing = (
            f"a white image of this camera, without which vignetting is not corrected: {archive}, "
            f"or the folder of its MOD_*.RAW and MOD_*.TXT; `{found.command}` does without."
        )
        found.command = typed("refocus", source, "--white", archive)
    return found
