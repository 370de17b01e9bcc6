"""Shape of a flame in an image: height, tip, width and contour.

A flame is the region that is brighter than a fraction of the image's peak and connected to the
peak. A peak is a level that several connected pixels reach: single hot pixels do not count, nor do
sparks, which are far smaller than the flame and may be brighter. The contour runs between pixels
where linear interpolation reaches that level.

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

LEAST_SIDE = 5
"""Smallest number of pixels along each axis of an image, needed to measure the noise."""

LEAST_PIXELS = 4
"""Smallest number of pixels of a flame; fewer are a hot pixel, which refocusing spreads over its
neighbours."""

SPARK_PIXELS, SPARK_RATIO = 25, 10
"""Largest number of pixels of a spark, and area of the flame relative to it."""

DOUBTS = {
    "dark": "Nothing is above the noise: there is no flame.",
    "speck": f"The brightest spot has fewer than {LEAST_PIXELS} pixels: there is no flame.",
    "cut": "The flame reaches the top or a side of the picture: it is cut off, and larger than "
    "measured.",
    "ceiling": "Much of the flame has exactly the same, brightest value: the picture is saturated, "
    "and the contour too wide.",
    "apart": "Other places are as bright and not joined to the brightest: they are left out.",
    "spark": "A small spot apart from the flame is brighter, a spark or hot pixels: it is left "
    "out.",
    "bright_dark": "The dark around the flame is not at 0: subtract the dark frame, or the light "
    "behind the flame; contour and height are wrong.",
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
        Width of the contour in its widest row.
    area : float
        Area inside the contour, holes included.
    brightness : float
        Mean of the flame's pixels, in the image's unit.
    contour : ndarray of float64, shape (points, 2)
        Rows and columns along the outer contour, in pixels of the image; the last point equals the
        first.
    doubts : tuple of str
        Names in `DOUBTS` of what makes the measurements doubtful.
    dark_share : float
        Brightness of the dark around the flame, relative to the peak: the median along the darkest
        of the top and the sides of the image.
    """

    height: float = np.nan
    tip_row: float = np.nan
    width: float = np.nan
    area: float = np.nan
    brightness: float = np.nan
    contour: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))
    doubts: tuple[str, ...] = ()
    dark_share: float = np.nan

    @property
    def is_found(self) -> bool:
        """Whether there is a flame."""
        return len(self.contour) > 0

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences on what makes the measurements doubtful."""
        return tuple(DOUBTS[name] for name in self.doubts)


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
    burner = lowest = len(picture) - 0.5
    if burner_row is not None:
        burner = float(burner_row)
        if not -0.5 <= burner <= lowest:
            raise InputError(
                f"burner_row must lie within the picture, -0.5 to {lowest}, got {burner_row}."
            )
    noise = _noise(picture)
    faint = max(0.0, np.median(picture) + LEAST_SIGNAL * noise)
    if picture.max() <= faint:
        return FlameShape(doubts=("dark",))
    peak, place = _find_peak(picture)
    if peak <= faint:
        return FlameShape(doubts=("speck",))
    region, spark = _region_of(picture, level * peak, place), False
    larger = _larger_flame(picture, region)
    if larger is not None and larger[0] > faint:
        (peak, place), spark = larger, True
        region = _region_of(picture, level * peak, place)
    if np.count_nonzero(region) < LEAST_PIXELS:
        return FlameShape(doubts=("speck",))
    picture, threshold = np.minimum(picture, peak), level * peak
    contour = _outer_contour(picture, region, threshold)
    # The burner is at the bottom; a flame may reach some of the other sides.
    dark = min(float(np.median(side)) for side in (picture[0], picture[:, 0], picture[:, -1]))
    tip = float(contour[:, 0].min())
    return FlameShape(
        height=(burner - tip) * pixel_mm,
        tip_row=tip,
        width=_greatest_width(contour) * pixel_mm,
        area=_enclosed_area(contour) * pixel_mm**2,
        brightness=float(picture[region].mean()),
        contour=contour,
        doubts=_doubts(picture, region, threshold, spark, dark > _dark_limit(picture, noise, peak)),
        dark_share=dark / peak,
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
    """Refuse a level that is not between 0 and 1, or a pixel size that is no length."""
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


def _noise(image: np.ndarray) -> float:
    """Measure the noise of a pixel from second differences along rows, which are small for a flame.

    They span two pixels, because refocusing correlates neighbours. Their standard deviation is
    sqrt(6) times that of a pixel, and 1.4826 times the median of their absolute values, which a
    flame in part of the image hardly changes.
    """
    differences = image[:, 4:] - 2 * image[:, 2:-2] + image[:, :-4]
    return 1.4826 * float(np.median(np.abs(differences))) / np.sqrt(6)


def _dark_limit(image: np.ndarray, noise: float, peak: float) -> float:
    """Largest brightness of the dark without a warning: 3 % of the peak, and four errors of it.

    A dark of 10 % moves the tip of a flame that is 4 rows sharp by half a row. A median of n pixels
    has a standard deviation of 1.25 / sqrt(n) times that of a pixel.
    """
    return 0.03 * peak + 4 * 1.25 * noise / np.sqrt(min(image.shape))


def _find_peak(image: np.ndarray) -> tuple[float, tuple[int, int]]:
    """Find the brightest place that is no hot pixel: its radiance, and one of its pixels.

    A hot pixel exceeds the level that some connected pixels reach by a quarter; the tip of a flame
    some pixels wide does not.
    """
    place, reached = _joined_pixels(image, LEAST_PIXELS)
    brightest = float(image.max())
    if brightest <= 1.25 * reached:
        return brightest, _place(image.argmax(), image)
    return reached, place


def _joined_pixels(image: np.ndarray, count: int) -> tuple[tuple[int, int], float]:
    """Find the highest radiance that `count` connected pixels reach, and one of their places."""
    falling = np.sort(image, axis=None)[::-1]
    low, high = count - 1, min(2 * count, image.size) - 1
    while high < image.size - 1 and _largest(image >= falling[high])[1] < count:
        low, high = high, min(2 * high, image.size - 1)
    while low < high:
        middle = (low + high) // 2
        if _largest(image >= falling[middle])[1] >= count:
            high = middle
        else:
            low = middle + 1
    return _place(_largest(image >= falling[low])[0], image), float(falling[low])


def _largest(above: np.ndarray) -> tuple[int, int]:
    """Find a pixel of the largest region, as a flat index, and the region's size."""
    labels, found = ndimage.label(above)
    if not found:
        return 0, 0
    sizes = np.bincount(labels.ravel())[1:]
    largest = int(sizes.argmax()) + 1
    return int((labels.ravel() == largest).argmax()), int(sizes[largest - 1])


def _place(index, image: np.ndarray) -> tuple[int, int]:
    row, column = np.unravel_index(int(index), image.shape)
    return int(row), int(column)


def _region_of(image: np.ndarray, threshold: float, place: tuple[int, int]) -> np.ndarray:
    """Mark the pixels above a threshold that are connected to a place, by their sides."""
    labels = ndimage.label(image > threshold)[0]
    return labels == labels[place] if labels[place] else np.zeros(image.shape, bool)


def _larger_flame(image: np.ndarray, spot: np.ndarray) -> tuple[float, tuple[int, int]] | None:
    """Find the peak of a flame much larger than a bright spot and apart from it, which is a spark.

    None if the spot is the flame itself.
    """
    area = int(np.count_nonzero(spot))
    if area > SPARK_PIXELS or SPARK_RATIO * area > image.size:
        return None
    place, reached = _joined_pixels(image, SPARK_RATIO * area)
    flame = _region_of(image, np.nextafter(reached, -np.inf), place)
    if (flame & ndimage.binary_dilation(spot, iterations=2)).any():
        return None
    return _find_peak(np.where(flame, image, image.min()))


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


def _doubts(image, region, threshold: float, spark: bool, bright_dark: bool) -> tuple[str, ...]:
    """Names of what is doubtful about a flame that was found."""
    size = np.count_nonzero(region)
    # Equal values may differ in their last digits after summation. A Gaussian clipped over 5 % of
    # its area has a peak 4 % higher.
    flame = image[region]
    ceiling = np.count_nonzero(flame >= flame.max() * (1 - 1e-6))
    # Noise leaves single pixels apart.
    apart = _largest((image > threshold) & ~region)[1]
    found = {
        "cut": region[0].any() or region[:, [0, -1]].any(),
        "ceiling": ceiling >= max(LEAST_PIXELS, 0.05 * size),
        "spark": spark,
        "apart": not spark and apart >= max(LEAST_PIXELS, 0.05 * size),
        "bright_dark": bright_dark,
    }
    return tuple(name for name, is_so in found.items() if is_so)
