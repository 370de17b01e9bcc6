"""The upright axis of an axisymmetric flame: its position, depth and straightness."""

import math
from dataclasses import dataclass

import numpy as np
import scipy  # its parts load when they are used

from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.optics.lens import Lens
from lf_flame.refocus import shift_and_sum
from lf_flame.tomography.frustum_grid import FEWEST

EDGE_SHARE = 0.01
"""Light of a column, relative to the brightest, at which a flame is taken to end."""

MARGIN = 1.2
"""Factor by which a radius estimated from the light is enlarged."""

NOISES = 6.0
"""Multiple of a column's noise that its light must exceed as well."""

BRIGHT_ROWS = 0.2
"""Smallest light of a row, relative to the brightest, with which the row shows the axis."""

BANDS = 12
"""Largest number of bands of rows in which the axis is located."""

LEAST_PIXELS = 8
"""Smallest number of columns of a view in which an axis can be found."""

LEAST_ERROR = 0.01
"""Smallest standard error of the centre of a band, in pixels; pixels have a finite size."""


@dataclass(frozen=True)
class FlameAxis:
    """Position, direction and symmetry of a flame's axis.

    Attributes
    ----------
    across_mm : float
        Distance from the optical axis, in mm at the axis' depth.
    depth_mm : float
        Depth in mm from the focal plane, or from the zero of a `CameraLaw`.
    radius_mm : float
        Radius that contains all light, with a margin.
    lean_deg, lean_error_deg : float
        Angle of the axis within the image, from upright, above 0 if it runs towards larger columns
        with height; and its standard error.
    lopsided : float
        Root-mean-square difference of the left and right halves of the image focused on the axis,
        column by column, relative to the light of that image: 0 for an axisymmetric flame.
    across_error_mm, depth_error_mm : float
        Standard errors due to noise; infinite for the depth with fewer than 3 view columns.
    wander_mm, wander_error_mm : float
        Distance across between the axis and the straight line that fits it best, at the height
        where it is most significant; and its standard error.
    depth_lean_deg, depth_lean_error_deg : float
        Angle of the axis from upright in depth, above 0 if its top is farther from the camera, and
        its standard error, which is infinite with fewer than 3 view columns.
    """

    across_mm: float
    depth_mm: float
    radius_mm: float
    lean_deg: float
    lopsided: float
    across_error_mm: float = 0.0
    depth_error_mm: float = 0.0
    wander_mm: float = 0.0
    wander_error_mm: float = 0.0
    lean_error_deg: float = 0.0
    depth_lean_deg: float = 0.0
    depth_lean_error_deg: float = 0.0


def find_axis(light_field: LightField, camera: Lens, depth_mm: float | None = None) -> FlameAxis:
    """Find the upright axis of an axisymmetric flame from its centre in each view.

    The centre in a view is where its columns match their mirror image best: the peak of the
    columns' convolution with themselves, which noise does not bias. The displacement of the centre
    from view to view is the slope of the axis, and gives its depth. The same in bands of rows shows
    whether the axis is straight.

    Parameters
    ----------
    light_field : LightField
        Grey light field of `camera`; the median of its outermost columns is taken
        for black.
    camera : PlenopticCamera or CameraLaw
    depth_mm : float, optional
        Depth of the axis, for a light field of fewer than 3 view columns, which cannot show it.

    Returns
    -------
    FlameAxis

    Raises
    ------
    InputError
        If there is no light, the views are too few to find the depth, have too few pixels, or are
        not the camera's.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from lf_flame import PAPER_CAMERA
    >>> from lf_flame.tomography import AxisymmetricGrid
    >>> camera = replace(PAPER_CAMERA, views=3, lenslets=(24, 40))
    >>> grid = AxisymmetricGrid(camera, axis_mm=0.0, depth_mm=0.0, radius_mm=1.5)

    >>> import numpy as np
    >>> from lf_flame import LightField
    >>> from lf_flame.tomography import AxisymmetricOperator, find_axis
    >>> glow = np.outer(np.ones(grid.shape[0]), np.exp(-4 * grid.radii_mm**2))
    >>> operator = AxisymmetricOperator(grid)
    >>> views = np.reshape(operator @ glow.ravel(), operator.dimsd)
    >>> abs(find_axis(LightField(views), camera).across_mm) < 0.01
    True
    """
    light_field, camera = _inner_views(camera.corrected(light_field), camera)
    views = _checked_views(light_field.filled, camera, depth_mm)
    columns = views.sum(axis=(0, 2), dtype=np.float64)  # view column, lenslet column
    if not columns.max() > 0:
        raise InputError("The light field contains no light above that at its sides.")
    middles = np.array([_middle(line) for line in columns])
    at = np.arange(len(middles)) - (len(middles) - 1) / 2
    if depth_mm is None or len(middles) > 2:
        slope, middle = np.polyfit(at, middles, 1)
        depth = float(camera.slope_to_depth(slope))
    else:
        slope, middle, depth = float(camera.depth_to_slope(depth_mm)), middles.mean(), depth_mm
    side = camera.field_mm(depth)[1] / camera.lenslets[1]
    # An image for each view column, with its view rows focused on the axis.
    by_column = [LightField.trusted(views[:, u : u + 1]) for u in range(views.shape[1])]
    pictures = np.array([shift_and_sum(one, [slope])[0] for one in by_column], np.float64)
    picture = shift_and_sum(LightField.trusted(views), [slope])[0].astype(np.float64)
    focused = picture.sum(axis=0)
    across = middle - (views.shape[3] - 1) / 2
    return FlameAxis(
        across_mm=float(across * side),
        depth_mm=depth,
        radius_mm=min(_radius(picture, middle) * MARGIN, views.shape[3]) * side,
        lopsided=_lopsided(focused, middle),
        **_Bands(pictures).straightness(camera, slope, side),
    )


def _inner_views(light_field: LightField, camera: Lens) -> tuple[LightField, Lens]:
    """Cut a light field, and its camera, to the largest inner square of whole views with weight."""
    if light_field.views.shape[:2] != (camera.views,) * 2:
        return light_field, camera
    counts = np.ones((camera.views,) * 2) if light_field.weights is None else light_field.weights
    counts = counts * camera.whole_views()
    for out in range((camera.views + 1) // 2):
        inner = slice(out, camera.views - out)
        weights = counts[inner, inner]
        if weights.all():
            break
    count = len(weights)
    if not weights.all() or count < min(FEWEST, camera.views) or np.ptp(weights) > 0:
        raise InputError(
            f"The axis is found in an inner square of {FEWEST} x {FEWEST} views or more with "
            f"equal weights, got one of {count} x {count} with weights from {weights.min():g} to "
            f"{weights.max():g}."
        )
    if count == camera.views:
        return light_field, camera
    views = np.ascontiguousarray(light_field.views[inner, inner])
    valid = None if light_field.valid is None else light_field.valid[inner, inner]
    return LightField.trusted(views, valid=valid), camera.with_views(count)


def _checked_views(views: np.ndarray, camera: Lens, depth_mm: float | None) -> np.ndarray:
    """Subtract a background, which would pull the axis to the centre of the field."""
    if views.ndim != 4 or (views.shape[1] < 3 and depth_mm is None):
        wrong = "with fewer, state its depth"
        if views.ndim == 5:
            wrong = "in colour, its colours need a calibration (--colours)"
        raise InputError(
            f"The axis is found in grey light fields of 3 or more view columns, got {views.shape}; "
            f"{wrong}."
        )
    if depth_mm is None:  # else a single view of any camera suffices
        camera.check_views(views.shape)
    if views.shape[3] < LEAST_PIXELS:
        raise InputError(
            f"The axis is found in views of {LEAST_PIXELS} columns of pixels or more, got views of "
            f"{views.shape[2]} x {views.shape[3]}."
        )
    return views - np.float32(np.median(views[..., [0, -1]].mean(axis=(0, 1))))


class _Bands:
    """Centres of a flame in bands of rows, by view column, in pixels, and their errors."""

    def __init__(self, pictures: np.ndarray):
        light = pictures.sum(axis=(0, 2))
        bright = np.flatnonzero(light > BRIGHT_ROWS * light.max())
        count = int(np.clip(len(bright) // 4, 1, BANDS))
        bands = np.array_split(bright, count)
        self.heights = -np.array([band.mean() for band in bands])
        self.middles = np.array([_middles(pictures[:, band]) for band in bands])
        # Noise differs between neighbouring rows, the axis does not.
        halves = [
            _middles(pictures[:, band[0::2]]) - _middles(pictures[:, band[1::2]])
            if len(band) > 1
            else np.full(len(pictures), np.inf)
            for band in bands
        ]
        self.error = np.maximum(np.sqrt(np.mean(np.square(halves), axis=1)) / 2, LEAST_ERROR)
        self.at = np.arange(len(pictures)) - (len(pictures) - 1) / 2
        if len(self.at) > 2:
            # Refocusing correlates rows: their differences are too small by a common factor.
            self.error *= max(1.0, self._scatter() / float(np.sqrt(np.mean(self.error**2))))

    def _scatter(self) -> float:
        """Root-mean-square scatter of the centres about a line through the view columns."""
        spread = np.sum(self.at**2)
        middle = self.middles.mean(axis=1, keepdims=True)
        slopes = self.middles @ self.at / spread
        rest = self.middles - middle - slopes[:, None] * self.at
        return float(np.sqrt(np.sum(rest**2) / len(rest) / (len(self.at) - 2)))

    def straightness(self, camera: Lens, slope: float, side: float) -> dict[str, float]:
        """Fields of `FlameAxis` on the errors of the axis and its straightness."""
        error = self.error / np.sqrt(len(self.at))
        line, covariance = _fit_line(self.heights, self.middles.mean(axis=1), error)
        rest = np.abs(self.middles.mean(axis=1) - np.polyval(line, self.heights))
        worst = int(np.argmax(rest / error))
        found = {
            "lean_deg": float(np.degrees(np.arctan(line[0]))),
            "lean_error_deg": float(np.degrees(np.arctan(np.sqrt(covariance)))),
            "across_error_mm": side * float(1 / np.sqrt(np.sum(error**-2))),
            "wander_mm": side * float(rest[worst]),
            "wander_error_mm": side * float(error[worst]),
        }
        if len(self.at) < 3:
            return found | {"depth_error_mm": math.inf, "depth_lean_error_deg": math.inf}
        spread = np.sum(self.at**2)
        slopes, error = self.middles @ self.at / spread, self.error / np.sqrt(spread)
        per_slope = float(camera.slope_to_depth(slope + 1e-4) - camera.slope_to_depth(slope)) / 1e-4
        line, covariance = _fit_line(self.heights, slopes, error)
        found["depth_error_mm"] = abs(per_slope) * float(1 / np.sqrt(np.sum(error**-2)))
        found["depth_lean_deg"] = float(np.degrees(np.arctan(line[0] * per_slope / side)))
        tangent = float(np.sqrt(covariance)) * abs(per_slope) / side
        found["depth_lean_error_deg"] = float(np.degrees(np.arctan(tangent)))
        return found


def _fit_line(places: np.ndarray, values: np.ndarray, error: np.ndarray) -> tuple:
    """Fit a line; returns coefficients and the variance of the slope, infinite for few points."""
    if len(places) < 3:
        return np.array([0.0, values.mean()]), np.inf
    line = np.polyfit(places, values, 1, w=1 / error)
    middle = np.average(places, weights=error**-2)
    return line, 1 / np.sum(((places - middle) / error) ** 2)


def _middles(pictures: np.ndarray) -> np.ndarray:
    """Find the centre of each image's light, shape (pictures, rows, columns), in pixels."""
    return np.array([_middle(line) for line in pictures.sum(axis=1)])


def _middle(line: np.ndarray) -> float:
    """Find the point about which a line is most like its mirror image, in pixels."""
    own = scipy.signal.fftconvolve(line, line)
    peak = int(np.clip(np.argmax(own), 1, len(own) - 2))
    before, at, after = own[peak - 1 : peak + 2]
    curved = before - 2 * at + after
    return (peak + (0.5 * (before - after) / curved if curved < 0 else 0.0)) / 2


def _radius(picture: np.ndarray, middle: float) -> float:
    """Distance from the centre beyond which columns are dark, apart from noise."""
    line = picture.sum(axis=0)
    noise = np.sqrt(np.sum(np.square(np.diff(picture, axis=0)), axis=0) / 2)
    # Refocusing correlates rows: their differences show half of the noise or more.
    bright = np.flatnonzero(line > EDGE_SHARE * line.max() + NOISES * np.median(noise))
    return float(np.abs(bright - middle).max()) if bright.size else len(line) / 2


def _lopsided(line: np.ndarray, middle: float) -> float:
    place = np.arange(len(line), dtype=float)
    mirrored = np.interp(2 * middle - place, place, line, left=0.0, right=0.0)
    return float(np.linalg.norm(line - mirrored) / 2 / np.linalg.norm(line))
