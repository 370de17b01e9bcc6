"""Peak of a flame among hot pixels and sparks, which may be brighter.

A peak is a level that a certain number of connected pixels reach; a single hot pixel is not a peak.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

LEAST_PIXELS = 4
"""Smallest number of pixels of a flame; fewer are a hot pixel, which refocusing spreads over its
neighbours."""

HOT = 1.25
"""Smallest ratio of a hot pixel to the level that `LEAST_PIXELS` connected pixels reach; the tip of
a flame some pixels wide is lower."""

SPARK_PIXELS = 25
"""Largest number of pixels of a spark."""

SPARK_RATIO = 10
"""Area relative to a bright spot's from which another place is the flame, and the spot a spark."""


@dataclass(frozen=True)
class Peak:
    """Brightest place of an image.

    Attributes
    ----------
    value : float
        Radiance of the peak.
    place : (int, int)
        Row and column of one of its pixels.
    """

    value: float
    place: tuple[int, int]


def find_peak(image: np.ndarray) -> Peak:
    """Find the brightest place that is not a hot pixel."""
    place, reached = joined_pixels(image, LEAST_PIXELS)
    brightest = float(image.max())
    if brightest <= HOT * reached:
        return Peak(brightest, _place(image.argmax(), image))
    return Peak(reached, place)


def joined_pixels(image: np.ndarray, count: int) -> tuple[tuple[int, int], float]:
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


def region_of(image: np.ndarray, threshold: float, place: tuple[int, int]) -> np.ndarray:
    """Mark the pixels above a threshold that are connected to a place, by their sides."""
    labels = ndimage.label(image > threshold)[0]
    return labels == labels[place] if labels[place] else np.zeros(image.shape, bool)


def larger_flame(image: np.ndarray, spot: np.ndarray) -> Peak | None:
    """Find a flame that is much larger than a bright spot and separate from it.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
    spot : ndarray of bool, shape (rows, columns)

    Returns
    -------
    Peak or None
        Peak of the flame; None if the spot is not a spark but the flame itself.
    """
    area = int(np.count_nonzero(spot))
    if area > SPARK_PIXELS or SPARK_RATIO * area > image.size:
        return None
    place, reached = joined_pixels(image, SPARK_RATIO * area)
    around = ndimage.binary_dilation(spot, iterations=2)
    flame = region_of(image, np.nextafter(reached, -np.inf), place)
    if (flame & around).any():
        return None
    return find_peak(np.where(flame, image, image.min()))


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
