"""Options for reading a light field, focusing it and making images, and classes that hold them.

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
    from lf_flame.calibration import CameraLaw
    from lf_flame.formats import LensletGrid
    from lf_flame.lightfield import LightField
    from lf_flame.optics.camera import PlenopticCamera

SLOPE_CONVENTIONS = (
    "motion", "hci", "lftoolbox", "liff", "plenopticam", "plenopticam-refined", "plenpy", "fdl"
)  # fmt: skip
"""Names in `lf_flame.optics.slope_conventions`; importing it would make ``--help`` slow."""

READING = cloup.option_group(
    "How the light field is read",
    cloup.option(
        "--views",
        type=int,
        help="Number of pixels under a lenslet along each axis, in a lenslet image or raw image "
        "(default: by the camera).",
    ),
    cloup.option(
        "--order",
        help="Order in which views are counted (default: found by the parallax): row,col is row by "
        "row from the top left; -row from the bottom, -col from the right; snake,row,col runs "
        "every other row back.",
    ),
    cloup.option(
        "--grid",
        help="Rows x columns of views, as 1x9, if their names hold one running number or most are "
        "missing; what is missing gets weight 0.",
    ),
    cloup.option(
        "--mosaic", help="Rows x columns of views side by side in one picture SOURCE, as 8x8."
    ),
    cloup.option("--axes", help="Meaning of the axes of an array, as vuts, tsvu or ntsc."),
    cloup.option("--array", help="Name of the array, if SOURCE (.npz, .h5, .mat) holds several."),
    cloup.option(
        "--white",
        type=UsablePath(exists=True, path_type=Path),
        help="White image (flat field), to decode a raw lenslet image; for a Lytro picture also a "
        "folder of white images, or caldata-SERIAL.tar.",
    ),
    cloup.option(
        "--dark",
        type=PATH,
        help="Dark image, in the format of SOURCE; subtracted from SOURCE and from --white.",
    ),
    cloup.option("--pitch", type=float, help="Micro-image pitch of a raw image, in pixels."),
    cloup.option(
        "--layout",
        type=click.Choice(["rectangular", "hexagonal"]),
        help="Layout of the lenslets of a raw image (default: found in the white image).",
    ),
    cloup.option(
        "--bayer",
        type=click.Choice(["rggb", "bggr", "grbg", "gbrg"], case_sensitive=False),
        help="Colours of the upper left 2 x 2 pixels of a raw image of a colour sensor.",
    ),
)
"""Options for reading a light field."""

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
        help="Convention of --slope. All output uses motion.",
    ),
    cloup.option(
        "--depth-mm",
        "depths",
        multiple=True,
        type=float,
        help="Depth to refocus at, in mm from the focal plane, or from the zero of a calibration; "
        "may be repeated; needs --camera.",
    ),
    cloup.option(
        "--search",
        is_flag=True,
        help="Refocus at the sharpest slope; the default if no slope is given.",
    ),
    cloup.option(
        "--sweep",
        nargs=2,
        type=float,
        metavar="FROM TO",
        help="Movie from one slope to another and back, in 41 steps.",
    ),
    cloup.option(
        "--map",
        "slope_map",
        nargs=2,
        type=float,
        metavar="FROM TO | auto",
        help="Map of the slope of each pixel, and the image all in focus. The range should exceed "
        "the slopes of the scene; auto finds such a range.",
    ),
    cloup.option("--map-auto", is_flag=True, hidden=True),
    cloup.option(
        "--camera",
        type=FILE,
        help="Calibration by `lf-flame calibrate`, TOML file with a [camera] table, or "
        "simulation.json.",
    ),
)
"""Options for the slopes to refocus at."""

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
        help="How to compute; the picture is the same. auto is the fastest.",
    ),
    cloup.option(
        "--aperture", type=float, help="Width of a round aperture; 1 is that of all views."
    ),
    cloup.option(
        "--ring", type=float, help="Width of a covered disc in the middle of the aperture."
    ),
    cloup.option("--square", is_flag=True, default=None, help="Square aperture, not a round one."),
    cloup.option(
        "--viewpoint",
        nargs=2,
        type=float,
        metavar="V U",
        help="Centre of the aperture, in rows and columns of views from the central view.",
    ),
    cloup.option("--f-number", type=float, help="F-number of a round aperture; needs --camera."),
    cloup.option("--gain", type=float, help="Factor on the brightness of the pictures."),
    cloup.option("--gamma", type=float, help="Gamma of the pictures; 2.2 brightens dark regions."),
    cloup.option("--movie", type=click.Choice(["gif", "mp4"]), default="gif", show_default=True),
    cloup.option(
        "--network",
        type=UsablePath(exists=True, path_type=Path),
        help="Refocus with this run of train-system, which uses a few views, or with RefocusNet by "
        "its authors' weights (.npz). --search still uses all views.",
    ),
)
"""Options for how refocused images are made."""


def _refuse_options(what: str, **options: Any) -> None:
    for name, value in options.items():
        if value is not None:
            raise InputError(f"--{name.replace('_', '-')} does not apply to {what}.")


def open_network(path: Path | None):
    """Load a trained system; None without a path."""
    if path is None:
        return None
    load_keras()
    from lf_flame.systems.training import load_system

    return load_system(path)


@dataclass(frozen=True)
class Reading:
    """Options of the group `READING`: how to read a light field."""

    views: int | None = None
    order: str | None = None
    grid: str | None = None
    mosaic: str | None = None
    axes: str | None = None
    array: str | None = None
    white: Path | None = None
    pitch: float | None = None
    layout: str | None = None
    dark: Path | None = None
    bayer: str | None = None

    def for_camera(self, source: Path, lens: "PlenopticCamera | CameraLaw | None") -> "Reading":
        """Take the number of views from a camera, if the source is a raw or a lenslet image."""
        from lf_flame.formats.view_files.sources import is_view_folder

        stated = self.views is not None or self.mosaic is not None
        if lens is None or stated or is_view_folder(source):
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

    def stored(self) -> dict[str, Any]:
        """Give the arguments of `read_light_field`."""
        names = ("views", "order", "grid", "mosaic", "axes", "array", "dark")
        return {name: getattr(self, name) for name in names}

    def read(self, source: Path) -> "LightField":
        """Read a light field of any kind, and print what was found."""
        from tqdm import tqdm

        from lf_flame import formats
        from lf_flame.formats.coding import notes_on_values
        from lf_flame.formats.reading import subtract_dark
        from lf_flame.formats.view_files.sources import is_view_folder

        if self.white is not None or self.pitch is not None:
            _refuse_options(
                f"the raw image {source}", order=self.order, grid=self.grid, axes=self.axes,
                mosaic=self.mosaic, array=self.array,
            )  # fmt: skip
            with progress.stage(f"Reading {printable(source)}"):
                light_field, grid = formats.read_raw(
                    source,
                    self.white,
                    self.pitch,
                    self.layout,
                    self.views,
                    dark=self.dark,
                    bayer=self.bayer,
                )
            click.echo(f"{printable(source)}: {self.describe_grid(grid)}", err=True)
        elif is_view_folder(source):
            _refuse_options(
                f"the folder {source}", views=self.views, layout=self.layout, axes=self.axes,
                bayer=self.bayer, mosaic=self.mosaic, array=self.array,
            )  # fmt: skip
            folder = formats.scan_view_folder(source, self.order, grid=self.grid)
            click.echo(folder.describe(), err=True)
            light_field = folder.read(lambda files: tqdm(files, "reading", unit="view"))
            light_field = subtract_dark(
                light_field, self.dark, order=folder.found.order, grid=folder.counted
            )
        else:
            _refuse_options(
                f"{source} without --white or --pitch", layout=self.layout, bayer=self.bayer
            )
            if self.mosaic is not None:
                _refuse_options("a mosaic of views", views=self.views)
            light_field = formats.read_light_field(source, **self.stored())
        v, u, t, s = light_field.views.shape[:4]
        click.echo(f"{v} x {u} views of {t} x {s} pixels", err=True)
        for note in (light_field.uncounted, *notes_on_values(light_field, source)):
            if note:
                click.echo(note, err=True)
        return light_field

    def describe_grid(self, grid: "LensletGrid") -> str:
        """Describe the lenslets of a raw image, and what was not searched for."""
        if self.white is not None:
            return grid.describe()
        return (
            f"{grid.describe()}; the pitch is as given. The rotation and the position of the array "
            f"were not searched for: that needs a white image (--white)"
        )

    @property
    def files(self) -> tuple[Path, ...]:
        """Files that are read beside the source."""
        return tuple(path for path in (self.white, self.dark) if path is not None)


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

    def with_ends(self, light_field: "LightField") -> "Focus":
        """Find the ends of the slope map if `map_auto` is set, and print them."""
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
        """Whether to find the sharpest slope: if requested, or if nothing else is."""
        return self.search or not (self.slopes or self.depths or self.sweep or self.maps)

    @property
    def maps(self) -> bool:
        """Whether a slope map is requested."""
        return self.map_auto or self.slope_map is not None

    def asked_slopes(self, views: int, lens: "PlenopticCamera | CameraLaw | None") -> list[float]:
        """Give the slopes of shift-and-sum for the given slopes and depths."""
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
    """Options of the group `APPEARANCE`: how to make images."""

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

    def options(
        self, views: tuple[int, int], lens: "PlenopticCamera | CameraLaw | None"
    ) -> dict[str, Any]:
        """Give `interpolation`, `method` and `weights` of `lf_flame.refocus.refocus`."""
        from lf_flame.commands.refocus_job import Aperture

        aperture = Aperture(
            self.aperture, self.ring, bool(self.square), self.viewpoint, self.f_number
        )
        weights = aperture.weights(views, lens)
        return {"interpolation": self.interpolation, "method": self.method, "weights": weights}

    @property
    def brightness(self) -> dict[str, float]:
        """The `gain` and `gamma` of `RefocusJob` that were given."""
        asked = {"gain": self.gain, "gamma": self.gamma}
        return {name: value for name, value in asked.items() if value is not None}
