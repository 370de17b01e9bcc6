"""Small operations on arrays that several parts of the package share."""

from typing import TypeVar

import numpy as np

Number = TypeVar("Number", float, np.ndarray)
"""A number or an array: what goes in as one comes out as the same."""


def centred(n: int) -> np.ndarray:
    """Count n places from their middle: 0 .. n-1 less (n-1)/2, float64."""
    return np.arange(n) - (n - 1) / 2


def spread(count: int, chosen: int) -> list[int]:
    """Choose views spread evenly over `count`, from the first to the last; one: the central."""
    if chosen == 1:
        return [(count - 1) // 2]
    return np.round(np.linspace(0, count - 1, chosen)).astype(int).tolist()


def area_average(images: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Area-average the last two axes to `size`, and clip to [0, 1], as a sensor saturates."""
    from skimage.transform import downscale_local_mean  # takes a while to import

    factors = (1,) * (images.ndim - 2) + tuple(
        n // m for n, m in zip(images.shape[-2:], size, strict=True)
    )
    averaged = downscale_local_mean(images, factors) if max(factors) > 1 else images
    return np.clip(averaged, 0, 1).astype(np.float32)
