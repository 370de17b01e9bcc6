"""The command that refocuses a light field: refocus.

As in `lf_flame.commands.cli`, heavy modules are imported inside.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import cloup

from lf_flame.commands.options import (
    ABOVE_0,
    EXISTING,
    PATH,
    Command,
    camera_option,
    command,
    flag,
    open_lens,
    option,
    out_options,
    pick,
    print_files,
    result_name,
)
from lf_flame.commands.reading_options import READING, Reading
from lf_flame.errors import InputError
from lf_flame.learning.keras_loading import load_keras

if TYPE_CHECKING:
    import numpy as np

    from lf_flame.lightfield import LightField
    from lf_flame.optics.lens import Lens

SLOPE_CONVENTIONS = (
    "motion", "hci", "lftoolbox", "liff", "plenopticam", "plenopticam-refined", "plenpy", "fdl"
)  # fmt: skip
"""Names in `lf_flame.optics.slope_conventions`; importing it would make ``--help`` slow."""

SLOPES = cloup.option_group(
    "Where to focus",
    option(
        "--slope slopes",
        "Slope in pixels per view step, positive behind the focus.",
        float,
        multiple=True,
    ),
    option("--depth-mm depths", "Depth in mm, from the camera file's zero; needs --camera.", float,
           multiple=True),
    flag("--search", "The sharpest slope; the default."),
    option("--sweep", "Movie from slope to slope (GIF).", float, nargs=2, metavar="FROM TO"),
    option(
        "--map slope_map",
        "Slope of each pixel, and an image all in focus.",
        float,
        nargs=2,
        metavar="FROM TO | auto",
    ),
    cloup.option("--map-auto", is_flag=True, hidden=True),
    option(
        "--region regions",
        "Rows T0 to T1 - 1, columns S0 to S1 - 1 in focus.",
        int,
        nargs=4,
        multiple=True,
        metavar="T0 T1 S0 S1",
    ),
    option("--background", "Slope outside the regions (default: blurred by 8 pixels).", float,
           rare=True),
    camera_option(),
    option(
        "--slope-of",
        "Convention of --slope. All output uses motion.",
        click.Choice(SLOPE_CONVENTIONS, case_sensitive=False),
        default="motion",
        rare=True,
    ),
)  # fmt: skip
"""Options for the slopes to refocus at."""

APPEARANCE = cloup.option_group(
    "How the images are made",
    option(
        "--interpolation",
        "Between pixels of a view; sinc is exact where views contain no aliasing.",
        click.Choice(["nearest", "linear", "cubic", "sinc"]),
        default="linear",
        rare=True,
    ),
    option("--aperture", "Width of a round aperture; 1: full, 1.42: corners too.", float),
    option("--f-number", "Working f-number of the aperture; needs --camera.", float),
    option("--ring", "Width of a central stop, in the same unit as --aperture.", float, rare=True),
    flag("--square", "Square aperture, not a round one.", rare=True),
    option(
        "--viewpoint",
        "Centre of the aperture, in views from the central view.",
        float,
        nargs=2,
        metavar="V U",
        rare=True,
    ),
    option("--gain", "Factor on the brightness of pictures.", ABOVE_0, default=1.0),
    option(
        "--gamma", "Gamma of pictures; 2.2 brightens dark regions.", ABOVE_0, default=1.0, rare=True
    ),
    option("--network", "Run of `train-system`, or RefocusNet's weights (.npz).", EXISTING),
)
"""Options for how refocused images are made."""


@dataclass(frozen=True)
class Focus:
    """Options of the group `SLOPES`: where to focus."""

    slopes: tuple[float, ...] = ()
    slope_of: str = "motion"
    depths: tuple[float, ...] = ()
    search: bool = False
    sweep: tuple[float, float] | None = None
    slope_map: tuple[float, float] | None = None
    map_auto: bool = False
    regions: tuple[tuple[int, int, int, int], ...] = ()
    background: float | None = None

    def with_ends(self, light_field: "LightField") -> "Focus":
        """Find the ends of the slope map if `map_auto` is set."""
        if not self.map_auto:
            return self
        from lf_flame.refocus import find_slope_range

        found = find_slope_range(light_field)
        if not found.certain:
            click.echo(f"slope map {found.describe()}", err=True)
        return replace(self, slope_map=(found.low, found.high))

    @property
    def name(self) -> str:
        """Name of what is requested, so that calls for other slopes get other default folders."""
        asked = {"slope": self.slopes, "depth": self.depths, "sweep": self.sweep,
                 "map": self.slope_map}  # fmt: skip
        words = [name + "".join(f"{x:+g}" for x in some) for name, some in asked.items() if some]
        words += ["map"] * self.map_auto + ["regions"] * bool(self.regions)
        return "_".join(["", *words])[:80]

    @property
    def searches(self) -> bool:
        """Whether to find the sharpest slope: if requested, or if nothing else is."""
        others = self.slopes or self.depths or self.sweep or self.maps or self.regions
        return self.search or not others

    @property
    def maps(self) -> bool:
        """Whether a slope map is requested."""
        return self.map_auto or self.slope_map is not None

    def find_slopes(self, views: int, lens: "Lens | None") -> list[float]:
        """Find the slopes of shift-and-sum for the given slopes and depths."""
        from lf_flame.optics.slope_conventions import to_slope

        slopes = [to_slope(slope, self.slope_of, views) for slope in self.slopes]
        if lens is None or not self.depths:
            return slopes
        lens.check_depths(self.depths)
        return slopes + [lens.depth_to_slope(depth) for depth in self.depths]

    def check(self, lens: "Lens | None", look: "Appearance") -> None:
        """Refuse options that exclude or need each other, before anything is read."""
        if self.background is not None and not self.regions:
            raise InputError("--background needs --region.")
        if self.slope_of != "motion" and not self.slopes:
            raise InputError("--slope-of needs --slope.")
        if self.map_auto and self.slope_map:
            raise InputError("--map auto and --map FROM TO cannot both be given.")
        if lens is None and (self.depths or look.f_number is not None):
            raise InputError("--depth-mm and --f-number need the camera: --camera FILE.")
        if look.interpolation == "sinc" and (self.maps or self.regions):
            raise InputError("--interpolation sinc does not apply to --map and --region.")
        if not look.network:
            return
        # A network has its own aperture, and interpolates linearly.
        names = ("aperture", "f_number", "ring", "square", "viewpoint", "interpolation")
        given = [one for one in names if getattr(look, one) != getattr(Appearance, one)]
        for name in (*given, *(["map"] if self.maps else [])):
            raise InputError(f"--{name.replace('_', '-')} does not apply to a network.")
        if self.regions and (self.slopes or self.depths or self.sweep or self.search):
            raise InputError(
                "--region with --network makes no other pictures: leave those out, or run twice."
            )


@dataclass(frozen=True)
class Appearance:
    """Options of the group `APPEARANCE`: how to make images."""

    interpolation: str = "linear"
    aperture: float | None = None
    f_number: float | None = None
    ring: float | None = None
    square: bool = False
    viewpoint: tuple[float, float] | None = None
    gain: float = 1.0
    gamma: float = 1.0
    network: Path | None = None

    def options(self, views: tuple[int, int], lens: "Lens | None") -> dict[str, Any]:
        """Find `interpolation` and `weights` of `lf_flame.refocus.refocus`."""
        return {"interpolation": self.interpolation, "weights": self._weights(views, lens)}

    def _weights(self, views: tuple[int, int], lens: "Lens | None") -> "np.ndarray | None":
        """Find the weights of views, shape (v, u), or None if all views have the same."""
        from lf_flame.optics.camera import PlenopticCamera
        from lf_flame.refocus import aperture_weights, f_number_aperture

        stated = (self.aperture, self.ring, self.square, self.viewpoint) != (
            None, None, False, None
        )  # fmt: skip
        if self.f_number is None:
            if not stated:
                return None
            width = 1.0 if self.aperture is None else self.aperture
            shape, centre = "square" if self.square else "round", self.viewpoint or (0.0, 0.0)
            return aperture_weights(views, width, self.ring or 0.0, shape, centre)
        if stated:
            raise InputError("An f-number and another aperture cannot both be given.")
        if not isinstance(lens, PlenopticCamera):
            raise InputError(
                "An f-number needs the thin-lens camera: camera.toml, which `lf-flame calibrate "
                "--lenslet-mm` writes; --aperture needs none."
            )
        return f_number_aperture(lens, self.f_number)

    def open_network(self, focus: Focus):
        """Load the trained system; None without one."""
        if self.network is None:
            return None
        load_keras()
        from lf_flame.systems.sparse_unet import SparseUNet
        from lf_flame.systems.training import load_system

        network = load_system(self.network)
        if focus.regions and type(network) is not SparseUNet:
            raise InputError(
                f"--region needs the network of `train-system volumetric`, got {network.name}."
            )
        return network


class MapCommand(Command):
    """A command that accepts `--map auto` besides `--map FROM TO`."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Join `--map auto` into one option."""
        joined: list[str] = []
        for word in args:
            if word == "auto" and joined[-1:] == ["--map"]:
                joined[-1] = "--map-auto"
            else:
                joined.append("--map-auto" if word == "--map=auto" else word)
        return super().parse_args(ctx, joined)


@command(cls=MapCommand)
@click.argument("source", type=PATH)
@SLOPES
@APPEARANCE
@READING
@out_options("refocused/SOURCE and the slopes")
def refocus(source, camera, out, overwrite, **options):
    """Refocus a light field of any kind; find its sharpest slope; sweep through its focus.

    \b
      lf-flame refocus buddha                              at the sharpest slope
      lf-flame refocus buddha --slope 1.2 --map auto       and slope map, all in focus
      lf-flame refocus raw.png --white white.png           any plenoptic camera
      lf-flame refocus field.npz --camera simulation.json --depth-mm 10
    \f

    SOURCE is a folder with one image for each view, an array (.npy, .npz, .h5, .mat), a TIFF of
    many pages, a lenslet image (--views N), a raw image (--white, --lenslets or --pitch), or a raw
    picture of a Lytro camera (.lfp, .lfr). `lf-flame info SOURCE` says what it is, and
    `lf-flame convert` reads other kinds.

    The range of --map should exceed the slopes of the scene; auto finds such a range. Transparent
    objects, such as flames, have no single slope: lf-flame reconstruct finds their emission by
    depth. --network refocuses from the few views that it was trained for; with
    --region it is a run of `train-system volumetric`.
    """  # noqa: D301 - click reads the backspace
    from lf_flame._common.atomic_files import output_folder, recorded_path
    from lf_flame.commands import refocus_output as output

    focus, look, reading = (pick(kind, options) for kind in (Focus, Appearance, Reading))
    lens = open_lens(camera)
    focus.check(lens, look)
    out = out or Path("refocused") / f"{result_name(source)}{focus.name}"
    with output_folder(out, output.RECORD, overwrite=overwrite) as folder:
        folder.facts["source"] = recorded_path(source, folder.folder)
        network = look.open_network(focus)
        reading = reading.for_camera(source, lens)
        light_field, lens = reading.read_of_camera(source, lens)
        folder.facts |= reading.facts()
        views = light_field.shape[:2]
        light_field = light_field if lens is None else lens.corrected(light_field)
        focus = focus.with_ends(light_field)
        slopes = focus.find_slopes(views[1], lens)
        options = look.options(views, lens)
        job = output.RefocusJob(light_field, options, network, lens, look.gain, look.gamma)
        beyond = () if focus.background is None else (focus.background,)
        job.check([*slopes, *beyond], focus.sweep or (), focus.slope_map or ())
        job.describe(folder)
        if focus.searches:
            slopes.append(output.write_search(job, folder))
        if slopes:
            output.write_refocused(job, slopes, folder)
        if focus.regions:
            output.write_regions(job, focus.regions, focus.background, folder)
        if focus.sweep:
            output.write_sweep(job, focus.sweep, folder)
        if focus.slope_map:
            output.write_slope_map(job, focus.slope_map, folder, focus.map_auto)
    print_files(folder)
