"""Measured law of a camera: slope and scale by depth, with the range in which it was measured.

Through a camera of lenses and lenslets, the ray of lenslet x and view v is at the depth z at the
height ``(A + B z) x + (C + D z) v``. A lenslet therefore covers ``A + B z``, and a point moves from
view to view by ``-(C + D z) / (A + B z)`` lenslets, whatever the lenses:

    slope(z) = a + b / (z - c)
    mm per lenslet(z) = d (z - c)

At z = c, the entrance pupil, the views meet. For a thin lens at distance Z = z - c from the target,
``PlenopticCamera.depth_to_slope`` reads ``slope = B (1 / a0 - 1 / Z)`` with
``B = i0 view_step / pitch``, and ``a = B / a0, b = -B, d = pitch / i0``.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import map_coordinates

from lf_flame._common.arrays import Number, centred, number_or_array
from lf_flame._common.config import build, strict
from lf_flame._common.input_files import read_record, read_toml
from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.optics.camera import LONGEST, ROW_SPACING, SHORTEST, PlenopticCamera
from lf_flame.optics.lens import Lens
from lf_flame.scenes.scene_files import read_camera

MEASURED = ("slope_at_infinity", "slope_mm", "centre_mm", "scale")
"""Numbers a, b, c and d of a law, in the order of fits and of their covariance."""

TABLE = "law"
"""Name of the table in a TOML file."""


@strict
@dataclass(frozen=True, kw_only=True)
class CameraLaw(Lens):
    """Slope and scale of a camera as functions of depth, measured by `fit_targets`.

    Parameters
    ----------
    slope_at_infinity : float
        Slope a of distant objects, in lenslets per view step; not 0.
    slope_mm : float
        Coefficient b of ``1 / (z - c)`` in the slope, in mm times lenslets per view step; of the
        other sign than a.
    centre_mm : float
        Depth c of the point in which the views meet: the entrance pupil.
    scale : float
        Change d of the size in mm of a lenslet's image per mm of depth, above 0.
    depth_range_mm : (float, float)
        Lowest and highest depth for which the law holds.
    views : int
        Number of views along each axis; with another number a slope means another depth.
    lenslets : (int, int)
        Number of rows and columns of a view.
    distortion : float, optional
        Coefficient k of ``r (1 + k r^2)``, the distance r in lenslets from the centre of the image
        without radial distortion, per lenslet squared.
    aperture_diameter_mm : float, optional
        Diameter of a round pupil where the views meet. Default: the pupil is as wide as all views,
        or follows from the views that are used.
    fall_off : tuple of tuple of float, optional
        Brightness of each view, row by row, relative to the central one, above 0; 0 for a view that
        is excluded. Default: all are equal.
    standard_deviations : dict of str to float, optional
        Standard deviations of the numbers above, by name.

    Examples
    --------
    A lens 400 mm before the zero of the depths:

    >>> from lf_flame.calibration import CameraLaw
    >>> law = CameraLaw(
    ...     slope_at_infinity=2.0, slope_mm=-800.0, centre_mm=-400.0, scale=0.002,
    ...     depth_range_mm=(-50.0, 50.0), views=9, lenslets=(60, 90),
    ... )
    >>> round(law.depth_to_slope(10.0), 4), round(law.slope_to_depth(0.0), 4)
    (0.0488, 0.0)
    >>> round(law.mm_per_lenslet(10.0), 3)
    0.82
    """

    slope_at_infinity: float
    slope_mm: float
    centre_mm: float
    scale: float
    depth_range_mm: tuple[float, float]
    views: int
    lenslets: tuple[int, int]
    distortion: float = 0.0
    aperture_diameter_mm: float | None = None
    fall_off: tuple[tuple[float, ...], ...] | None = None
    standard_deviations: dict[str, float] = field(default_factory=dict)

    def __post_init__(self):
        low, high = self.depth_range_mm
        numbers = *(getattr(self, name) for name in MEASURED), low, high, self.distortion
        if not all(abs(number) <= LONGEST for number in numbers):
            raise InputError(f"The numbers of a law must be finite, up to {LONGEST:g}.")
        signs = self.slope_at_infinity * self.slope_mm < 0 < self.scale
        if not (signs and abs(self.slope_mm) >= SHORTEST and self.centre_mm < low < high):
            raise InputError(
                f"A law needs slope_at_infinity and slope_mm of opposite signs, scale above 0, "
                f"and depth_range_mm increasing, beyond centre_mm, got {self.slope_at_infinity}, "
                f"{self.slope_mm}, {self.scale}, {self.depth_range_mm} and {self.centre_mm}."
            )
        # A line that is added at the end of the file belongs to this table, the last.
        if unknown := self.standard_deviations.keys() - set(MEASURED):
            raise InputError(
                f"standard_deviations must be of {', '.join(MEASURED)}, got {', '.join(unknown)}; "
                f"other keys of a law belong directly below [{TABLE}]."
            )
        diameter = self.aperture_diameter_mm
        if diameter is not None and not SHORTEST <= diameter <= LONGEST:
            raise InputError(f"aperture_diameter_mm must be a length above 0, got {diameter}.")
        if self.views < 1 or min(self.lenslets) < 1:
            raise InputError(
                f"views and lenslets must be 1 or more, got {self.views} and {self.lenslets}."
            )
        if self.fall_off is not None:
            square = {len(row) for row in self.fall_off} == {self.views} == {len(self.fall_off)}
            levels = np.array(self.fall_off if square else [0.0], float)
            if not (np.all((levels >= 0) & (levels < 100)) and levels.any()):
                raise InputError(
                    f"fall_off must be {self.views} rows of {self.views} numbers from 0 to 100, "
                    f"not all 0."
                )

    def depth_to_slope(self, depth_mm: Number) -> Number:
        """Slope at which a layer is in focus, in lenslets per view step."""
        self.check_depths(depth_mm)
        depth = np.asarray(depth_mm, float)
        return number_or_array(self.slope_at_infinity + self.slope_mm / (depth - self.centre_mm))

    def slope_to_depth(self, slope: Number) -> Number:
        """Depth in mm of the layer in focus at a slope; outside `depth_range_mm` it is refused."""
        depth = self._depth(slope)
        self.check_depths(depth)
        return number_or_array(depth)

    def slope_to_real_depth(self, slope: Number) -> Number:
        """Depth in mm as `slope_to_depth`; NaN outside `depth_range_mm`."""
        depth, (low, high) = self._depth(slope), self.depth_range_mm
        return number_or_array(np.where((depth >= low) & (depth <= high), depth, np.nan))

    def _depth(self, slope: Number) -> np.ndarray:
        with np.errstate(divide="ignore"):
            return self.centre_mm + self.slope_mm / (np.asarray(slope) - self.slope_at_infinity)

    def mm_per_lenslet(self, depth_mm: Number) -> Number:
        """Size in mm of a lenslet's image at a depth, at the centre of the image."""
        self.check_depths(depth_mm)
        return number_or_array(self.scale * (np.asarray(depth_mm, float) - self.centre_mm))

    def field_mm(self, depth_mm: float) -> tuple[float, float]:
        """Height and width, in mm, of the field of the central view at a depth."""
        size = self.mm_per_lenslet(depth_mm)
        return self.lenslets[0] * size, self.lenslets[1] * size

    @property
    def focal_plane_mm(self) -> float:
        """Depth of the focal plane, where the slope is 0; it may lie outside the range."""
        return self.centre_mm - self.slope_mm / self.slope_at_infinity

    @property
    def focus_distance_mm(self) -> float:
        """Distance from the point in which the views meet to the focal plane, in mm."""
        return -self.slope_mm / self.slope_at_infinity

    @property
    def lenslet_in_focus_mm(self) -> float:
        """Size in mm of a lenslet's image in the focal plane, which may lie outside the range."""
        return self.scale * (self.focal_plane_mm - self.centre_mm)

    @property
    def view_step_mm(self) -> float:
        """Distance in mm between neighbouring views where they meet, seen from the focal plane."""
        return abs(self.slope_at_infinity) * self.lenslet_in_focus_mm

    def with_views(self, count: int) -> CameraLaw:
        """Law of the inner `count` views along each axis, with the same steps."""
        out = (self.views - count) // 2
        inner = slice(out, out + count)
        rows = self.fall_off and tuple(row[inner] for row in self.fall_off[inner])
        return replace(self, views=count, fall_off=rows)

    def corrected(self, light_field: LightField) -> LightField:
        """Bring views to equal brightness and undo the lens's distortion, as far as measured.

        Views that are darker than half of the central one get weight 0.
        """
        if light_field.shape[:2] != (self.views, self.views):
            is_single = light_field.shape[:2] == (1, 1)  # others are refused where it matters
            return self.with_views(1).corrected(light_field) if is_single else light_field
        if self.fall_off is not None:
            levels = np.array(self.fall_off, np.float32)
            lit = levels >= 0.5
            weights = light_field.weights
            if not lit.all():
                weights = lit * (1.0 if weights is None else weights)
            shape = levels.shape + (1,) * (light_field.views.ndim - 2)
            views = light_field.views / np.where(lit, levels, 1).reshape(shape)
            light_field = replace(light_field, views=views, weights=weights)
        if not self.distortion:
            return light_field
        self.for_light_field(light_field.shape)  # refuses views of another size
        return _undistorted(light_field, self.distortion)

    def check_depths(self, depths_mm: ArrayLike) -> None:
        """Refuse depths outside the range in which the law was measured; name the first."""
        low, high = self.depth_range_mm
        for depth in np.ravel(np.asarray(depths_mm, float)):
            if not low <= depth <= high:
                raise InputError(
                    f"The calibration is valid from {low:g} to {high:g} mm, around the depths of "
                    f"its targets, got {depth:g} mm; calibrate with targets at that depth."
                )

    def to_toml(self) -> str:
        """Format the law as a table of a TOML file, which `read_lens` reads."""
        values = dict(vars(self))
        tables = {TABLE: values, f"{TABLE}.standard_deviations": values.pop("standard_deviations")}
        return "\n".join(toml_table(*one) for one in tables.items())


def toml_table(name: str, values: dict[str, Any]) -> str:
    """Table of a TOML file; None is left out."""
    lines = [f"{key} = {json.dumps(value)}" for key, value in values.items() if value is not None]
    return "\n".join([f"[{name}]", *lines, ""])


def _undistorted(light_field: LightField, distortion: float) -> LightField:
    """Resample views so that they are free of radial distortion, by cubic splines.

    A distance r in pixels from the centre of a view becomes ``r (1 + k r^2)``. Beyond the picture
    its edges repeat.
    """
    size = light_field.views.shape[2:4]
    down, right = np.meshgrid(*(centred(n) for n in size), indexing="ij")
    bent = distortion * (down**2 + right**2)
    # The share s of each distance in the picture solves s (1 + bent s^2) = 1: from -4/27 on.
    if not 1 + 27 / 4 * bent.min() > 0.05:
        raise InputError(
            f"A distortion of {distortion:g} per pixel squared folds the corners of views of "
            f"{size[0]} x {size[1]} pixels over."
        )
    shrunk = np.ones(size)
    for _ in range(20):  # Newton steps, which converge in fewer
        shrunk -= (shrunk * (1 + bent * shrunk**2) - 1) / (1 + 3 * bent * shrunk**2)
    at = np.stack([down * shrunk + (size[0] - 1) / 2, right * shrunk + (size[1] - 1) / 2])
    views = light_field.filled.reshape(-1, *size, light_field.channels)
    new = np.empty_like(views)
    for view, channel in np.ndindex(len(views), light_field.channels):
        map_coordinates(
            views[view, ..., channel], at, new[view, ..., channel], order=3, mode="nearest"
        )
    valid = light_field.valid
    if valid is not None:  # a pixel is known if all four around it are
        known = [
            map_coordinates(one.astype(np.float32), at, order=1, mode="nearest") > 0.999
            for one in valid.reshape(-1, *size)
        ]
        valid = np.reshape(known, valid.shape)
    return replace(light_field, views=new.reshape(light_field.views.shape), valid=valid)


def read_lens(path: str | Path) -> PlenopticCamera | CameraLaw:
    """Read a camera from a file: its table ``[law]``, or else its table ``[camera]``.

    Parameters
    ----------
    path : str or Path
        Calibration, camera or scene file (.toml), or the record of a calibration or simulation.

    Returns
    -------
    CameraLaw or PlenopticCamera
        The law of a calibration, else the thin-lens camera.

    Examples
    --------
    >>> from lf_flame.calibration import read_lens
    >>> read_lens("scene.toml").views
    9
    """
    values = read_record(path) if Path(path).suffix == ".json" else read_toml(path)
    if TABLE in values:
        return build(CameraLaw, values[TABLE], f"{path}: {TABLE}")
    return read_camera(path)


def thin_lens(
    law: CameraLaw, lenslet_mm: float, *, focal_mm: float | None = None, hexagonal: bool = False
) -> PlenopticCamera:
    """Make the camera that has a law, for simulations and reconstructions.

    Its depths are from the focal plane, at `CameraLaw.focal_plane_mm` of the law. The views divide
    a micro-image evenly, as those of decoded pictures do.

    Parameters
    ----------
    law : CameraLaw
    lenslet_mm : float
        Distance between the centres of neighbouring lenslets, as their maker states it.
    focal_mm : float, optional
        Focal length of the main lens, as engraved, which fixes its distances: the exit pupil is
        then where the aperture must be seen for the views to meet where the law says. Default: the
        aperture is in the lens, and its focal length follows.
    hexagonal : bool, optional
        Whether the array is hexagonal: the law is then in distances of its rows.

    Examples
    --------
    >>> from lf_flame.calibration import CameraLaw, thin_lens
    >>> law = CameraLaw(
    ...     slope_at_infinity=2.0, slope_mm=-800.0, centre_mm=-400.0, scale=0.002,
    ...     depth_range_mm=(-50.0, 50.0), views=9, lenslets=(60, 90),
    ... )
    >>> round(thin_lens(law, 0.1).image_distance_mm, 6)
    50.0
    """
    if not law.slope_mm < 0:
        raise InputError(
            "No thin lens has this law: its slopes fall with depth, so the order of the views is "
            "reversed."
        )
    width = -law.slope_mm * law.scale * law.views  # of the pupil: B d is the step of a view
    if not 0 < lenslet_mm < width:
        raise InputError(
            f"No thin lens has this law with lenslets of {lenslet_mm:g} mm: its pupil would be "
            f"{width:.3g} mm wide."
        )
    grid_mm = lenslet_mm * (ROW_SPACING["hexagonal"] if hexagonal else 1.0)
    pupil, shrunk = law.focus_distance_mm, grid_mm / law.lenslet_in_focus_mm
    # Distances of the focal plane and of its image from the lens; their ratio is the scale.
    focus = pupil if focal_mm is None else focal_mm * (1 + 1 / shrunk)
    image = focus * shrunk
    exit_mm = image / (1 - (focus**2 / pupil - focus) / image)
    if not exit_mm > 0:
        raise InputError(
            f"No lens of {focal_mm:g} mm has this law: its exit pupil would be behind the array."
        )
    return PlenopticCamera(
        main_lens_focal_mm=focus * image / (focus + image),
        focus_distance_mm=focus,
        lenslet_focal_mm=1 / (width / (lenslet_mm * shrunk * pupil) - 1 / exit_mm),
        lenslet_pitch_mm=lenslet_mm,
        views=law.views,
        lenslets=law.lenslets,
        aperture_diameter_mm=law.aperture_diameter_mm,
        exit_pupil_mm=None if focal_mm is None else exit_mm,
        layout="hexagonal" if hexagonal else "rectangular",
    )
