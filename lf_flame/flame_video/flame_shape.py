"""Shape of a flame in an image: height, tip, width and contour.

A flame is the region that is brighter than a fraction of the image's peak and connected to the
peak; hot pixels and sparks do not count (`bright_spots`). Its contour runs between pixels where
linear interpolation reaches that level.

Rows run downwards, and the burner is at the bottom. Row 0 is the centre of the first row of pixels;
the lower edge of an image of n rows is at n - 1/2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from skimage import measure

from lf_flame.errors import InputError
from lf_flame.flame_video.bright_spots import (
    LEAST_PIXELS,
    find_peak,
    larger_flame,
    region_of,
)
from lf_flame.optics.camera import LONGEST, SHORTEST

LEAST_SIGNAL = 8.0
"""Number of standard deviations of noise by which a flame's peak must exceed the image's median.
The brightest of a million pixels without light exceeds it by five."""

LEAST_SIDE = 5
"""Smallest number of pixels along each axis of an image, needed to measure the noise."""

APART_SHARE = 0.05
"""Smallest area of separate light for a warning, relative to the flame's; noise leaves single
pixels."""

CEILING_SHARE = 0.05
"""Smallest fraction of the flame's area at exactly the brightest value that counts as saturated. A
Gaussian clipped over this fraction of its area has a peak 4 % higher."""

DARK_SHARE = 0.03
"""Largest brightness around a flame, relative to its peak, without a warning: 0.1 moves the tip of
a flame 4 rows sharp by half a row."""

DARK = "Nothing is above the noise: there is no flame."
SPECK = f"The brightest spot has fewer than {LEAST_PIXELS} pixels: there is no flame."
CUT = "The flame reaches the top or a side of the picture: it is cut off, and larger than measured."
CEILING = (
    "Much of the flame has exactly the same, brightest value: the picture is saturated, and the "
    "contour too wide."
)
APART = "Other places are as bright and not joined to the brightest: they do not count."

BRIGHT_DARK = (
    "The dark around the flame is not at 0: subtract the dark frame, or the light behind the "
    "flame; contour and height are wrong."
)

SPARK = "A small spot apart from the flame is brighter, a spark or hot pixels: it does not count."


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
        Width of the contour in its widest row.
    area : float
        Area inside the contour, holes included.
    brightness : float
        Mean of the flame's pixels, in the image's unit.
    contour : ndarray of float64, shape (points, 2)
        Rows and columns along the outer contour, in pixels of the image; the last point equals the
        first.
    warnings : tuple of str
        Sentences, without numbers, on what makes the measurements doubtful: too dark, a speck, cut
        by the edge, saturated, in parts, with sparks, or in a picture that is not black at 0.
    dark_share : float
        Brightness of the dark around the flame, relative to the peak: the median along the darkest
        of the top and the sides of the image.
    """

    height: float
    tip_row: float
    width: float
    area: float
    brightness: float
    contour: np.ndarray
    warnings: tuple[str, ...] = ()
    dark_share: float = float("nan")

    @property
    def is_found(self) -> bool:
        """Whether there is a flame."""
        return len(self.contour) > 0


def measure_flame(
    image: ArrayLike,
    *,
    level: float = 0.5,
    pixel_mm: float = 1.0,
    burner_row: float | None = None,
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
    picture = _checked_image(image)
    check_measures(level, pixel_mm)
    burner = _checked_burner(burner_row, len(picture))
    noise, dark = _noise(picture), _darkest_side(picture)
    faint = max(0.0, np.median(picture) + LEAST_SIGNAL * noise)
    if picture.max() <= faint:
        return _no_flame(DARK)
    peak = find_peak(picture)
    if peak.value <= faint:
        return _no_flame(SPECK)
    region, spark = region_of(picture, level * peak.value, peak.place), False
    flame = larger_flame(picture, region)
    if flame is not None and flame.value > faint:
        peak, spark = flame, True
        region = region_of(picture, level * peak.value, peak.place)
    if np.count_nonzero(region) < LEAST_PIXELS:
        return _no_flame(SPECK)
    threshold, picture = level * peak.value, np.minimum(picture, peak.value)
    contour = _outer_contour(picture, region, threshold)
    tip = float(contour[:, 0].min())
    return FlameShape(
        height=(burner - tip) * pixel_mm,
        tip_row=tip,
        width=_greatest_width(contour) * pixel_mm,
        area=_enclosed_area(contour) * pixel_mm**2,
        brightness=float(picture[region].mean()),
        contour=contour,
        warnings=(
            *_doubts(picture, region, threshold, spark),
            *([BRIGHT_DARK] if _is_bright(dark, noise, peak.value, picture.shape) else []),
        ),
        dark_share=dark / peak.value,
    )


def row_error(level: float = 0.5) -> float:
    """Bound the swing in height, in pixels, that a moving tip shows by crossing the rows.

    A tip that is sharper than a row is found between rows with an error of one period a row,
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


def check_measures(level: float, pixel_mm: float) -> None:
    """Refuse a level or a pixel size that cannot be used.

    Raises
    ------
    InputError
        If the level is not between 0 and 1, or the size no length from `SHORTEST` to `LONGEST`.
    """
    if not 0 < level < 1:
        raise InputError(f"level must be a share of the peak between 0 and 1, got {level}.")
    if not SHORTEST <= pixel_mm <= LONGEST:
        raise InputError(
            f"pixel_mm must be a length from {SHORTEST:g} to {LONGEST:g} mm, got {pixel_mm}."
        )


def _checked_image(image: ArrayLike) -> np.ndarray:
    image = np.asarray(image)
    if image.ndim != 2 or min(image.shape) < LEAST_SIDE or image.dtype.kind not in "biuf":
        raise InputError(
            f"A flame is measured in a grey image of {LEAST_SIDE} x {LEAST_SIDE} pixels or more, "
            f"got an array of shape {image.shape} and type {image.dtype}."
        )
    image = image.astype(np.float64)
    if not np.all(np.isfinite(image)):
        raise InputError("The image of a flame must be finite, got NaN or infinite pixels.")
    return image


def _checked_burner(burner_row: float | None, rows: int) -> float:
    lowest = rows - 0.5
    if burner_row is None:
        return lowest
    if not -0.5 <= burner_row <= lowest:
        raise InputError(
            f"burner_row must lie within the picture, -0.5 to {lowest}, got {burner_row}."
        )
    return float(burner_row)


def _no_flame(reason: str) -> FlameShape:
    nan = float("nan")
    return FlameShape(nan, nan, nan, nan, nan, np.empty((0, 2)), (reason,))


def _noise(image: np.ndarray) -> float:
    """Measure the noise of a pixel from second differences along rows, which are small for a flame.

    They span two pixels, because refocusing correlates neighbours. Their standard deviation is
    sqrt(6) times that of a pixel, and 1.4826 times the median of their absolute values, which a
    flame in part of the image hardly changes.
    """
    differences = image[:, 4:] - 2 * image[:, 2:-2] + image[:, :-4]
    return 1.4826 * float(np.median(np.abs(differences))) / np.sqrt(6)


def _darkest_side(image: np.ndarray) -> float:
    """Median along the darkest of the top and the sides, as a flame may reach some of them.

    The burner is at the bottom.
    """
    return min(float(np.median(side)) for side in (image[0], image[:, 0], image[:, -1]))


def _is_bright(dark: float, noise: float, peak: float, shape: tuple[int, ...]) -> bool:
    """Whether the dark around a flame is brighter than `DARK_SHARE`, and noise is not why.

    A median of n pixels has a standard deviation of 1.25 / sqrt(n) times that of a pixel.
    """
    return dark > DARK_SHARE * peak + 4 * 1.25 * noise / np.sqrt(min(shape))


def _largest_apart(image: np.ndarray, region: np.ndarray, threshold: float) -> int:
    """Find the size of the largest region separate from the flame."""
    sizes = np.bincount(measure.label((image > threshold) & ~region, connectivity=1).ravel())
    return int(sizes[1:].max(initial=0))


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


def _greatest_width(contour: np.ndarray) -> float:
    """Find the widest row, from its first crossing of the contour to its last."""
    crossings = contour[contour[:, 0] % 1 == 0]
    rows = crossings[:, 0].astype(int)
    left, right = np.full(rows.max() + 1, np.inf), np.full(rows.max() + 1, -np.inf)
    np.minimum.at(left, rows, crossings[:, 1])
    np.maximum.at(right, rows, crossings[:, 1])
    return float((right - left).max())


def _enclosed_area(contour: np.ndarray) -> float:
    """Compute the area of a polygon, by the shoelace formula."""
    rows, columns = contour.T
    return float(abs(np.sum(rows[:-1] * columns[1:] - rows[1:] * columns[:-1])) / 2)


def _doubts(
    image: np.ndarray, region: np.ndarray, threshold: float, spark: bool
) -> tuple[str, ...]:
    size = np.count_nonzero(region)
    found = []
    if region[0].any() or region[:, [0, -1]].any():
        found.append(CUT)
    # Equal values may differ in their last digits after summation.
    flame = image[region]
    ceiling = np.count_nonzero(flame >= flame.max() * (1 - 1e-6))
    if ceiling >= max(LEAST_PIXELS, CEILING_SHARE * size):
        found.append(CEILING)
    if spark:
        found.append(SPARK)
    elif _largest_apart(image, region, threshold) >= max(LEAST_PIXELS, APART_SHARE * size):
        found.append(APART)
    return tuple(found)
