"""Content of a viewer: coded views in pieces, a slope map, and the metadata of its page."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from lf_flame.calibration.camera_law import CameraLaw
from lf_flame.errors import InputError
from lf_flame.formats.images import to_preview
from lf_flame.lightfield import LightField, refuse_placed
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.refocus import (
    FocusMap,
    SlopeRange,
    all_in_focus,
    farthest_slope,
    find_slope_range,
)
from lf_flame.refocus.focus_map import MAP_STEPS, TRUSTED
from lf_flame.refocus.interpolation import INTERPOLATIONS, check_interpolation
from lf_flame.viewer.coded_views import (
    DARKEST,
    MOST_BYTES,
    CodedViews,
    check_channels,
    cut_into_pieces,
    encode_views,
    shown_white,
)
from lf_flame.viewer.planes import PlaneMaker


@dataclass(frozen=True, eq=False)
class Exhibit:
    """A light field to show, with the options of its viewer.

    Attributes
    ----------
    light_field : LightField
        Light field to show.
    title : str
        Title of the page.
    slopes : (float, float)
        Ends of the slider, the lower one first.
    slope : float
        Initial slope.
    camera : PlenopticCamera or CameraLaw, optional
        Camera for depths in mm and f-numbers.
    source : str, optional
        Path in a copied command; without it no command is offered.
    reading : mapping, optional
        Options for reading the source: views, order, white, pitch, dark and so on.
    with_map : bool, optional
        Whether there is a slope map.
    interpolation : {"linear", "nearest", "cubic", "sinc"}
        Interpolation. Pages sum views linearly; with another one the program refocuses for them.
    network : lf_flame.systems.base.RefocusingSystem, optional
        System that refocuses instead.
    network_source : str, optional
        Path of the network in a copied command.
    most_bytes : int
        Largest size of a page's views in bytes; for a larger light field the program refocuses.
    depths_mm : sequence of float, optional
        Depths of planes that stand in the place of views, shape (1, planes, t, s): the slider moves
        through them, `slopes` and `slope` are depths in mm, and there is no slope map.

    Raises
    ------
    InputError
        If planes are not as many as their depths, rising and two or more, or too large for a page;
        if the slopes are not two finite numbers that rise, or shift a view by more than the image;
        if the light field is neither grey nor of three channels, or its views are not the
        camera's; if the interpolation is unknown, or the network cannot take the light field or
        the slopes.
    """

    light_field: LightField
    title: str
    slopes: tuple[float, float]
    slope: float
    camera: PlenopticCamera | CameraLaw | None = None
    source: str | None = None
    reading: Mapping[str, Any] = field(default_factory=dict)
    with_map: bool = True
    interpolation: str = "linear"
    network: Any = None
    network_source: str | None = None
    most_bytes: int = MOST_BYTES
    depths_mm: Sequence[float] | None = None

    def __post_init__(self):
        refuse_placed(self.light_field, "A viewer")
        check_channels(self.light_field)
        if self.depths_mm is not None:
            self._check_planes(self.depths_mm)
            return
        if self.camera is not None:
            self.camera.check_views(self.light_field.views.shape)
        check_interpolation(self.interpolation, (*INTERPOLATIONS, "sinc"))
        limit = farthest_slope(self.light_field.views)
        if not -limit <= self.slopes[0] < self.slopes[1] <= limit:
            raise InputError(
                f"A viewer needs two slopes, the lower one first, from {-limit:g} to {limit:g}, "
                f"got {self.slopes[0]:g} and {self.slopes[1]:g}."
            )
        if self.network is not None:
            if self.interpolation != "linear":
                raise InputError("An interpolation does not apply to a network.")
            self.network.check(self.light_field, self.slopes)

    def _check_planes(self, depths_mm: Sequence[float]) -> None:
        shape = self.light_field.views.shape
        if shape[:2] != (1, len(depths_mm)) or len(depths_mm) < 2 or min(np.diff(depths_mm)) <= 0:
            raise InputError(
                f"A stack of planes needs two or more, and a depth for each, rising; got "
                f"{shape[:2]} planes and depths {list(depths_mm)}."
            )
        if self.light_field.views.size > self.most_bytes:
            raise InputError(
                f"A page holds {self.most_bytes:,} cells at most, but these planes have "
                f"{self.light_field.views.size:,}."
            )

    @cached_property
    def coded(self) -> CodedViews:
        """Views as codes."""
        return encode_views(self.light_field, self.most_bytes, white=self.white)

    @property
    def why_planes(self) -> str:
        """Reason why the program refocuses instead of the page; empty if the page sums views."""
        if self.network is not None:
            return f"refocused by {self.network.name}"
        if self.interpolation != "linear":
            return f"{self.interpolation} interpolation"
        if self.light_field.views.size > self.most_bytes:
            return "too large for a page, which asks for each picture"
        return ""

    @cached_property
    def planes(self) -> PlaneMaker:
        """Maker of refocused images, for pages that do not sum views."""
        return PlaneMaker(self.light_field, self.slopes, self.interpolation, self.network)

    @cached_property
    def white(self) -> float:
        """Radiance that is shown as white."""
        if self.depths_mm is None:
            return shown_white(self.light_field)
        return max(float(self.light_field.views.max()), DARKEST)

    @cached_property
    def focus_map(self) -> FocusMap:
        """Slope of each pixel, searched over the slider's range."""
        return all_in_focus(self.light_field, np.linspace(*self.slopes, MAP_STEPS))

    def map_bytes(self) -> bytes:
        """Slope map in the form that pages read.

        It is slopes in float32, certainty in uint8, each of shape (t, s), and the image with
        everything in focus in uint8, shape (t, s, channels), little-endian, one after the other.
        """
        found = self.focus_map
        certain = (found.confidence >= TRUSTED).astype(np.uint8)
        image = to_preview(found.all_in_focus, self.white)
        return b"".join(x.tobytes() for x in (found.slope.astype("<f4"), certain, image))

    def describe(self, coded: CodedViews, pieces: Sequence[tuple[int, int]], coding: str) -> dict:
        """Metadata for a page that receives views.

        Parameters
        ----------
        coded : CodedViews
            Views that the page receives, perhaps fewer or coarser than the exhibit's own.
        pieces : sequence of (int, int)
            First view and number of views of each piece, in the order in which they are sent.
        coding : {"served", "deflate", "jpeg"}
            Form in which the pieces are sent.
        """
        views, size = coded.codes.shape[:2], coded.codes.shape[2:4]
        return self._describe(views, size, coded.codes.shape[4]) | {
            "weights": coded.weights.ravel().tolist(),
            "positions": [list(map(float, at)) for at in coded.positions],
            "levels": coded.levels,
            "low": coded.low,
            "high": coded.high,
            "white": coded.white,
            "pieces": [list(piece) for piece in pieces],
            "coding": coding,
        }

    def describe_served(self) -> dict:
        """Metadata for a page that a program serves, with views or with refocused images."""
        if not self.why_planes:
            return self.describe(self.coded, cut_into_pieces(self.coded), "served")
        shape = self.light_field.views.shape
        return self._describe(shape[:2], shape[2:4], self.planes.channels) | {
            "levels": 1,
            "low": 0.0,
            "high": 1.0,
            "white": self.white,
            "pieces": [],
            "coding": "planes",
            "coarse": self.planes.coarse,
            "own_aperture": self.network is not None,
        }

    def _describe(self, views: tuple, size: tuple, channels: int) -> dict:
        """Metadata that do not depend on how a page receives its data."""
        making = {"network": self.network_source, "interpolation": self.interpolation}
        return {
            "title": self.title,
            "views": list(views),
            "size": list(size),
            "channels": channels,
            "slopes": list(map(float, self.slopes)),
            "slope": float(self.slope),
            "map_steps": MAP_STEPS,
            "camera": _describe_camera(self.camera),
            "source": self.source,
            "reading": dict(self.reading),
            "making": {name: x for name, x in making.items() if x not in (None, "linear")},
            "has_map": self.with_map,
            "depths_mm": None if self.depths_mm is None else list(map(float, self.depths_mm)),
            "colours": "grey" if self.depths_mm is None else "inferno",
        }


def choose_slopes(
    light_field: LightField, slopes: tuple[float, float] | None, network: Any = None
) -> SlopeRange:
    """Choose the ends of the slider and its initial position: as given, or from the light field.

    A range from the light field is cut to the slopes that a network accepts.
    """
    if slopes is not None:
        return SlopeRange(*slopes, sum(slopes) / 2, certain=True)
    found = find_slope_range(light_field)
    if network is None:
        return found
    can = network.slope_range(*light_field.views.shape[:2])
    low, high, slope = (float(np.clip(x, *can)) for x in (found.low, found.high, found.slope))
    return SlopeRange(low, high, slope, found.certain)


def _describe_camera(camera: PlenopticCamera | CameraLaw | None) -> dict[str, Any] | None:
    """Camera's numbers for ``depth = focus_distance shift / (1 - shift)``, and its f-number.

    The depth is that of `PlenopticCamera.slope_to_depth`. The f-number is that of a round aperture
    as wide as all views (`f_number_aperture`), also for fewer views than the camera has.
    """
    if camera is None:
        return None
    if isinstance(camera, CameraLaw):  # its depths are from another zero, and it has no f-number
        return {
            "focus_distance_mm": camera.focus_distance_mm,
            "shift_per_slope": 1 / camera.slope_at_infinity,
            "f_number": None,
            "focal_plane_mm": camera.focal_plane_mm,
            "range_mm": list(camera.depth_range_mm),
        }
    return {
        "focus_distance_mm": camera.pupil_distance_mm,
        "shift_per_slope": 1 / float(camera.depth_to_slope(np.inf)),
        "f_number": camera.lenslet_focal_mm / (camera.views * camera.pixel_mm),
    }
