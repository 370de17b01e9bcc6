"""The plenoptic camera: main lens, microlens array at its image plane, sensor behind the array.

Lengths are in mm, angles in rad. ``depth`` is measured from the focal plane, positive = farther
from the main lens. ``slope`` is in lenslets per view step, positive = behind the focal plane.
``alpha`` is Ng's relative image distance: the refocused image plane lies at ``alpha`` times the
distance of the microlens array. Images are stored upright: the whole sensor, with lenslets
and micro-images, is rotated by 180 degrees. Rows therefore run down and columns run right in the
scene and in the image; the sign of the slope does not change.
"""

from __future__ import annotations

import math
from dataclasses import InitVar, dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from lf_flame._common.arrays import Number, number_or_array
from lf_flame._common.config import strict
from lf_flame.errors import InputError
from lf_flame.optics.lens import Lens
from lf_flame.optics.sensor import Sensor

MOST_PER_AXIS = 100_000
"""Largest number of views or lenslets along an axis; a larger one can only be a mistake."""

SHORTEST, LONGEST = 1e-50, 1e50
"""Range of lengths, in any unit, whose products are float64 numbers."""

WIDEST_APERTURE = 4
"""Largest aperture in widths of the matched one; a wider one would light too many lenslets."""

ROW_SPACING = {"rectangular": 1.0, "hexagonal": math.sqrt(0.75)}
"""Distance of the rows of an array, in pitches, by layout."""


def _is_within(low: float, value: Any, high: float) -> bool:
    numbers = int | float | np.integer | np.floating
    return isinstance(value, numbers) and bool(low <= value <= high)


@strict
@dataclass(frozen=True, kw_only=True)
class PlenopticCamera(Lens):
    """A standard (unfocused) plenoptic camera.

    Parameters
    ----------
    main_lens_focal_mm : float
        Focal length of the main lens, above 0.
    focus_distance_mm : float
        Distance from the focal plane in object space to the main lens, above the focal length.
        The microlens array is at the image distance that the thin-lens equation gives for it
        (deviation 1).
    lenslet_focal_mm : float
        Focal length of a lenslet and its distance from the sensor, above 0.
    lenslet_pitch_mm : float
        Distance between the centres of neighbouring lenslets, above 0; the lenslets are squares
        or hexagons that fill the array.
    views : int
        Number of pixels under a lenslet along each axis, 1 to 100,000; the number of views along
        each axis. An odd number has a central view.
    lenslets : (int, int)
        Number of recorded lenslet rows and columns, 1 to 100,000 each; of a hexagonal array, rows
        and columns of the views.
    pixel_pitch_mm : float, optional
        Sensor pixel pitch. Default: micro-image pitch / views, so that the pixels tile the sensor.
    aperture_diameter_mm : float, optional
        Diameter of the main lens's round aperture, as seen from the scene. Default: an ideal square
        aperture, matched to the lenslets (`aperture_mm` wide), which lights every pixel equally.
    rim_diameter_mm, rim_distance_mm : float, optional
        Diameter of a second round stop, the rim of the lens barrel or of a window, and its
        distance in front of the main lens. Default: no such stop. Like the aperture it cuts the
        light of all layers, even of those between it and the lens.
    wavelength_nm : float, optional
        Wavelength for diffraction. Default: ray optics, no diffraction.
    chromatic_shift : float, optional
        Relative change of the main lens's focal length over the recorded band of light, 0 to 0.2:
        about the band's fraction of the F-C range divided by the Abbe number.
    lenslet_rotation_rad : float, optional
        Rotation of the microlens array against the sensor, about the optical axis, within 0.1.
        Positive rotates x towards y: clockwise in the stored image, whose rows run down.
    lenslet_pitch_error : float, optional
        Relative error of the lenslet pitch, within 0.1; the sensor is read as if it were 0.
    falloff_corrected : bool, optional
        Whether the images are divided by a white image (flat field), as plenoptic processing
        does, which removes the natural falloff (cos^4). Default: True, a uniform field is uniform.
    sensor : Sensor, optional
        Noise, full well and bits of the sensor. Default: an ideal sensor.
    f_number : float, optional
        Focal length over diameter, as engraved on the lens; replaces `aperture_diameter_mm`, and
        only the diameter is stored. (`lf_flame.refocus.f_number_aperture` takes the working
        f-number, image distance over diameter.)
    exit_pupil_mm : float, optional
        Distance P from the exit pupil, the image of the aperture that the lenslets see, to the
        array. Micro-images are centred on rays from there, and an image at a distance d behind the
        array has the slope ``P (pixel / (f p)) (-d / (P + d))`` (Michels, Mackenzie, Gomez and
        Koch, arXiv 2402.12891, 2024). Default: the aperture is in the main lens.
    layout : {"rectangular", "hexagonal"}, optional
        Array of lenslets. The views of a hexagonal one are on a square grid with the distance of
        its rows, 0.866 pitches, as `lf_flame.formats.decode_raw` makes them.

    Raises
    ------
    InputError
        If a value is out of range; the message names it.

    Examples
    --------
    >>> from lf_flame import PlenopticCamera
    >>> camera = PlenopticCamera(
    ...     main_lens_focal_mm=150.0,
    ...     focus_distance_mm=326.0,
    ...     lenslet_focal_mm=0.4,
    ...     lenslet_pitch_mm=0.112,
    ...     views=15,
    ...     lenslets=(270, 540),
    ... )
    >>> round(camera.image_distance_mm, 2)
    277.84
    >>> round(camera.depth_to_slope(20.0), 2)
    2.28
    """

    main_lens_focal_mm: float
    focus_distance_mm: float
    lenslet_focal_mm: float
    lenslet_pitch_mm: float
    views: int
    lenslets: tuple[int, int]
    pixel_pitch_mm: float | None = None
    aperture_diameter_mm: float | None = None
    rim_diameter_mm: float | None = None
    rim_distance_mm: float = 0.0
    wavelength_nm: float | None = None
    chromatic_shift: float = 0.0
    lenslet_rotation_rad: float = 0.0
    lenslet_pitch_error: float = 0.0
    falloff_corrected: bool = True
    sensor: Sensor | None = None
    f_number: InitVar[float | None] = None
    exit_pupil_mm: float | None = None
    layout: Literal["rectangular", "hexagonal"] = "rectangular"

    def __post_init__(self, f_number: float | None):
        if f_number is not None:
            if self.aperture_diameter_mm is not None:
                raise InputError("f_number and aperture_diameter_mm cannot both be given.")
            if not _is_within(0.1, f_number, 1e4):
                raise InputError(f"f_number must lie between 0.1 and 10000, got {f_number}.")
            object.__setattr__(self, "aperture_diameter_mm", self.main_lens_focal_mm / f_number)
        lengths = ["main_lens_focal_mm", "focus_distance_mm", "lenslet_focal_mm"]
        lengths += ["lenslet_pitch_mm", "pixel_pitch_mm", "aperture_diameter_mm"]
        lengths += ["rim_diameter_mm", "wavelength_nm", "exit_pupil_mm"]
        for name in lengths:
            value = getattr(self, name)
            if value is not None and not _is_within(SHORTEST, value, LONGEST):
                raise InputError(
                    f"{name} must be a positive, finite length in {name.rsplit('_')[-1]}, "
                    f"{SHORTEST:g} to {LONGEST:g}, got {value!r}."
                )
        for name, low, high in (
            ("rim_distance_mm", 0.0, LONGEST),
            ("chromatic_shift", 0.0, 0.2),
            ("lenslet_rotation_rad", -0.1, 0.1),
            ("lenslet_pitch_error", -0.1, 0.1),
        ):
            if not _is_within(low, getattr(self, name), high):
                raise InputError(
                    f"{name} must lie between {low:g} and {high:g}, got {getattr(self, name)}."
                )
        if self.focus_distance_mm <= self.main_lens_focal_mm:
            raise InputError(
                f"focus_distance_mm must exceed main_lens_focal_mm ({self.main_lens_focal_mm}) for "
                f"the main lens to form an image on the microlens array, "
                f"got {self.focus_distance_mm}."
            )
        if self.layout not in ROW_SPACING:
            raise InputError(f"layout must be {' or '.join(ROW_SPACING)}, got {self.layout!r}.")
        if not self.pupil_distance_mm > 0 or math.isinf(self.pupil_distance_mm):
            raise InputError(
                f"exit_pupil_mm must leave the entrance pupil in front of the focal plane, got "
                f"{self.exit_pupil_mm}."
            )
        counts = (self.views, *np.atleast_1d(self.lenslets).tolist())
        whole = [_is_within(1, n, MOST_PER_AXIS) and n % 1 == 0 for n in counts]
        if len(counts) != 3 or not all(whole):
            raise InputError(
                f"views must be one whole number and lenslets two, of 1 to {MOST_PER_AXIS} each, "
                f"got views={self.views!r}, lenslets={self.lenslets!r}."
            )
        object.__setattr__(self, "views", int(self.views))
        object.__setattr__(self, "lenslets", tuple(map(int, counts[1:])))
        if self.pixel_mm * self.views > self.micro_image_pitch_mm * (1 + 1e-9):
            raise InputError(
                f"pixel_pitch_mm must be at most {self.micro_image_pitch_mm / self.views:.6g} for "
                f"{self.views} pixels to fit under a lenslet, got {self.pixel_pitch_mm}."
            )
        widest = WIDEST_APERTURE * self.aperture_mm
        if self.aperture_diameter_mm is not None and self.aperture_diameter_mm > widest:
            raise InputError(
                f"aperture_diameter_mm must be at most {widest:.6g}, {WIDEST_APERTURE} times what "
                f"matches the lenslets, got {self.aperture_diameter_mm}."
            )

    def check_depths(self, depths_mm: ArrayLike) -> None:
        """Refuse depths behind the lens or optically at infinity, beyond 10,000 focus distances."""
        low = -min(self.focus_distance_mm, self.pupil_distance_mm)
        high = 1e4 * self.focus_distance_mm
        for depth in np.ravel(depths_mm):
            if not low < depth <= high:
                raise InputError(
                    f"Depths must lie above {low:g} mm (the main lens) and up to {high:g} mm, "
                    f"beyond which everything is optically at infinity, got {depth:g}."
                )

    @cached_property
    def image_distance_mm(self) -> float:
        """Distance from main lens to microlens array in mm, by the thin-lens equation."""
        f, a = self.main_lens_focal_mm, self.focus_distance_mm
        return a * f / (a - f)

    @cached_property
    def micro_image_pitch_mm(self) -> float:
        """Distance between micro-image centres in mm: the pitch, seen from the exit pupil."""
        return self.lenslet_pitch_mm * (1 + self.lenslet_focal_mm / self.exit_distance_mm)

    @cached_property
    def pixel_mm(self) -> float:
        """Pitch of the sensor's pixels in mm, computed where `pixel_pitch_mm` is None."""
        return self.pixel_pitch_mm or self.micro_image_pitch_mm / self.views

    @cached_property
    def aperture_mm(self) -> float:
        """Width of the main-lens aperture whose f-number matches the lenslets', in mm."""
        return self.exit_distance_mm * self.lenslet_pitch_mm / self.lenslet_focal_mm * self._pupils

    @cached_property
    def view_step_mm(self) -> float:
        """Distance in the aperture between the centres of neighbouring views, in mm.

        It is that in the entrance pupil, as seen from the scene.
        """
        return self.exit_distance_mm * self.pixel_mm / self.lenslet_focal_mm * self._pupils

    @cached_property
    def exit_distance_mm(self) -> float:
        """Distance from the exit pupil to the microlens array: `exit_pupil_mm`, if stated."""
        return self.exit_pupil_mm or self.image_distance_mm

    @cached_property
    def pupil_distance_mm(self) -> float:
        """Distance from the entrance pupil, in which the views meet, to the focal plane."""
        if self.exit_pupil_mm is None:
            return self.focus_distance_mm
        a0, i0 = self.focus_distance_mm, self.image_distance_mm
        total = a0 + i0 * (1 - i0 / self.exit_pupil_mm)
        return a0**2 / total if total else math.inf

    @cached_property
    def _pupils(self) -> float:
        """Width of the entrance pupil over that of the exit pupil; 1 in the lens."""
        near = self.image_distance_mm / self.exit_distance_mm
        return near * (self.pupil_distance_mm / self.focus_distance_mm)

    @property
    def aperture_before_lens_mm(self) -> float:
        """Distance of the entrance pupil in front of the main lens, in mm."""
        return self.focus_distance_mm - self.pupil_distance_mm

    def on_exit_pupil(self, width_mm: float) -> float:
        """Width in the exit pupil of a width in the entrance pupil, both in mm."""
        return width_mm / self._pupils

    @cached_property
    def grid_pitch_mm(self) -> float:
        """Distance on the array between the points that neighbouring pixels of a view show."""
        return self.lenslet_pitch_mm * ROW_SPACING[self.layout]

    @cached_property
    def field_of_view_deg(self) -> tuple[float, float]:
        """Full angles (vertical, horizontal) seen by the recorded lenslets, in degrees."""
        height, width = (
            math.degrees(2 * math.atan(side / 2 / self.pupil_distance_mm))
            for side in self.field_mm(0.0)
        )
        return height, width

    @property
    def focal_plane_mm(self) -> float:
        """Depth of the focal plane, from which depths are counted: 0."""
        return 0.0

    @property
    def lenslet_in_focus_mm(self) -> float:
        """Size in mm of a lenslet's image in the focal plane."""
        return self.grid_pitch_mm * self.focus_distance_mm / self.image_distance_mm

    def with_views(self, count: int) -> PlenopticCamera:
        """Camera whose views are the inner `count` along each axis, of the same pixels."""
        return replace(self, views=count, pixel_pitch_mm=self.pixel_mm)

    def field_mm(self, depth_mm: float) -> tuple[float, float]:
        """Height and width, in mm, of the field of the central view at a depth."""
        scale = (self.pupil_distance_mm + depth_mm) / self.image_distance_mm
        scale *= self.focus_distance_mm / self.pupil_distance_mm
        height, width = (n * self.grid_pitch_mm * scale for n in self.lenslets)
        return height, width

    def depth_to_slope(self, depth_mm: Number) -> Number:
        """Slope at which a layer is in focus.

        It is ``slope = view_step / pitch * (i0 / i(z) - 1)`` with the image distances i0 of the
        focal plane and i(z) of the layer, and the distance view_step between neighbouring views on
        the lens. By the thin-lens equation it depends on ``1/a0 - 1/(a0 + z)``, with the distance
        a0 from where the views meet to the focal plane: finite as z goes to infinity or through the
        focal length. An exit pupil elsewhere than in the lens only moves that point.

        Depths may be infinite, and scalars or arrays; the slope is in lenslets per view step.
        """
        depth, a0 = np.asarray(depth_mm, float), self.pupil_distance_mm
        if not np.all(depth > -a0):
            raise InputError(f"depth_mm must be above {-a0} (the main lens), got {depth_mm}.")
        with np.errstate(invalid="ignore"):
            vergence = np.where(np.isinf(depth), 1 / a0, depth / (a0 + depth) / a0)
        return number_or_array(vergence * self._vergence_to_alpha / self._alpha_step)

    def slope_to_depth(self, slope: Number) -> Number:
        """Depth in mm of the layer that is in focus at a slope; the inverse of `depth_to_slope`.

        It is infinite at the slope of infinity. Beyond that slope no real layer is in focus; the
        depth is that of a virtual layer, below minus the focus distance.
        """
        a0 = self.pupil_distance_mm
        shift = np.asarray(slope, float) * self._alpha_step * a0 / self._vergence_to_alpha
        with np.errstate(divide="ignore"):
            return number_or_array(a0 * shift / (1 - shift))

    def slope_to_real_depth(self, slope: Number) -> Number:
        """Depth in mm as `slope_to_depth`; NaN for the slope of no real layer."""
        depth = np.asarray(self.slope_to_depth(slope), float)
        return number_or_array(np.where(depth > -self.pupil_distance_mm, depth, np.nan))

    def slope_to_alpha(self, slope: Number) -> Number:
        """Ng's alpha for a slope: ``1 - 1/alpha = -slope * pitch / view_step``.

        It is infinite at ``slope = -view_step / pitch``: the refocused image is at infinity.
        """
        with np.errstate(divide="ignore"):
            return number_or_array(1 / (1 + np.asarray(slope, float) * self._alpha_step))

    def alpha_to_slope(self, alpha: Number) -> Number:
        """Slope for Ng's alpha; the inverse of `slope_to_alpha`. Alpha may be infinite."""
        with np.errstate(divide="ignore"):
            return number_or_array((1 / np.asarray(alpha, float) - 1) / self._alpha_step)

    @cached_property
    def _alpha_step(self) -> float:
        """Change of 1/alpha per unit of slope; alpha is from the exit pupil."""
        return self.grid_pitch_mm / self.on_exit_pupil(self.view_step_mm)

    @cached_property
    def _vergence_to_alpha(self) -> float:
        """Change of 1/alpha per change of vergence at the entrance pupil, in mm."""
        moved = self.pupil_distance_mm / self.focus_distance_mm
        return self.image_distance_mm * (moved**2 * self.image_distance_mm / self.exit_distance_mm)


PAPER_CAMERA = PlenopticCamera(
    main_lens_focal_mm=150.0,  # section III.A
    focus_distance_mm=326.0,  # Figure 5
    lenslet_focal_mm=0.4,  # section III.A
    lenslet_pitch_mm=0.112,  # section III.A
    views=15,  # not stated; follows from the slopes (deviation 2)
    lenslets=(270, 540),  # not stated; 3 x 3 lenslets to a pixel of 90 x 180 (deviation 4)
)
"""Camera of the paper, with the choices where the paper states nothing (deviations 1 to 4)."""
