"""How a light field is read, where it is focused and how it looks: options, and what they ask for.

As in `lf_flame.commands.cli`, heavy modules are imported inside.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import cloup

from lf_flame._common import progress
from lf_flame._common.printable import printable
from lf_flame.commands.options import FILE, PATH, UsablePath
from lf_flame.errors import InputError
from lf_flame.learning.keras_loading import load_keras

if TYPE_CHECKING:
    from lf_flame.formats import LensletGrid
    from lf_flame.lightfield import LightField
    from lf_flame.optics.camera import PlenopticCamera

SLOPE_CONVENTIONS = (
    "motion", "hci", "lftoolbox", "liff", "plenopticam", "plenopticam-refined", "plenpy", "fdl"
)  # fmt: skip
"""Names in `lf_flame.optics.slope_conventions`, whose import would take long for ``--help``."""

READING = cloup.option_group(
    "How the light field is read",
    cloup.option(
        "--views",
        type=int,
        help="Pixels under a lenslet, of a lenslet image or raw (default: the camera's).",
    ),
    cloup.option("--order", help="What the names of views count, as row,col (default: found)."),
    cloup.option("--grid", help="Rows x columns that a running number of views counts, as 1x9."),
    cloup.option("--axes", help="What the axes of an array are, as vuts, tsvu or ntsc."),
    cloup.option("--white", type=FILE, help="White image, to decode a raw lenslet image."),
    cloup.option(
        "--dark",
        type=PATH,
        help="The same without light, in the form of SOURCE; subtracted from it and from --white.",
    ),
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
    grid: str | None = None
    axes: str | None = None
    white: Path | None = None
    pitch: float | None = None
    layout: str | None = None
    dark: Path | None = None

    def for_camera(self, source: Path, lens: "PlenopticCamera | None") -> "Reading":
        """Take the count of views from a camera, unless it was given or files of views tell it."""
        if lens is None or self.views is not None or source.is_dir():
            return self
        return replace(self, views=lens.views)

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
        from lf_flame.formats.reading import subtract_dark

        if self.white is not None or self.pitch is not None:
            _refuse_options(
                f"the raw image {source}", order=self.order, grid=self.grid, axes=self.axes
            )
            with progress.stage(f"Reading {printable(source)}"):
                light_field, grid = formats.read_raw(
                    source, self.white, self.pitch, self.layout, self.views, dark=self.dark
                )
            click.echo(f"{printable(source)}: {self.describe_grid(grid)}", err=True)
        elif source.is_dir():
            _refuse_options(
                f"the folder {source}", views=self.views, layout=self.layout, axes=self.axes
            )
            folder = formats.scan_view_folder(source, self.order, grid=self.grid)
            click.echo(folder.describe(), err=True)
            light_field = folder.read(lambda files: tqdm(files, "reading", unit="view"))
            light_field = subtract_dark(
                light_field, self.dark, order=folder.found.order, grid=folder.counted
            )
        else:
            _refuse_options(f"{source} without --white or --pitch", layout=self.layout)
            light_field = formats.read_light_field(
                source, self.views, self.order, grid=self.grid, axes=self.axes, dark=self.dark
            )
        v, u, t, s = light_field.views.shape[:4]
        click.echo(f"{v} x {u} views of {t} x {s} pixels", err=True)
        if light_field.uncounted:
            click.echo(light_field.uncounted, err=True)
        return light_field

    def describe_grid(self, grid: "LensletGrid") -> str:
        """Tell which lenslets a raw image has, and what was not looked for."""
        if self.white is not None:
            return grid.describe()
        return (
            f"{grid.describe()}; the pitch is as stated, and neither the rotation nor the place of "
            f"the array was looked for, which takes a white image (--white)"
        )

    @property
    def files(self) -> tuple[Path, ...]:
        """Files that are read beside the source."""
        return tuple(path for path in (self.white, self.dark) if path is not None)


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
        lens.check_depths(self.depths)
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
