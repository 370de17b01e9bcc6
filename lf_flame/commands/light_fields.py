"""The commands that read a light field from anywhere: refocus, refocus-regions and convert.

As in `lf_flame.commands.cli`, heavy modules are imported inside the commands.
"""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import cloup

from lf_flame._common.keras_loading import load_keras
from lf_flame.commands.options import FILE, FOLDER, PATH, UsablePath
from lf_flame.errors import InputError

if TYPE_CHECKING:
    from lf_flame.lightfield import LightField
    from lf_flame.optics.camera import PlenopticCamera

SLOPE_CONVENTIONS = (
    "motion", "hci", "lftoolbox", "liff", "plenopticam", "plenopticam-refined", "plenpy", "fdl"
)  # fmt: skip
"""Names in `lf_flame.optics.slope_conventions`, whose import would take long for ``--help``."""

READING = cloup.option_group(
    "How the light field is read",
    cloup.option("--views", type=int, help="Pixels under a lenslet, of a lenslet image or raw."),
    cloup.option("--order", help="What the names of views count, as row,col (default: found)."),
    cloup.option("--white", type=FILE, help="White image, to decode a raw lenslet image."),
    cloup.option("--pitch", type=float, help="Micro-image pitch in pixels, of a raw image."),
    cloup.option(
        "--layout",
        type=click.Choice(["rectangular", "hexagonal"]),
        help="Lenslets of a raw image (default: as the white image shows).",
    ),
)
"""Options that say how a light field is to be read."""

SLOPES = cloup.option_group(
    "Where to focus",
    cloup.option(
        "--slope", "slopes", multiple=True, type=float, help="Slope to refocus at; may be repeated."
    ),
    cloup.option(
        "--slope-of",
        type=click.Choice(SLOPE_CONVENTIONS, case_sensitive=False),
        default="motion",
        show_default=True,
        help="Whose number --slope is; all that is printed and written is ours, motion.",
    ),
    cloup.option(
        "--depth-mm",
        "depths",
        multiple=True,
        type=float,
        help="Depth to refocus at; may be repeated; needs --camera.",
    ),
    cloup.option(
        "--search",
        is_flag=True,
        help="Refocus at the sharpest slope; what is done if none is asked.",
    ),
    cloup.option(
        "--sweep",
        nargs=2,
        type=float,
        metavar="FROM TO",
        help="Movie from one slope to another and back, 41 steps.",
    ),
    cloup.option(
        "--map",
        "slope_map",
        nargs=2,
        type=float,
        metavar="FROM TO | auto",
        help="Slope of each pixel, and all in focus; the slopes should reach beyond the scene's; "
        "auto finds such.",
    ),
    cloup.option("--map-auto", is_flag=True, hidden=True),
    cloup.option(
        "--camera", type=FILE, help="TOML file with a [camera] table, or a simulation.json."
    ),
)
"""Options that say at which slopes to refocus."""

APPEARANCE = cloup.option_group(
    "How the images are made",
    cloup.option(
        "--interpolation",
        type=click.Choice(["nearest", "linear", "cubic", "sinc"]),
        default="linear",
        show_default=True,
    ),
    cloup.option(
        "--method",
        type=click.Choice(["auto", "space", "fourier", "slice"]),
        default="auto",
        show_default=True,
        help="The picture is the same; auto is the fastest.",
    ),
    cloup.option(
        "--aperture", type=float, help="Width of a round aperture; 1 is that of all views."
    ),
    cloup.option("--ring", type=float, help="Width of the middle that is covered."),
    cloup.option("--square", is_flag=True, default=None, help="A square aperture, no round one."),
    cloup.option(
        "--viewpoint",
        nargs=2,
        type=float,
        metavar="V U",
        help="Centre of the aperture, rows and columns of views from the middle one.",
    ),
    cloup.option("--f-number", type=float, help="Of a round aperture; needs --camera."),
    cloup.option("--gain", type=float, help="The pictures so many times as bright."),
    cloup.option("--gamma", type=float, help="Of the pictures; 2.2 shows more in the dark."),
    cloup.option("--movie", type=click.Choice(["gif", "mp4"]), default="gif", show_default=True),
    cloup.option(
        "--network",
        type=UsablePath(exists=True, path_type=Path),
        help="Refocus with this run of train-system, from its few views, or with RefocusNet by its "
        "authors' weights (.npz); --search looks at all views.",
    ),
)
"""Options that say how refocused images are made."""


def _refuse_options(what: str, **options: Any) -> None:
    for name, value in options.items():
        if value is not None:
            raise InputError(f"--{name.replace('_', '-')} does not apply to {what}.")


def open_network(path: Path | None):
    """Load a trained system; nothing where none is asked for."""
    if path is None:
        return None
    load_keras()
    from lf_flame.systems.training import load_system

    return load_system(path)


@dataclass(frozen=True)
class Reading:
    """How a light field is to be read; the options of the group of that name."""

    views: int | None = None
    order: str | None = None
    white: Path | None = None
    pitch: float | None = None
    layout: str | None = None

    def given(self) -> dict[str, Any]:
        """Give the options that were given, paths as text."""
        options = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return {
            name: str(x) if isinstance(x, Path) else x
            for name, x in options.items()
            if x is not None
        }

    def read(self, source: Path) -> "LightField":
        """Read a light field of any kind, and tell what was found."""
        from tqdm import tqdm

        from lf_flame import formats

        if self.white is not None or self.pitch is not None:
            _refuse_options(f"the raw image {source}", order=self.order)
            light_field, grid = formats.read_raw(
                source, self.white, self.pitch, self.layout, self.views
            )
            click.echo(f"{source}: {grid.describe()}", err=True)
        elif source.is_dir():
            _refuse_options(f"the folder {source}", views=self.views, layout=self.layout)
            folder = formats.scan_view_folder(source, self.order)
            click.echo(folder.describe(), err=True)
            light_field = folder.read(lambda files: tqdm(files, "reading", unit="view"))
        else:
            _refuse_options(f"{source} without --white or --pitch", layout=self.layout)
            light_field = formats.read_light_field(source, self.views, self.order)
        v, u, t, s = light_field.views.shape[:4]
        click.echo(f"{v} x {u} views of {t} x {s} pixels", err=True)
        return light_field


@dataclass(frozen=True)
class Focus:
    """Where to focus; the options of the group of that name."""

    slopes: tuple[float, ...] = ()
    slope_of: str = "motion"
    depths: tuple[float, ...] = ()
    search: bool = False
    sweep: tuple[float, float] | None = None
    slope_map: tuple[float, float] | None = None
    map_auto: bool = False

    def with_ends(self, light_field: "LightField") -> "Focus":
        """Find the ends of the slope map, where they are to be found, and tell them."""
        if not self.map_auto:
            return self
        if self.slope_map:
            raise InputError("--map auto and --map FROM TO cannot both be given.")
        from lf_flame.refocus import find_slope_range

        found = find_slope_range(light_field)
        click.echo(f"slope map {found.describe()}", err=True)
        return replace(self, slope_map=(found.low, found.high))

    @property
    def searches(self) -> bool:
        """Whether the sharpest slope is to be found: if asked for, or if nothing else is."""
        return self.search or not (self.slopes or self.depths or self.sweep or self.maps)

    @property
    def maps(self) -> bool:
        """Whether a slope map is asked for."""
        return self.map_auto or self.slope_map is not None

    def asked_slopes(self, views: int, lens: "PlenopticCamera | None") -> list[float]:
        """Slopes of shift-and-sum for the numbers and depths that were given."""
        from lf_flame.optics.slope_conventions import to_slope

        slopes = [to_slope(slope, self.slope_of, views) for slope in self.slopes]
        if not self.depths:
            return slopes
        if lens is None:
            raise InputError("--depth-mm needs the camera: --camera FILE.")
        return slopes + [lens.depth_to_slope(depth) for depth in self.depths]


@dataclass(frozen=True)
class Appearance:
    """How images are made; the options of the group of that name."""

    interpolation: str = "linear"
    method: str = "auto"
    aperture: float | None = None
    ring: float | None = None
    square: bool | None = None
    viewpoint: tuple[float, float] | None = None
    f_number: float | None = None
    gain: float | None = None
    gamma: float | None = None
    movie: str = "gif"
    network: Path | None = None

    def refuse_for_network(self, slope_map: bool) -> None:
        """Refuse what a network cannot do: it has its own aperture, and interpolates linearly."""
        plain = Appearance()
        changed = {
            name: getattr(self, name)
            for name in (
                "interpolation",
                "method",
                "aperture",
                "ring",
                "square",
                "viewpoint",
                "f_number",
            )
            if getattr(self, name) != getattr(plain, name)
        }
        _refuse_options("a network", **changed, map=slope_map or None)

    def options(self, views: tuple[int, int], lens: "PlenopticCamera | None") -> dict[str, Any]:
        """Give `interpolation`, `method` and `weights` of `lf_flame.refocus.refocus`."""
        from lf_flame.commands.refocus_job import Aperture

        aperture = Aperture(
            self.aperture, self.ring, bool(self.square), self.viewpoint, self.f_number
        )
        weights = aperture.weights(views, lens)
        return {"interpolation": self.interpolation, "method": self.method, "weights": weights}

    @property
    def brightness(self) -> dict[str, float]:
        """Give `gain` and `gamma` of `RefocusJob`, where they were asked for."""
        asked = {"gain": self.gain, "gamma": self.gamma}
        return {name: value for name, value in asked.items() if value is not None}


def _pick(kind, options: dict):
    """Make an options record of those of a command's options that belong to it."""
    return kind(**{name: options.pop(name) for name in kind.__dataclass_fields__})


class MapCommand(cloup.Command):
    """A command that takes `--map auto` beside `--map FROM TO`."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Make one word of the two that ask for a range to be found."""
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
@click.option("--out", type=FOLDER, help="Folder for the pictures; default refocused/SOURCE.")
def refocus(source, camera, out, **options):
    """Refocus a light field from anywhere; find its sharpest slope; sweep through its focus.

    SOURCE is a folder with one image per view (HCI, Stanford, row_col.png ...), an array
    (.npy, .npz), a TIFF of many pages, a lenslet image of N x N pixels to a lenslet (--views N;
    Lytro's ESLF is one), or a raw lenslet image (--white or --pitch).

    \b
      lf-flame refocus buddha                              at the sharpest slope
      lf-flame refocus buddha --slope 1.2 --slope -0.4     at these slopes
      lf-flame refocus buddha --sweep -1 2 --map auto      sweep.gif, slope map, all in focus
      lf-flame refocus raw.png --white white.png           any plenoptic camera
      lf-flame refocus light_field.npz --camera simulation.json --depth-mm 10
      lf-flame refocus buddha --slope 1 --network RUN      by a network, from nine of the views
    """  # noqa: D301 - click reads the backspace
    from lf_flame.commands.refocus_job import RefocusJob, check_job
    from lf_flame.commands.refocus_output import describe_job, picture_folder
    from lf_flame.formats.movie import check_movie
    from lf_flame.scenes.scene_files import read_camera

    focus, look, reading = (_pick(kind, options) for kind in (Focus, Appearance, Reading))
    lens = read_camera(camera) if camera else None
    if lens is None and (focus.depths or look.f_number is not None):
        raise InputError("--depth-mm and --f-number need the camera: --camera FILE.")
    check_movie(f"sweep.{look.movie}")
    if look.network:
        look.refuse_for_network(focus.maps)
    with picture_folder(_folder_for(source, out), source) as folder:
        network = open_network(look.network)
        light_field = reading.read(source)
        focus = focus.with_ends(light_field)
        views = light_field.views.shape[:2]
        slopes = focus.asked_slopes(views[1], lens)
        job = RefocusJob(light_field, look.options(views, lens), network, **look.brightness)
        check_job(job, slopes, focus.sweep or (), focus.slope_map or ())
        describe_job(job, folder)
        folder.facts["depths_mm"] = focus.depths
        if network:
            folder.facts["network"] = network.name
        _write_pictures(job, focus, slopes, f"sweep.{look.movie}", folder)
    click.echo(f"{', '.join(folder.files)} are in {folder.folder}")


def _write_pictures(job, focus: Focus, slopes: list[float], movie: str, folder) -> None:
    """Make all that was asked for, and the record."""
    from tqdm import tqdm

    from lf_flame.commands import refocus_output as output

    if focus.searches:
        found = output.write_search(job, folder)
        click.echo(f"sharpest at slope {found.slope:+.3f}, confidence {found.confidence:.2f}")
        slopes = [*slopes, found.slope]
    if slopes:
        output.write_refocused(job, slopes, folder)
    if focus.sweep:
        bar = partial(tqdm, desc="sweeping", unit="stack")
        output.write_sweep(job, focus.sweep, movie, folder, bar)
    if focus.slope_map:
        share = output.write_slope_map(job, focus.slope_map, folder)
        click.echo(f"slope map: {share:.0%} of the pixels are certain")


def _folder_for(source: Path, out: Path | None, ending: str = "") -> Path:
    """Choose where pictures go."""
    name = source.resolve().name if source.is_dir() else source.stem
    out = out or Path("refocused") / f"{name}{ending}"
    if out.resolve() == source.resolve():
        raise InputError(f"The pictures cannot go into the light field's own folder, {source}.")
    return out


def _refuse_other_network(path: Path | None, network) -> None:
    """Refuse a network that does not remove the ghosts of the cross."""
    if network is None:
        return
    from lf_flame.systems.sparse_unet import SparseUNet

    if not isinstance(network, SparseUNet):
        raise InputError(f"{path} holds {network.name}, not the network of `volumetric`.")


@cloup.command("refocus-regions")
@click.argument("source", type=PATH)
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
    type=UsablePath(exists=True, path_type=Path),
    help="Run of `train-system volumetric`, which removes the ghosts that the cross leaves.",
)
@READING
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
    if cross or network:
        load_keras()
    from lf_flame.commands.refocus_job import RefocusJob, check_job
    from lf_flame.commands.refocus_output import describe_job, picture_folder, write_regions
    from lf_flame.systems.region_refocus import refocus_regions

    with picture_folder(_folder_for(source, out, "-regions"), source) as folder:
        unet = open_network(network)
        _refuse_other_network(network, unet)
        dense = not (cross or unet)
        folder.facts |= {
            "slopes_searched": slopes,
            "background": slopes[0] if background is None else background,
            "views_used": "all" if dense else "a cross of 17",
            "network": unet.name if unet else None,
        }
        job = RefocusJob(Reading(**options).read(source))
        check_job(job, [*slopes, *([] if background is None else [background])])
        describe_job(job, folder)
        image, surface, found = refocus_regions(
            job.views_to_white, regions, slopes, background, dense, unet
        )
        for region, (slope, trust) in zip(regions, found, strict=True):
            sure = f"{trust:.0%} of its pixels are certain" if dense else f"MS-SSIM {trust:.3f}"
            click.echo(f"region {' '.join(map(str, region))}: slope {slope:+.2f}, {sure}")
        measure = "certain" if dense else "ms_ssim"
        facts = [{"slope": slope, measure: trust} for slope, trust in found]
        write_regions(job, image, surface, regions, facts, folder)
    click.echo(f"{', '.join(folder.files)} are in {folder.folder}")


@cloup.command()
@click.argument("source", type=PATH)
@click.argument("target", type=PATH)
@READING
@click.option("--bits", type=click.Choice(["8", "16"]), default="16", show_default=True)
def convert(source: Path, target: Path, bits: str, **options) -> None:
    """Write a light field from anywhere in another form.

    SOURCE is read as by `lf-flame refocus`. TARGET is a new folder (one PNG for each view), a
    .png or .tif file (a lenslet image, N x N pixels to a lenslet) or .npy (views[v, u, t, s]).

    \b
      lf-flame convert raw.png views --white white.png     decode a plenoptic camera's image
      lf-flame convert views lenslets.png                  for programs that read lenslet images
    """  # noqa: D301 - click reads the backspace
    from lf_flame._common.locks import exclusive
    from lf_flame.formats import write_light_field

    reading = Reading(**options)
    if target.resolve() in {path.resolve() for path in (source, reading.white) if path}:
        raise InputError(f"{target} is read, and cannot be replaced; name another file.")
    with exclusive(target):
        write_light_field(reading.read(source), target, int(bits))
    click.echo(f"{target} is written")
