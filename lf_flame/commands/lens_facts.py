"""Millimetres of a camera, and whether they hold for a light field."""

from typing import TYPE_CHECKING

import numpy as np

from lf_flame.calibration.camera_law import CameraLaw
from lf_flame.commands.options import tell
from lf_flame.errors import InputError

if TYPE_CHECKING:
    from lf_flame.optics.camera import PlenopticCamera
    from lf_flame.optics.lens import Lens

APART = 1.0
"""Largest slope at which detail of one pixel is seen by neighbouring views without gaps."""

FILLING = 0.99
"""Smallest share of a micro-image that a camera's views fill, if they divide the whole of it."""

PERIOD = 10
"""Period of coarse detail, in periods of the finest: two pixels."""


def lens_facts(lens: "Lens", shape: tuple[int, ...] = ()) -> tuple[dict[str, str], list[str]]:
    """Facts in mm on what a camera sees, by name, and notes on a light field of another."""
    from lf_flame.tomography.resolution import depth_blur, finest_period

    notes = []
    if shape:
        lens.check_views(shape)
        notes += note_on_pixels(lens, shape)
    facts = {
        "focal plane": f"at {lens.focal_plane_mm:.4g} mm, "
        f"{lens.pupil_distance_mm:.4g} mm from where the views meet",
        "pixel there": f"{lens.lenslet_in_focus_mm:.4g} mm",
        "in focus": f"{_span(lens, 1 / max(lens.views - 1, 1))} (the views agree within a pixel)",
        "refocusable": f"{_span(lens, APART)} (slopes from -{APART:g} to {APART:g})",
    }
    if lens.views > 1:
        finest = finest_period(lens)
        fine, coarse = (depth_blur(lens, times * finest) for times in (1, PERIOD))
        facts["depth"] = (
            f"detail of {finest:.2g} mm is told apart over {fine:.2g} mm of depth, of "
            f"{PERIOD * finest:.2g} mm over {coarse:.2g} mm"
        )
    return facts, notes


def note_on_pixels(lens: "Lens", shape: tuple[int, ...]) -> list[str]:
    """Note that a light field, (v, u, t, s), has views of other pixels than the camera's, if so."""
    if tuple(shape[2:4]) == tuple(lens.lenslets):
        return []
    return [
        f"The camera file is for views of {lens.lenslets[0]} x {lens.lenslets[1]} pixels, "
        f"got {shape[2]} x {shape[3]}: mm hold if the pixels are the same, cut out."
    ]


def check_gaps(camera: "PlenopticCamera", is_raw: bool) -> None:
    """Compare a camera's step between views with micro-image / views, that of decoded ones."""
    filling = camera.micro_image_pitch_mm / camera.views
    if camera.pixel_mm >= FILLING * filling:
        return
    stated = (
        f"the {camera.views} views of a decoded raw image divide the whole micro-image, so one "
        f"step between them is {filling:.6g} mm on the sensor, got {camera.pixel_mm:.6g}."
    )
    if is_raw:
        raise InputError(
            f"Leave pixel_pitch_mm out of the camera file: {stated} (A simulated raw image is read "
            f"by --views.)"
        )
    tell(
        f"If these views were decoded with a white image or --pitch, depths in mm are wrong by "
        f"about {filling / camera.pixel_mm - 1:.1%}: leave pixel_pitch_mm out of the camera file; "
        f"{stated}"
    )


def _span(lens: "Lens", slope: float) -> str:
    """Depths between two slopes, in mm; those beyond a calibration are unknown."""
    ends = [float(lens.slope_to_real_depth(end)) for end in (-slope, slope)]
    beyond = ["the lens", "infinity"]
    if isinstance(lens, CameraLaw):
        beyond = [f"beyond the targets ({end:g} mm)" for end in lens.depth_range_mm]
        ends = ends if lens.slope_mm < 0 else ends[::-1]
    near, far = (
        f"{end:.4g} mm" if np.isfinite(end) else words
        for end, words in zip(ends, beyond, strict=True)
    )
    return f"{near} to {far}"
