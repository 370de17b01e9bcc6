"""Content of a viewer: coded views in pieces, a slope map, and the metadata of its page."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from threading import Lock
from typing import Any

import numpy as np

from lf_flame.calibration.camera_law import CameraLaw
from lf_flame.errors import InputError
from lf_flame.formats.images import to_preview
from lf_flame.lightfield import LightField
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.refocus import FocusMap, SlopeRange, all_in_focus, farthest_slope, find_slope_range
from lf_flame.refocus.focus_map import MAP_STEPS, TRUSTED
from lf_flame.viewer.coded_views import (
    DARKEST,
    CodedViews,
    check_shown,
    cut_into_pieces,
    encode_views,
    piece_bytes,
    shown_white,
)


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
        Options for reading the source: views, order, white, pitch, dark and so on; and the file of
        its camera, by which the light field was corrected.
    with_map : bool, optional
        Whether there is a slope map.
    depths_mm : sequence of float, optional
        Depths of planes that take the place of views, shape (1, planes, t, s): the slider moves
        through them, `slopes` and `slope` are depths in mm, and there is no slope map.

    Raises
    ------
    InputError
        If planes are not as many as their depths, increasing and two or more, or too large for a
        page; if the slopes are not two increasing finite numbers, or shift a view by more than the
        image; if the light field is neither grey nor of three channels, has more pixels than a page
        contains, or its views are not the camera's.
    """

    light_field: LightField
    title: str
    slopes: tuple[float, float]
    slope: float
    camera: PlenopticCamera | CameraLaw | None = None
    source: str | None = None
    reading: Mapping[str, Any] = field(default_factory=dict)
    with_map: bool = True
    depths_mm: Sequence[float] | None = None

    def __post_init__(self):
        check_shown(self.light_field)
        if self.depths_mm is not None:
            self._check_planes(self.depths_mm)
            return
        if self.camera is not None:
            self.camera.check_views(self.light_field.views.shape)
        limit = farthest_slope(self.light_field.views)
        if not -limit <= self.slopes[0] < self.slopes[1] <= limit:
            raise InputError(
                f"A viewer needs two slopes, the lower one first, from {-limit:g} to {limit:g}, "
                f"got {self.slopes[0]:g} and {self.slopes[1]:g}."
            )

    def _check_planes(self, depths_mm: Sequence[float]) -> None:
        shape = self.light_field.views.shape
        if shape[:2] != (1, len(depths_mm)) or len(depths_mm) < 2 or min(np.diff(depths_mm)) <= 0:
            raise InputError(
                f"A stack of planes needs two or more, and a depth for each, increasing; got "
                f"{shape[:2]} planes and depths {list(depths_mm)}."
            )

    @cached_property
    def coded(self) -> CodedViews:
        """Views as codes."""
        return encode_views(self.light_field, white=self.white)

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

    def data(self) -> dict[str, Callable[[], bytes]]:
        """Return the data that a page requests, by name: pieces of views, and the slope map."""
        lock = Lock()

        def slope_map() -> bytes:
            with lock:  # computed once, however many pages request it
                return self.map_bytes()

        found = {
            f"views/{number}": partial(lambda piece: piece_bytes(self.coded, piece), piece)
            for number, piece in enumerate(cut_into_pieces(self.coded))
        }
        return found | ({"map": slope_map} if self.with_map else {})

    def describe(self, coded: CodedViews, pieces: Sequence[tuple[int, int]], coding: str) -> dict:
        """Metadata for a page, which receives coded views in pieces, perhaps fewer or coarser.

        The pieces are "served", or stored by "deflate" or as "jpeg".
        """
        return {
            "title": self.title,
            "views": list(coded.codes.shape[:2]),
            "size": list(coded.codes.shape[2:4]),
            "channels": coded.codes.shape[4],
            "slopes": list(map(float, self.slopes)),
            "slope": float(self.slope),
            "map_steps": MAP_STEPS,
            "camera": _describe_camera(self.camera),
            "source": self.source,
            "reading": dict(self.reading),
            "has_map": self.with_map,
            "depths_mm": None if self.depths_mm is None else list(map(float, self.depths_mm)),
            "colours": "grey" if self.depths_mm is None else "inferno",
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
        """Metadata for a page that a program serves."""
        return self.describe(self.coded, cut_into_pieces(self.coded), "served")


def choose_slopes(light_field: LightField, slopes: tuple[float, float] | None) -> SlopeRange:
    """Choose the ends of the slider and its initial position: as given, or from the light field."""
    if slopes is not None:
        return SlopeRange(*slopes, sum(slopes) / 2)
    return find_slope_range(light_field)


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
