"""Shape of a flame in an image: height, tip, width and contour.

A flame is the largest connected region that is brighter than a fraction of the image's peak. The
contour runs between pixels where linear interpolation reaches that level.

Rows run downwards, and the burner is at the bottom. Row 0 is the centre of the first row of pixels;
the lower edge of an image of n rows is at n - 1/2.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage
from skimage import measure

from lf_flame.errors import InputError
from lf_flame.optics.camera import LONGEST, SHORTEST

LEAST_SIGNAL = 8.0
"""Number of standard deviations of noise by which a flame's peak must exceed the image's median.
The brightest of a million pixels without light exceeds it by five."""

DOUBTS = {
    "dark": "Only single pixels are above the noise, or light fills half of the picture: no flame.",
    "cut": "The flame reaches the top or a side of the picture: it is cut off, and larger than "
    "measured.",
    "ceiling": "Much of the flame has exactly the same, brightest value: the picture is saturated, "
    "and the contour too wide.",
    "apart": "Other regions are as bright and not joined to the flame: they are left out.",
    "bright_dark": "The background around the flame is not at 0: subtract the dark frame, or the "
    "light behind the flame; contour and height are wrong.",
}
"""Sentences on what makes the measurements of a flame doubtful, by name."""


@dataclass(frozen=True, eq=False)
class FlameShape:
    """Shape of a flame. Lengths are in mm if the pixel size was given, else in pixels.

    Without a flame all numbers are NaN and the contour is empty.

    Attributes
    ----------
    height : float
        Height from the burner to the tip.
    tip_row : float
        Row of the contour's highest point, in pixels of the image.
    width : float
        Distance between the contour's leftmost and rightmost points, along the rows.
    area : float
        Area inside the contour, holes included.
    brightness : float
        Mean of the flame's pixels, in the image's unit.
    contour : ndarray of float64, shape (points, 2)
        Rows and columns along the outer contour, in pixels of the image; the last point equals the
        first.
    doubts : tuple of str
        Names in `DOUBTS` of what makes the measurements doubtful.
    """

    height: float = np.nan
    tip_row: float = np.nan
    width: float = np.nan
    area: float = np.nan
    brightness: float = np.nan
    contour: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))
    doubts: tuple[str, ...] = ()

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences on what makes the measurements doubtful."""
        return tuple(DOUBTS[name] for name in self.doubts)


def measure_flame(
    image: ArrayLike, *, level: float = 0.5, pixel_mm: float = 1.0, burner_row: float | None = None
) -> FlameShape:
    """Measure the flame in an image.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Grey image, finite, black at 0; 5 x 5 pixels or more.
    level : float, optional
        Level of the contour as a fraction of the peak, above 0 and below 1.
    pixel_mm : float, optional
        Side of a pixel in mm at the flame, above 0. Default: lengths are in pixels.
    burner_row : float, optional
        Row from which the height is measured, inside the image. Default: its lower edge.

    Returns
    -------
    FlameShape
        Height, width, area, brightness and contour; NaN without a flame.

    Raises
    ------
    InputError
        If an argument cannot be used.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.flame_video import measure_flame
    >>> y, x = np.mgrid[:60, :40]
    >>> image = np.exp(-(((y - 40) / 12) ** 2) - ((x - 20) / 5) ** 2)
    >>> round(measure_flame(image, burner_row=50.0).height)  # to where it is half as bright
    20
    """
    picture = np.asarray(image)
    is_grey = picture.ndim == 2 and min(picture.shape) >= 5 and picture.dtype.kind in "biuf"
    if not is_grey or not np.isfinite(picture).all():
        raise InputError(
            f"A flame is measured in a grey image of 5 x 5 finite pixels or more, got an array of "
            f"shape {picture.shape} and type {picture.dtype}{', with NaN or infinity' * is_grey}."
        )
    picture = picture.astype(np.float64)
    if not 0 < level < 1:
        raise InputError(f"level must be a share of the peak between 0 and 1, got {level}.")
    if not SHORTEST <= pixel_mm <= LONGEST:
        raise InputError(
            f"pixel_mm must be a length from {SHORTEST:g} to {LONGEST:g} mm, got {pixel_mm}."
        )
    lowest = len(picture) - 0.5
    burner = lowest if burner_row is None else float(burner_row)
    if not -0.5 <= burner <= lowest:
        raise InputError(
            f"burner_row must lie within the picture, -0.5 to {lowest}, got {burner_row}."
        )
    noise, peak = _noise(picture), _peak(picture)
    if peak <= max(0.0, np.median(picture) + LEAST_SIGNAL * noise):
        return FlameShape(doubts=("dark",))
    picture, threshold = np.minimum(picture, peak), level * peak
    labels, _ = ndimage.label(picture > threshold)
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    region = labels == sizes.argmax()
    contour = _outer_contour(picture, region, threshold)
    rows, columns = contour.T
    tip = float(rows.min())
    return FlameShape(
        height=(burner - tip) * pixel_mm,
        tip_row=tip,
        width=float(np.ptp(columns)) * pixel_mm,
        # Shoelace formula.
        area=abs(float(rows[:-1] @ columns[1:] - rows[1:] @ columns[:-1])) / 2 * pixel_mm**2,
        brightness=float(picture[region].mean()),
        contour=contour,
        doubts=_doubts(picture, region, np.sort(sizes)[::-1], noise),
    )


def row_error(level: float = 0.5) -> float:
    """Bound the apparent oscillation in height, in pixels, of a tip that moves across rows.

    A tip that is sharper than a row is found between rows with an error of one period per row,
    because a pixel gives its mean. Its largest amplitude is 0.087 at half the peak, 0.16 at a
    fifth.

    Parameters
    ----------
    level : float, optional
        Level of the contour as a fraction of the peak.

    Examples
    --------
    >>> from lf_flame.flame_video import row_error
    >>> row_error()
    0.1
    """
    return 0.1 + 0.8 * (level - 0.5) ** 2


def _noise(image: np.ndarray) -> float:
    """Measure the noise of a pixel from second differences along rows, which are small for a flame.

    They span two pixels, because refocusing correlates neighbours, and have sqrt(6) times the
    standard deviation of a pixel: 1.4826 times the median of their absolute values.
    """
    differences = image[:, 4:] - 2 * image[:, 2:-2] + image[:, :-4]
    return 1.4826 * float(np.median(np.abs(differences))) / np.sqrt(6)


def _peak(image: np.ndarray) -> float:
    """Find the brightest value that is not a hot pixel.

    A hot pixel, or four, exceed a median of 3 x 3 by a quarter; the tip of a flame does not.
    """
    brightest = float(image.max())
    steady = float(ndimage.median_filter(image, 3, mode="nearest").max())
    return brightest if brightest <= 1.25 * steady else steady


def _outer_contour(image: np.ndarray, region: np.ndarray, threshold: float) -> np.ndarray:
    """Trace the outer contour of a region, closed along the edges of the image."""
    alone = np.where(region, image, np.minimum(image, threshold))
    padded = np.pad(alone, 1, mode="edge")
    # Mirrored at the threshold: the crossing is half a pixel outside, at the image's edge.
    around = np.minimum(padded, 2 * threshold - padded)
    around[1:-1, 1:-1] = alone
    found = measure.find_contours(around, threshold, fully_connected="low")
    # The other contours are those of holes, below the outer one's highest point.
    return min(found, key=lambda contour: contour[:, 0].min()) - 1


def _doubts(image: np.ndarray, region: np.ndarray, sizes: np.ndarray, noise: float):
    """Names of what is doubtful about a flame; `sizes` are those of all bright regions, falling."""
    # Equal values may differ in their last digits after summation. A Gaussian clipped over 5 % of
    # its area has a peak 4 % higher. Noise leaves single pixels apart.
    some, peak = max(4, 0.05 * sizes[0]), image[region].max()
    # The burner is at the bottom; a flame may reach some of the other sides. A background of 10 %
    # moves the tip of a flame that is 4 rows sharp by half a row: 3 %, and four standard deviations
    # of the median, raise no doubt.
    dark = min(float(np.median(side)) for side in (image[0], image[:, 0], image[:, -1]))
    limit = 0.03 * peak + 4 * 1.25 * noise / np.sqrt(min(image.shape))
    found = {
        "cut": region[0].any() or region[:, [0, -1]].any(),
        "ceiling": np.count_nonzero(image[region] >= peak * (1 - 1e-6)) >= some,
        "apart": sizes[1] >= some,
        "bright_dark": dark > limit,
    }
    return tuple(name for name, is_so in found.items() if is_so)
