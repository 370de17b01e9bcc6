"""The upright axis of a round flame: where it stands across and in depth, and whether it leans."""

from dataclasses import dataclass

import numpy as np
from scipy import signal

from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.refocus import shift_and_sum
from lf_flame.tomography.counted_views import counted_views

EDGE_SHARE = 0.01
"""Share of the brightest column at which a flame is taken to end."""

MARGIN = 1.2
"""By which a radius that is read off the light is enlarged."""

LEAN_ROWS = 0.2
"""Share of the brightest row from which a row tells where the axis is."""


@dataclass(frozen=True)
class FlameAxis:
    """Where a flame's axis is.

    Attributes
    ----------
    across_mm : float
        From the optical axis, in mm at the axis' depth.
    depth_mm : float
        From the focal plane.
    radius_mm : float
        Beyond which there is no light, with a margin.
    lean_deg : float
        Of the axis within the picture, from upright; towards larger columns with height above 0.
    lopsided : float
        Root-mean-square difference of the left and right halves of the image focused on the axis,
        relative to that light, column by column: 0 for a flame that is round.
    """

    across_mm: float
    depth_mm: float
    radius_mm: float
    lean_deg: float
    lopsided: float


def find_axis(light_field: LightField, camera: PlenopticCamera) -> FlameAxis:
    """Find the axis about which a flame is round, from where each view sees its middle.

    A view sees the middle where its columns fit their mirror image best (the peak of the columns'
    convolution with themselves, which noise does not move). How the middle moves from view to view
    is the axis' slope, and so its depth.

    Parameters
    ----------
    light_field : LightField
        Grey, of `camera`, black at 0.
    camera : PlenopticCamera

    Raises
    ------
    InputError
        If there is no light, or the views are too few to tell depth, or not the camera's.
    """
    light_field, camera, _ = counted_views(light_field, camera)
    views = light_field.views
    camera.check_views(views.shape)
    if views.ndim != 4 or views.shape[1] < 3:
        raise InputError(
            f"The axis is found in grey light fields of 3 or more view columns, got {views.shape}."
        )
    columns = views.sum(axis=(0, 2), dtype=np.float64)  # view column, lenslet column
    if not columns.max() > 0:
        raise InputError(f"The light field holds no light: its brightest is {views.max():g}.")
    middles = np.array([_middle(line) for line in columns])
    at = np.arange(len(middles)) - (len(middles) - 1) / 2
    slope, middle = np.polyfit(at, middles, 1)
    depth = float(camera.slope_to_depth(slope))
    across = middle - (columns.shape[1] - 1) / 2
    side = camera.field_mm(depth)[1] / columns.shape[1]
    image = shift_and_sum(light_field, [slope])[0].astype(np.float64)
    line = image.sum(axis=0)
    return FlameAxis(
        across_mm=float(across * side),
        depth_mm=depth,
        radius_mm=_radius(line, middle) * side * MARGIN,
        lean_deg=_lean(image),
        lopsided=_lopsided(line, middle),
    )


def _middle(line: np.ndarray) -> float:
    """Find about which place a line is most like its mirror image, in pixels."""
    own = signal.fftconvolve(line, line)
    peak = int(np.clip(np.argmax(own), 1, len(own) - 2))
    before, at, after = own[peak - 1 : peak + 2]
    curved = before - 2 * at + after
    return (peak + (0.5 * (before - after) / curved if curved < 0 else 0.0)) / 2


def _radius(line: np.ndarray, middle: float) -> float:
    """Distance from the middle beyond which a line is dark."""
    bright = np.flatnonzero(line > EDGE_SHARE * line.max())
    return float(np.abs(bright - middle).max())


def _lopsided(line: np.ndarray, middle: float) -> float:
    place = np.arange(len(line), dtype=float)
    mirrored = np.interp(2 * middle - place, place, line, left=0.0, right=0.0)
    return float(np.linalg.norm(line - mirrored) / 2 / np.linalg.norm(line))


def _lean(image: np.ndarray) -> float:
    """Fit the middles of an image's bright rows, weighted by their light; degrees from upright."""
    light = image.sum(axis=1)
    bright = np.flatnonzero(light > LEAN_ROWS * light.max())
    if len(bright) < 3:
        return 0.0
    middles = [_middle(image[row]) for row in bright]
    slope, _ = np.polyfit(-bright, middles, 1, w=light[bright])
    return float(np.degrees(np.arctan(slope)))
