"""The command that says what a file is, and what to type next.

As in `lf_flame.commands.cli`, heavy modules are imported inside.
"""

import io
from pathlib import Path

import click
import cloup

from lf_flame._common.printable import printable
from lf_flame.commands.options import PATH, camera_option
from lf_flame.errors import InputError

PICTURES = (".png", ".jpg", ".jpeg")
"""File endings of a preview."""


@cloup.command()
@click.argument("source", type=PATH)
@click.option("--thumbnail", type=PATH, help="Write a preview: .png or .jpg.")
@click.option("--white", type=PATH, help="White image of the raw image SOURCE; says if it fits.")
@click.option("--lenslets", type=PATH, help="Image that shows the lenslets of SOURCE.")
@camera_option("; says what mm it gives")
def info(
    source: Path,
    thumbnail: Path | None,
    white: Path | None,
    lenslets: Path | None,
    camera: Path | None,
) -> None:
    """Say what a file or folder is, what is missing to read it, and which command comes next.

    SOURCE is anything that may hold a light field: a picture of a Lytro camera (.lfp, .lfr, .raw),
    its white images (a folder, or caldata-SERIAL.tar), the calibration of a Raytrix camera (.xml),
    a folder of views, an array, a TIFF of many pages, a raw image or a lenslet image. Nothing is
    changed. The thumbnail of a Lytro picture is the one that the camera made; otherwise it is the
    photograph of all views.

    \b
      lf-flame info photo.lfr                        camera, exposure, lenslets, white image
      lf-flame info photo.lfr --thumbnail photo.jpg  and how it looks
      lf-flame info caldata-B5143909630.tar          for which camera, zoom and focus it is
      lf-flame info raw.tif --lenslets spots.tif     lenslets, views, and what is missing
      lf-flame info flame.npz --camera calibration.toml  in mm: pixels, focus, depth
    """  # noqa: D301 - click reads the backspace
    from lf_flame.calibration import read_lens
    from lf_flame.commands.file_facts import describe
    from lf_flame.commands.lens_facts import lens_facts

    if not source.exists():
        raise InputError(f"There is no {source}: no such file or folder.")
    if thumbnail is not None and thumbnail.suffix.lower() not in PICTURES:
        raise InputError(f"--thumbnail must end in {', '.join(PICTURES)}, got {thumbnail}.")
    if thumbnail is not None and thumbnail.resolve() == source.resolve():
        raise InputError(f"{thumbnail} is read, and cannot be replaced; name another file.")
    found = describe(source, white, lenslets)
    if camera is not None:
        facts, notes = lens_facts(read_lens(camera), found.shape)
        found.facts |= facts
        found.notes += notes
    click.echo(found.text(source))
    if thumbnail is not None:
        _write_thumbnail(source, thumbnail)
        click.echo(f"{printable(thumbnail)} is written")


def _write_thumbnail(source: Path, target: Path) -> None:
    """Write a preview: the camera's own, or the photograph of all views."""
    from lf_flame._common.atomic_files import atomic_write

    data = _preview(source, target.suffix.lower())
    with atomic_write(target) as aside:
        aside.write_bytes(data)


def _preview(source: Path, ending: str) -> bytes:
    """Bytes of a preview, as PNG or JPEG by the ending."""
    from PIL import Image

    from lf_flame import formats
    from lf_flame.formats.images import to_preview, white_level
    from lf_flame.formats.lytro.container import check_jpeg
    from lf_flame.formats.lytro.decoding import is_lytro
    from lf_flame.formats.lytro.picture import LytroFile

    data = LytroFile(source).thumbnail() if is_lytro(source) else None
    out = io.BytesIO()
    if data is not None:
        check_jpeg(data, source)
        if ending != ".png":
            return data
        Image.open(io.BytesIO(data), formats=("JPEG",)).convert("RGB").save(out, "PNG")
        return out.getvalue()
    photograph = formats.read_light_field(source).photograph
    shown = to_preview(photograph, white_level(photograph)).squeeze()
    Image.fromarray(shown).save(out, "PNG" if ending == ".png" else "JPEG", quality=92)
    return out.getvalue()
