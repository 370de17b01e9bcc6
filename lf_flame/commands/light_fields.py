"""The commands of `lf-flame` that read a light field from anywhere: refocus, convert and so on.

As in `lf_flame.commands.cli`, heavy modules are imported inside the commands.
"""

from pathlib import Path

import click

from lf_flame._common.keras_loading import load_keras
from lf_flame.errors import InputError

FILE = click.Path(exists=True, dir_okay=False, path_type=Path)
FOLDER = click.Path(file_okay=False, path_type=Path)

SLOPE_CONVENTIONS = (
    "motion", "hci", "lftoolbox", "liff", "plenopticam", "plenopticam-refined", "plenpy", "fdl"
)  # fmt: skip
"""Names in `lf_flame.optics.slope_conventions`, which would take long to import for ``--help`` alone."""

READING = (
    click.option("--views", type=int, help="Pixels under a lenslet, of a lenslet image or raw."),
    click.option("--order", help="What the names of views count, as row,col (default: found)."),
    click.option("--white", type=FILE, help="White image, to decode a raw lenslet image."),
    click.option("--pitch", type=float, help="Micro-image pitch in pixels, of a raw image."),
    click.option(
        "--layout",
        type=click.Choice(["rectangular", "hexagonal"]),
        help="Lenslets of a raw image (default: as the white image shows).",
    ),
)
"""Options that say how a light field is to be read."""

REFOCUSING = (
    click.option(
        "--slope", "slopes", multiple=True, type=float, help="Slope to refocus at; may be repeated."
    ),
    click.option(
        "--slope-of",
        type=click.Choice(SLOPE_CONVENTIONS, case_sensitive=False),
        default="motion",
        show_default=True,
        help="Whose number --slope is; all that is printed and written is ours, motion.",
    ),
    click.option(
        "--depth-mm",
        "depths",
        multiple=True,
        type=float,
        help="Depth to refocus at; may be repeated; needs --camera.",
    ),
    click.option(
        "--search",
        is_flag=True,
        help="Refocus at the sharpest slope; what is done if none is asked.",
    ),
    click.option(
        "--sweep",
        nargs=2,
        type=float,
        metavar="FROM TO",
        help="Movie from one slope to another and back, 41 steps.",
    ),
    click.option(
        "--map",
        "slope_map",
        nargs=2,
        type=float,
        metavar="FROM TO",
        help="Slope of each pixel, and all in focus; the slopes should reach beyond the scene's.",
    ),
    click.option(
        "--camera", type=FILE, help="TOML file with a [camera] table, or a simulation.json."
    ),
)
"""Options that say at which slopes to refocus."""

APPEARANCE = (
    click.option(
        "--interpolation",
        type=click.Choice(["nearest", "linear", "cubic", "sinc"]),
        default="linear",
        show_default=True,
    ),
    click.option(
        "--method",
        type=click.Choice(["auto", "space", "fourier", "slice"]),
        default="auto",
        show_default=True,
        help="The picture is the same; auto is the fastest.",
    ),
    click.option("--aperture", type=float, help="Diameter of a round aperture; 1 is the full one."),
    click.option("--ring", type=float, help="Diameter of the middle that is covered."),
    click.option("--f-number", type=float, help="Of a round aperture; needs --camera."),
    click.option("--movie", type=click.Choice(["gif", "mp4"]), default="gif", show_default=True),
    click.option(
        "--network",
        type=click.Path(exists=True, path_type=Path),
        help="Refocus with this run of train-system, from its few views, or with RefocusNet by its "
        "authors' weights (.npz); --search looks at all views.",
    ),
)
"""Options that say how refocused images are made."""

READ_AS = ("views", "order", "white", "pitch", "layout")
"""Names of the options that say how a light field is to be read."""


def _with_options(*groups):
    def decorate(command):
        for option in reversed([option for group in groups for option in group]):
            command = option(command)
        return command

    return decorate


def _refuse_options(what: str, **options) -> None:
    for name, value in options.items():
        if value is not None:
            raise InputError(f"--{name.replace('_', '-')} does not apply to {what}.")


def _open_network(path: Path | None):
    """Load a trained system; nothing where none is asked for."""
    if path is None:
        return None
    load_keras()
    from lf_flame.systems.training import load_system

    return load_system(path)


def _read_light_field(source: Path, views, order, white, pitch, layout):
    """Read a light field of any kind, and tell what was found."""
    from tqdm import tqdm

    from lf_flame import formats

    if white is not None or pitch is not None:
        _refuse_options(f"the raw image {source}", order=order)
        light_field, grid = formats.read_raw(source, white, pitch, layout, views)
        click.echo(f"{source}: {grid.describe()}", err=True)
    elif source.is_dir():
        _refuse_options(f"the folder {source}", views=views, layout=layout)
        folder = formats.scan_view_folder(source, order)
        click.echo(folder.describe(), err=True)
        light_field = folder.read(lambda files: tqdm(files, "reading", unit="view"))
    else:
        _refuse_options(f"{source} without --white or --pitch", layout=layout)
        light_field = formats.read_light_field(source, views, order)
    v, u, t, s = light_field.views.shape[:4]
    click.echo(f"{v} x {u} views of {t} x {s} pixels", err=True)
    return light_field


@click.command()
@click.argument("source", type=click.Path(path_type=Path))
@_with_options(REFOCUSING, APPEARANCE, READING)
@click.option("--out", type=FOLDER, help="Folder for the pictures; default refocused/SOURCE.")
def refocus(source, slopes, slope_of, depths, search, sweep, slope_map, camera, out, **options):
    """Refocus a light field from anywhere; find its sharpest slope; sweep through its focus.

    SOURCE is a folder with one image per view (HCI, Stanford, row_col.png ...), an array
    (.npy, .npz), a TIFF of many pages, a lenslet image of N x N pixels to a lenslet (--views N;
    Lytro's ESLF is one), or a raw lenslet image (--white or --pitch).

    \b
      lf-flame refocus buddha                              at the sharpest slope
      lf-flame refocus buddha --slope 1.2 --slope -0.4     at these slopes
      lf-flame refocus buddha --sweep -1 2 --map -1 2      sweep.gif, slope map, all in focus
      lf-flame refocus raw.png --white white.png           any plenoptic camera
      lf-flame refocus light_field.npz --camera simulation.json --depth-mm 10
      lf-flame refocus buddha --slope 1 --network RUN      by a network, from nine of the views
    """  # noqa: D301 - click reads the backspace
    from tqdm import tqdm

    from lf_flame.commands.refocus_output import Refocusing, aperture_weights
    from lf_flame.formats.movie import check_movie
    from lf_flame.optics.slope_conventions import to_slope
    from lf_flame.scenes.scene_files import read_camera

    lens = read_camera(camera) if camera else None
    if lens is None and (depths or options["f_number"] is not None):
        raise InputError("--depth-mm and --f-number need the camera: --camera FILE.")
    movie = f"sweep.{options['movie']}"
    check_movie(movie)
    if options["network"]:
        _refuse_network_options({**options, "map": slope_map})
    out = _folder_for(source, out)
    network = _open_network(options["network"])
    light_field = _read_light_field(source, **{name: options[name] for name in READ_AS})
    views = light_field.views.shape[:2]
    aperture = (options[name] for name in ("aperture", "ring", "f_number"))
    how = {name: options[name] for name in ("interpolation", "method")}
    how["weights"] = aperture_weights(views, *aperture, lens)
    asked = [to_slope(slope, slope_of, views[1]) for slope in slopes]
    asked += [lens.depth_to_slope(depth) for depth in depths]
    asked_for = {"source": str(source), "depths_mm": depths}
    if network:
        asked_for["network"] = network.name
    job = Refocusing(light_field, out, how, network, asked_for)
    job.check(asked, sweep or (), slope_map or ())
    if search or not (asked or sweep or slope_map):
        found = job.search()
        click.echo(f"sharpest at slope {found.slope:+.3f}, confidence {found.confidence:.2f}")
        asked.append(found.slope)
    if asked:
        job.refocus_at(asked)
    if sweep:
        job.sweep(*sweep, movie, lambda steps: tqdm(steps, "sweeping", unit="stack"))
    if slope_map:
        share = job.map_slopes(*slope_map)
        click.echo(f"slope map: {share:.0%} of the pixels are certain")
    job.write_record()
    click.echo(f"{', '.join(job.written)} are in {out}")


def _folder_for(source: Path, out: Path | None, ending: str = "") -> Path:
    """Choose where pictures go."""
    name = source.resolve().name if source.is_dir() else source.stem
    out = out or Path("refocused") / f"{name}{ending}"
    if out.resolve() == source.resolve():
        raise InputError(f"The pictures cannot go into the light field's own folder, {source}.")
    return out


def _refuse_network_options(options: dict) -> None:
    """Refuse what a network cannot do: it has its own aperture, and interpolates linearly."""
    defaults = {"interpolation": "linear", "method": "auto"}
    of_formulas = {name: options[name] for name in ("aperture", "ring", "f_number", "map")}
    for name, default in defaults.items():
        of_formulas[name] = None if options[name] == default else options[name]
    _refuse_options("a network", **of_formulas)


@click.command("refocus-regions")
@click.argument("source", type=click.Path(path_type=Path))
@click.option(
    "--region",
    "regions",
    nargs=4,
    type=int,
    multiple=True,
    required=True,
    metavar="T0 T1 S0 S1",
    help="Rows from T0 to before T1, columns from S0 to before S1; may be repeated, a later one "
    "lying over those before it.",
)
@click.option(
    "--slopes",
    nargs=2,
    type=float,
    required=True,
    metavar="FROM TO",
    help="To search within; they should reach beyond those of the scene.",
)
@click.option("--background", type=float, help="Slope of all the rest (default: FROM).")
@click.option("--cross", is_flag=True, help="Look at a cross of 17 views alone; less exact.")
@click.option(
    "--network",
    type=click.Path(exists=True, path_type=Path),
    help="Run of `train-system volumetric`, which removes the ghosts that the cross leaves.",
)
@_with_options(READING)
@click.option("--out", type=FOLDER, help="Folder; default refocused/SOURCE-regions.")
def refocus_regions(source, regions, slopes, background, cross, network, out, **options) -> None:
    """Bring regions of a light field into focus, each at its own slope; blur the rest.

    SOURCE is read as by `lf-flame refocus`. The slope of a region is read off a slope map, or, from
    a cross of 17 views, is where the region looks most like the middle view (Samarakoon et al.,
    "Arbitrary Volumetric Refocusing of Dense and Sparse Light Fields", 2025). Around a region, over
    14 pixels, the slope changes to that of the rest, and what stands at one between is sharp there.

    \b
      lf-flame refocus-regions buddha --region 100 180 60 140 --region 20 90 200 300 --slopes -1 2
      lf-flame refocus-regions buddha --region 100 180 60 140 --slopes -1 2 --network RUN
    """  # noqa: D301 - click reads the backspace
    load_keras()
    from lf_flame.commands.refocus_output import Refocusing
    from lf_flame.systems.sparse_unet import SparseUNet, refocus_regions

    out, unet = _folder_for(source, out, "-regions"), _open_network(network)
    if unet is not None and not isinstance(unet, SparseUNet):
        raise InputError(f"{network} holds {unet.name}, not the network of `volumetric`.")
    dense = not (cross or unet)
    asked_for = {
        "source": str(source),
        "slopes_searched": slopes,
        "background": slopes[0] if background is None else background,
        "views_used": "all" if dense else "a cross of 17",
        "network": unet.name if unet else None,
    }
    job = Refocusing(_read_light_field(source, **options), out, record=asked_for)
    job.check([*slopes, *([] if background is None else [background])])
    image, surface, found = refocus_regions(
        job.views_to_white, regions, slopes, background, dense, unet
    )
    for region, (slope, trust) in zip(regions, found, strict=True):
        sure = f"{trust:.0%} of its pixels are certain" if dense else f"MS-SSIM {trust:.3f}"
        click.echo(f"region {' '.join(map(str, region))}: slope {slope:+.2f}, {sure}")
    measure = "certain" if dense else "ms_ssim"
    found = [{"slope": slope, measure: trust} for slope, trust in found]
    job.write_regions(image, surface, regions, found)
    job.write_record()
    click.echo(f"{', '.join(job.written)} are in {out}")


@click.command()
@click.argument("source", type=click.Path(path_type=Path))
@click.argument("target", type=click.Path(path_type=Path))
@_with_options(READING)
@click.option("--bits", type=click.Choice(["8", "16"]), default="16", show_default=True)
def convert(source: Path, target: Path, bits: str, **options) -> None:
    """Write a light field from anywhere in another form.

    SOURCE is read as by `lf-flame refocus`. TARGET is a new folder (one PNG for each view), a
    .png or .tif file (a lenslet image, N x N pixels to a lenslet) or .npy (views[v, u, t, s]).

    \b
      lf-flame convert raw.png views --white white.png     decode a plenoptic camera's image
      lf-flame convert views lenslets.png                  for programs that read lenslet images
    """  # noqa: D301 - click reads the backspace
    from lf_flame.formats import write_light_field

    write_light_field(_read_light_field(source, **options), target, int(bits))
    click.echo(f"{target} is written")
