"""Facts of the files of Lytro cameras: pictures and white images.

As in `lf_flame.commands.cli`, heavy modules are imported inside.
"""

from pathlib import Path
from typing import TYPE_CHECKING

from lf_flame.commands.findings import Found, typed
from lf_flame.errors import InputError

if TYPE_CHECKING:
    from lf_flame.formats.lytro.metadata import LytroMetadata
    from lf_flame.formats.lytro.picture import LytroFile


def lytro_picture(source: Path) -> Found:
    """Describe a picture of a Lytro camera."""
    from lf_flame.formats.lytro.picture import LytroFile

    file = LytroFile(source)
    found = Found("picture of a Lytro camera")
    if file.container is not None:
        found.facts["container"] = f"{len(file.container.sections)} sections, all as their SHA-1"
    if file.metadata is not None:
        found.facts |= _lytro_facts(file.metadata)
    if (size := _thumbnail_size(file)) is not None:
        found.facts["thumbnail"] = size
    if not file.has_raw:
        found.missing.append(
            "the raw image: a processed file has no views; export the raw picture (.lfr, or .lfp) "
            "from the camera's library."
        )
        return found
    return _with_white(found, file, source)


def _with_white(found: Found, file: "LytroFile", source: Path) -> Found:
    """Add what is known of the white image of a raw picture, and the next command."""
    if file.has_white:
        found.facts["white image"] = "in the file"
        found.command = typed("refocus", source)
        return found
    metadata = file.metadata
    serial = metadata.serial if metadata is not None else ""
    archive = f"caldata-{serial or 'SERIAL'}.tar"
    found.missing.append(
        f"a white image of this camera, without which vignetting is not corrected: {archive}, or "
        f"the folder of its MOD_*.RAW and MOD_*.TXT; {typed('refocus', source)} does without."
    )
    if metadata is not None and metadata.grid is None:
        found.missing.append("the place of the lenslets, so that a white image is needed.")
    found.command = typed("refocus", source, "--white", archive)
    return found


def _lytro_facts(metadata: "LytroMetadata") -> dict[str, str]:
    """Facts of a frame, by name."""
    rows, columns = metadata.shape
    black, white = (
        "/".join(f"{x:g}" for x in sorted(set(levels.ravel().tolist())))
        for levels in (metadata.black, metadata.white)
    )
    facts = {
        "camera": ", ".join(
            f"{name}{value}"
            for name, value in (
                ("", metadata.model),
                ("serial number ", metadata.serial),
                ("firmware ", metadata.firmware),
            )
            if value
        ),
        "sensor": f"{columns} x {rows} pixels of {metadata.bits} bits, {metadata.bayer} mosaic, "
        f"black {black}, white {white}",
        "exposure": _joined(
            ("{:.4g} s", metadata.exposure_s),
            ("f/{:.3g}", metadata.f_number),
            ("ISO {:g}", metadata.iso),
            ("{}", metadata.date or None),
        ),
        "lens": _joined(
            ("{:.4g} mm", metadata.focal_mm),
            ("zoom step {:g}", metadata.zoom_step),
            ("focus step {:g}", metadata.focus_step),
        ),
        "lenslets": metadata.grid.describe() if metadata.grid else "",
    }
    if metadata.orientation != 1:
        facts["orientation"] = f"{metadata.orientation} (EXIF); views stay as on the sensor"
    return {name: fact for name, fact in facts.items() if fact}


def _joined(*parts: tuple[str, float | str | None]) -> str:
    return ", ".join(form.format(value) for form, value in parts if value is not None)


def _thumbnail_size(file: "LytroFile") -> str | None:
    """Describe the thumbnail of a Lytro picture; None if there is none."""
    from lf_flame.formats.lytro.container import check_jpeg

    data = file.thumbnail()
    if data is None:
        return None
    try:
        rows, columns = check_jpeg(data, file.path)
    except InputError as error:
        return str(error)
    return f"JPEG of {columns} x {rows} pixels (--thumbnail FILE.jpg writes it)"


def lytro_white_files(source: Path) -> Found:
    """Describe white images of a Lytro camera."""
    from lf_flame.formats.lytro.white import white_files

    with white_files(source) as files:
        metadata = [one.metadata for one in files]
    if not metadata:
        raise InputError(
            f"{source} holds no white images of a Lytro camera (MOD_*.RAW, MOD_*.TXT)."
        )
    serials = sorted({one.serial or "unknown" for one in metadata})
    rows, columns = metadata[0].shape
    found = Found("white images of a Lytro camera")
    found.facts["images"] = f"{len(metadata)}, {columns} x {rows} pixels of {metadata[0].bits} bits"
    found.facts["cameras"] = ", ".join(serials[:10])
    for name, steps in (
        ("zoom steps", {one.zoom_step for one in metadata}),
        ("focus steps", {one.focus_step for one in metadata}),
    ):
        known = sorted(step for step in steps if step is not None)
        if known:
            found.facts[name] = f"{len(known)}, from {known[0]:g} to {known[-1]:g}"
    found.command = typed("refocus", "PICTURE.lfr", "--white", source)
    return found
