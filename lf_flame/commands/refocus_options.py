"""Options for focusing a light field and making images of it, and classes that hold them.

As in `lf_flame.commands.cli`, heavy modules are imported inside.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import cloup

from lf_flame.commands.options import UsablePath, camera_option
from lf_flame.commands.reading_options import refuse_options
from lf_flame.errors import InputError
from lf_flame.learning.keras_loading import load_keras

if TYPE_CHECKING:
    import numpy as np

    from lf_flame.calibration import CameraLaw
    from lf_flame.lightfield import LightField
    from lf_flame.optics.camera import PlenopticCamera

SLOPE_CONVENTIONS = (
    "motion", "hci", "lftoolbox", "liff", "plenopticam", "plenopticam-refined", "plenpy", "fdl"
)  # fmt: skip
"""Names in `lf_flame.optics.slope_conventions`; importing it would make ``--help`` slow."""

SLOPES = cloup.option_group(
    "Where to focus",
    cloup.option(
        "--slope",
        "slopes",
        multiple=True,
        type=float,
        help="Slope to refocus at, in pixels of a view per step to the next view, positive behind "
        "the plane in focus; may be repeated.",
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
        "the slopes of the scene; auto finds such a range. Things that one sees through, such as a "
        "flame before others, have no one slope: lf-flame reconstruct finds emission by depth.",
    ),
    cloup.option("--map-auto", is_flag=True, hidden=True),
    cloup.option(
        "--region",
        "regions",
        nargs=4,
        type=int,
        multiple=True,
        metavar="T0 T1 S0 S1",
        help="Bring rows T0 to T1 - 1, columns S0 to S1 - 1 into focus at their own slope, and "
        "blur the rest; may be repeated. Where regions overlap, the last one counts.",
    ),
    cloup.option(
        "--background", type=float, help="Slope outside the regions (default: a blur of 8 pixels)."
    ),
    cloup.option("--cross", is_flag=True, help="Regions from a cross of 17 views; less exact."),
    camera_option(),
)
"""Options for the slopes to refocus at."""

APPEARANCE = cloup.option_group(
    "How the images are made",
    cloup.option(
        "--interpolation",
        type=click.Choice(["nearest", "linear", "cubic", "sinc"]),
        default="linear",
        show_default=True,
        help="Interpolation between the pixels of a view; sinc is exact where views hold no "
        "aliasing.",
    ),
    cloup.option(
        "--method",
        type=click.Choice(["auto", "space", "fourier", "slice"]),
        default="auto",
        show_default=True,
        help="How to compute; the picture is the same. auto is the fastest for some pictures; "
        "slice, with sinc, for a hundred.",
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
    cloup.option(
        "--gain", type=float, help="Factor on the brightness of the pictures (default: 1)."
    ),
    cloup.option(
        "--gamma",
        type=float,
        help="Gamma of the pictures; 2.2 brightens dark regions (default: 1).",
    ),
    cloup.option(
        "--movie",
        type=click.Choice(["gif", "mp4"]),
        default="gif",
        show_default=True,
        help="Format of the movie of --sweep.",
    ),
    cloup.option(
        "--network",
        type=UsablePath(exists=True, path_type=Path),
        help="Refocus with this run of train-system, which uses a few views, or with RefocusNet by "
        "its authors' weights (.npz). --search still uses all views. --region takes a run of "
        "`train-system volumetric`, which removes the ghosts of the cross.",
    ),
)
"""Options for how refocused images are made."""


def open_network(path: Path | None):
    """Load a trained system; None without a path."""
    if path is None:
        return None
    load_keras()
    from lf_flame.systems.training import load_system

    return load_system(path)


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
    cross: bool = False

    def __post_init__(self):
        if not self.regions and (self.cross or self.background is not None):
            raise InputError("--background and --cross need --region.")

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
    def name(self) -> str:
        """Name of what is requested, so that calls for other slopes get other default folders."""
        asked = {
            "slope": self.slopes, "depth": self.depths, "sweep": self.sweep, "map": self.slope_map
        }  # fmt: skip
        words = [name + "".join(f"{x:+g}" for x in some) for name, some in asked.items() if some]
        return "_".join(["", *words, *(["map"] if self.map_auto else []),
                         *(["regions"] if self.regions else [])])[:80]  # fmt: skip

    @property
    def searches(self) -> bool:
        """Whether to find the sharpest slope: if requested, or if nothing else is."""
        others = self.slopes or self.depths or self.sweep or self.maps or self.regions
        return self.search or not others

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
        plain, others = Appearance(), ("gain", "gamma", "movie", "network")
        changed = {
            name: getattr(self, name)
            for name in self.__dataclass_fields__
            if name not in others and getattr(self, name) != getattr(plain, name)
        }
        refuse_options("a network", **changed, map=slope_map or None)

    def options(
        self, views: tuple[int, int], lens: "PlenopticCamera | CameraLaw | None"
    ) -> dict[str, Any]:
        """Give `interpolation`, `method` and `weights` of `lf_flame.refocus.refocus`."""
        weights = self._weights(views, lens)
        return {"interpolation": self.interpolation, "method": self.method, "weights": weights}

    def _weights(
        self, views: tuple[int, int], lens: "PlenopticCamera | CameraLaw | None"
    ) -> "np.ndarray | None":
        """Give the weights of views, shape (v, u), or None if all views count alike."""
        from lf_flame.calibration import CameraLaw
        from lf_flame.refocus import aperture_weights, f_number_aperture

        stated = (self.aperture, self.ring, self.square, self.viewpoint) != (None,) * 4
        if self.f_number is None:
            if not stated:
                return None
            return aperture_weights(
                views,
                1.0 if self.aperture is None else self.aperture,
                self.ring or 0.0,
                "square" if self.square else "round",
                self.viewpoint or (0.0, 0.0),
            )
        if stated:
            raise InputError("An f-number and another aperture cannot both be given.")
        if isinstance(lens, CameraLaw):
            raise InputError(
                "An f-number needs the thin-lens camera: camera.toml, which `lf-flame calibrate "
                "--lenslet-mm` writes; --aperture needs none."
            )
        assert lens is not None  # or the command has refused the f-number
        return f_number_aperture(lens, self.f_number)

    @property
    def brightness(self) -> dict[str, float]:
        """The `gain` and `gamma` of `RefocusJob` that were given."""
        asked = {"gain": self.gain, "gamma": self.gamma}
        return {name: value for name, value in asked.items() if value is not None}
