"""Small operations on arrays that several parts of the package share."""

from typing import Any, TypeVar

import numpy as np

Number = TypeVar("Number", float, np.ndarray)
"""A number or an array: the result is of the same kind as the argument."""


def centred(n: int) -> np.ndarray:
    """Positions of n points relative to their centre: k - (n - 1) / 2, float64."""
    return np.arange(n) - (n - 1) / 2


def number_or_array(array: np.ndarray) -> Any:
    """Make a plain number of an array without axes; others stay as they are."""
    return array.item() if np.ndim(array) == 0 else array


def spread(count: int, chosen: int) -> list[int]:
    """Spread `chosen` indices evenly over `count`, ends included; a single one is central."""
    if chosen == 1:
        return [(count - 1) // 2]
    return np.round(np.linspace(0, count - 1, chosen)).astype(int).tolist()


def area_average(images: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Average areas so that the last two axes have `size`, and clip to [0, 1] like a sensor."""
    from skimage.transform import downscale_local_mean  # takes a while to import

    factors = (1,) * (images.ndim - 2) + tuple(
        n // m for n, m in zip(images.shape[-2:], size, strict=True)
    )
    averaged = downscale_local_mean(images, factors) if max(factors) > 1 else images
    return np.clip(averaged, 0, 1).astype(np.float32)
