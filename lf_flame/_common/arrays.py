"""Small operations on arrays that several parts of the package share."""

import reprlib
from contextlib import suppress
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from lf_flame.errors import InputError

Number = TypeVar("Number", float, np.ndarray)
"""A number or an array: the result is of the same kind as the argument."""


def as_numbers(values: ArrayLike, name: str) -> np.ndarray:
    """Real numbers as float64; text, complex numbers and rows of unequal length are refused."""
    with suppress(TypeError, ValueError):
        numbers = np.asarray(values)
        if numbers.dtype.kind in "biufO":
            return numbers.astype(float)
    raise InputError(f"{name} must be real numbers, got {reprlib.repr(values)}.")


def centred(n: int) -> np.ndarray:
    """Positions of n points relative to their centre: k - (n - 1) / 2, float64."""
    return np.arange(n) - (n - 1) / 2


def number_or_array(array: np.ndarray) -> Any:
    """Convert an array without axes to a plain number; leave others unchanged."""
    return array.item() if np.ndim(array) == 0 else array
