"""The commands that read a light field from anywhere: refocus and convert.

As in `lf_flame.commands.cli`, heavy modules are imported inside the commands.
"""

from functools import partial
from pathlib import Path

import click
import cloup

from lf_flame._common.printable import printable
from lf_flame.commands.options import FOLDER, OVERWRITE, PATH, pick
from lf_flame.commands.reading_options import RARE, READING, Reading
from lf_flame.commands.refocus_options import APPEARANCE, SLOPES, Appearance, Focus, open_network
from lf_flame.errors import InputError

UNSURE = 0.3
"""Confidence below which a search is said to be uncertain."""


class MapCommand(cloup.Command):
    """A command that accepts `--map auto` beside `--map FROM TO`."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Join `--map auto` into one option."""
        joined: list[str] = []
        for word in args:
            if word == "auto" and joined[-1:] == ["--map"]:
                joined[-1] = "--map-auto"
            else:
                joined.append("--map-auto" if word == "--map=auto" else word)
        return super().parse_args(ctx, joined)


@cloup.command(cls=MapCommand)
@click.argument("source", type=PATH)
@SLOPES
@APPEARANCE
@READING
@click.option(
    "--out", type=FOLDER, help="Folder; default refocused/SOURCE, with the slopes asked for."
)
@OVERWRITE
def refocus(source, camera, out, overwrite, **options):
    """Refocus a light field of any kind; find its sharpest slope; sweep through its focus.

    SOURCE is a folder with one image for each view (HCI, Stanford, row_col.png ...), such a folder
    in a .zip, an array (.npy, .npz, .h5, .mat, .zarr), a TIFF of many pages, a lenslet image with
    N x N pixels under each lenslet (--views N; Lytro's ESLF is one), a raw lenslet image (--white,
    --lenslets or --pitch), or a raw picture of a Lytro camera (.lfp, .lfr). `lf-flame info SOURCE`
    says what it is, and `lf-flame convert` reads other kinds.

    \b
      lf-flame refocus buddha                              at the sharpest slope
      lf-flame refocus buddha --slope 1.2 --slope -0.4     at these slopes
      lf-flame refocus buddha --sweep -1 2 --map auto      sweep.gif, slope map, all in focus
      lf-flame refocus raw.png --white white.png           any plenoptic camera
      lf-flame refocus light_field.npz --camera simulation.json --depth-mm 10
      lf-flame refocus buddha --slope 1 --network RUN      by a network, from nine of the views
      lf-flame refocus buddha --region 100 180 60 140      a region in focus, the rest blurred
    """  # noqa: D301 - click reads the backspace
    from lf_flame.calibration import read_lens
    from lf_flame.commands.refocus_job import RefocusJob, check_job
    from lf_flame.commands.refocus_output import describe_job, picture_folder
    from lf_flame.formats.movie import check_movie

    focus, look, reading = (pick(kind, options) for kind in (Focus, Appearance, Reading))
    lens = read_lens(camera) if camera else None
    if lens is None and (focus.depths or look.f_number is not None):
        raise InputError("--depth-mm and --f-number need the camera: --camera FILE.")
    check_movie(f"sweep.{look.movie}")
    if look.network:
        look.refuse_for_network(focus.maps)
        if focus.regions and (focus.slopes or focus.depths or focus.sweep or focus.search):
            raise InputError("--region with --network makes no other pictures; call it twice.")
    with picture_folder(out or _default_folder(source, focus.name), source, overwrite) as folder:
        network = open_network(look.network)
        light_field, lens = reading.read_of_camera(source, lens)
        views = light_field.shape[:2]
        light_field = light_field if lens is None else lens.corrected(light_field)
        focus = focus.with_ends(light_field)
        slopes = focus.asked_slopes(views[1], lens)
        job = RefocusJob(light_field, look.options(views, lens), network, lens, **look.brightness)
        beyond = () if focus.background is None else (focus.background,)
        check_job(job, [*slopes, *beyond], focus.sweep or (), focus.slope_map or ())
        describe_job(job, folder)
        if network:
            folder.facts["network"] = network.name
            from lf_flame.systems.sparse_unet import SparseUNet

            if focus.regions and not isinstance(network, SparseUNet):
                raise InputError(
                    f"{look.network} holds {network.name}; --region needs the network of "
                    f"`train-system volumetric`."
                )
        _write_pictures(job, focus, slopes, f"sweep.{look.movie}", folder)
    _tell_files(folder)


def _write_pictures(job, focus: Focus, slopes: list[float], movie: str, folder) -> None:
    """Make all requested pictures, and the record."""
    from tqdm import tqdm

    from lf_flame.commands import refocus_output as output
    from lf_flame.refocus.figures import with_depth

    if focus.searches:
        found = output.write_search(job, folder)
        sharpest = with_depth(f"{found.slope:+.3f}", found.slope, job.camera)
        click.echo(f"sharpest at slope {sharpest}, confidence {found.confidence:.2f}")
        if found.confidence < UNSURE:
            click.echo(
                f"The slope is not certain: {found.doubt}. See which by --map auto, or by "
                f"lf-flame view.",
                err=True,
            )
        slopes = [*slopes, found.slope]
    if slopes:
        output.write_refocused(job, slopes, folder)
    if focus.regions:
        for found in output.write_regions(job, focus, folder):
            sharpest = with_depth(f"{found.slope:+.3f}", found.slope, job.camera)
            click.echo(
                f"region {' '.join(map(str, found.region))}: slope {sharpest}, confidence "
                f"{found.confidence:.2f}"
            )
    if focus.sweep:
        bar = partial(tqdm, desc="sweeping", unit="stack")
        output.write_sweep(job, focus.sweep, movie, folder, bar)
    if focus.slope_map:
        share = output.write_slope_map(job, focus.slope_map, folder)
        ends = " to ".join(with_depth(f"{end:+.3f}", end, job.camera) for end in focus.slope_map)
        click.echo(f"slope map from {ends}: {share:.0%} of the pixels are certain")
        if not share:
            click.echo(
                "No slope is certain: the range is too narrow to compare slopes, or there is too "
                f"little texture.{'' if focus.map_auto else ' --map auto finds a range.'}",
                err=True,
            )


def _tell_files(folder) -> None:
    """Print the files that were written."""
    click.echo(f"{', '.join(folder.files)} are in {printable(folder.folder)}")


def _default_folder(source: Path, ending: str) -> Path:
    """Choose the folder of the pictures."""
    name = source.resolve().name if source.is_dir() else source.stem
    return Path("refocused") / f"{name}{ending}"


@cloup.command()
@click.argument("source", type=PATH)
@click.argument("target", type=PATH)
@READING
@RARE
@click.option(
    "--bits",
    type=click.Choice(["8", "16", "32"]),
    help="Bits a value of an image; 32 are floats, in TIFF (default: 16, or 32 where 16 cannot "
    "hold the values).",
)
def convert(source: Path, target: Path, bits: str | None, **options) -> None:
    """Write a light field of any kind in another form.

    SOURCE is read as by `lf-flame refocus`; or it is a picture of views side by side (--mosaic), an
    array with other axes (--axes, --array), or a raw image of focused lenslets (--focused). TARGET
    is a new folder (one PNG for each view), a .png or .tif file (a lenslet image, N x N pixels
    under each lenslet), .npy (views[v, u, t, s]), .npz or .zarr (views, their weights if some are
    excluded, and which pixels are known if some are not). Decode once, and use that file for long
    work. Levels of 8 and 16 bits hold values from 0 to 1. Values outside, as in most raw images
    divided by a white image, are written as floats in TIFF files; where that is impossible (.png,
    or --bits 8 or 16), they are scaled, and TARGET.json holds the scale.

    \b
      lf-flame convert raw.png views.npz --white white.png decode a plenoptic camera's image
      lf-flame convert raw.png views.npz --focused calibration.xml        of a Raytrix camera
      lf-flame convert picture.png views.npz --mosaic 8x8  views side by side
      lf-flame convert views lenslets.png                  for programs that read lenslet images
    """  # noqa: D301 - click reads the backspace
    from lf_flame._common.locks import exclusive
    from lf_flame.commands.conversion import convert_light_field
    from lf_flame.formats.coding import notes_on_coding

    reading = Reading(**options)
    if target.resolve() in {path.resolve() for path in (source, *reading.files)}:
        raise InputError(f"{target} is read, and cannot be replaced; name another file.")
    with exclusive(target):
        light_field = reading.read(source)
        coded = notes_on_coding(source)
        said = convert_light_field(light_field, target, int(bits) if bits else None, not coded)
    for note in coded:
        click.echo(note, err=True)
    lost = {
        "which views count": light_field.weights is not None and not light_field.weights.all(),
        "which pixels are known": light_field.valid is not None,
    }
    if target.suffix.lower() not in (".npz", ".zarr") and any(lost.values()):
        what = " and ".join(name for name, is_lost in lost.items() if is_lost)
        click.echo(f"{printable(target)} does not hold {what}; .npz and .zarr do", err=True)
    click.echo(f"{printable(target)} is written{said}")
