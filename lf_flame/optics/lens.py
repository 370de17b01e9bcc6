"""Base of cameras, measured or computed: all that refocusing and reconstruction in mm need."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from lf_flame._common.arrays import Number, centred
from lf_flame.errors import InputError
from lf_flame.lightfield import LightField


class Lens:
    """Number of views, and slope and scale by depth, of a camera.

    `PlenopticCamera` computes them from lenses and distances, with depths from its focal plane.
    `lf_flame.calibration.CameraLaw` has them as measured, with depths from the user's zero.

    Attributes
    ----------
    views : int
        Number of views along each axis.
    lenslets : (int, int)
        Number of rows and columns of a view.
    aperture_diameter_mm : float or None
        Diameter of a round pupil; None if every view's part of the pupil is a whole square.
    focus_distance_mm : float
        Distance from the lens to the focal plane.
    pupil_distance_mm : float
        Distance from the point in which the views meet, the entrance pupil, to the focal plane.
    focal_plane_mm : float
        Depth of the focal plane, where the slope is 0.
    lenslet_in_focus_mm : float
        Size of a lenslet's image in the focal plane.
    view_step_mm : float
        Distance between the centres of neighbouring views in the pupil.

    Examples
    --------
    >>> from lf_flame import PAPER_CAMERA
    >>> round(PAPER_CAMERA.lenslet_in_focus_mm, 4), PAPER_CAMERA.distance_mm(20.0)
    (0.1314, 346.0)
    """

    views: int
    lenslets: tuple[int, int]
    aperture_diameter_mm: float | None

    if TYPE_CHECKING:  # at run time, a dataclass would take a property for a field's default
        __dataclass_fields__: ClassVar[dict[str, Any]]

        @property
        def focus_distance_mm(self) -> float: ...  # noqa: D102
        @property
        def focal_plane_mm(self) -> float: ...  # noqa: D102
        @property
        def lenslet_in_focus_mm(self) -> float: ...  # noqa: D102
        @property
        def view_step_mm(self) -> float: ...  # noqa: D102
        def depth_to_slope(self, depth_mm: Number) -> Number: ...  # noqa: D102
        def slope_to_depth(self, slope: Number) -> Number: ...  # noqa: D102
        def slope_to_real_depth(self, slope: Number) -> Number: ...  # noqa: D102
        def field_mm(self, depth_mm: float) -> tuple[float, float]: ...  # noqa: D102
        def check_depths(self, depths_mm) -> None: ...  # noqa: D102
        def with_views(self, count: int) -> "Lens": ...  # noqa: D102

    def distance_mm(self, depth_mm: float) -> float:
        """Distance in mm from the point in which the views meet to a depth."""
        return self.pupil_distance_mm + depth_mm - self.focal_plane_mm

    @property
    def pupil_distance_mm(self) -> float:
        """Distance from the entrance pupil, in which the views meet, to the focal plane, in mm."""
        return self.focus_distance_mm

    @property
    def pupil_width_mm(self) -> float:
        """Width of the pupil that the views see: all of their parts, or a narrower aperture."""
        return min(self.views * self.view_step_mm, self.aperture_diameter_mm or np.inf)

    def whole_views(self) -> np.ndarray:
        """Find the views whose part of the pupil lies wholly in the aperture: bool, (v, u).

        A single view is the picture through the whole aperture.
        """
        far = (np.abs(centred(self.views)) + 0.5) * self.view_step_mm
        radius = (self.aperture_diameter_mm or np.inf) / 2
        return (np.hypot(far[:, None], far) <= radius * (1 + 1e-9)) | (self.views == 1)

    def corrected(self, light_field: LightField) -> LightField:
        """Correct measured faults of the lens in pictures: here none."""
        return light_field

    def for_light_field(self, shape: tuple[int, ...]) -> "Lens":
        """Copy the camera, with as many lenslets as views (v, u, t, s) have pixels.

        The number of lenslets in a camera file is that of the whole array; a light field may be
        a part of it, or be decoded without its rim. A measured distortion forbids that: it is known
        only about the centre of whole views.
        """
        self.check_views(shape)
        size = int(shape[2]), int(shape[3])
        if size == tuple(self.lenslets):
            return self
        if getattr(self, "distortion", 0.0):
            raise InputError(
                f"The calibration undoes the distortion of views of {self.lenslets[0]} x "
                f"{self.lenslets[1]} pixels about their centre, got views of {size[0]} x {size[1]}."
            )
        return replace(self, lenslets=size)  # type: ignore[type-var]

    def check_views(self, views: tuple[int, ...]) -> None:
        """Refuse a light field with another number of views: its slopes mean other depths."""
        if tuple(views[:2]) != (self.views, self.views):
            raise InputError(
                f"The camera has {self.views} x {self.views} views, but the light field has "
                f"{views[0]} x {views[1]}: one step between views would be another angle, and each "
                f"depth wrong; give the camera or the calibration of these views."
            )
