"""Small operations on arrays that several parts of the package share."""

from typing import Any, TypeVar

import numpy as np

Number = TypeVar("Number", float, np.ndarray)
"""A number or an array: the result is of the same kind as the argument."""


def centred(n: int) -> np.ndarray:
    """Positions of n points relative to their centre: k - (n - 1) / 2, float64."""
    return np.arange(n) - (n - 1) / 2


def number_or_array(array: np.ndarray) -> Any:
    """Convert an array without axes to a plain number; leave others unchanged."""
    return array.item() if np.ndim(array) == 0 else array
