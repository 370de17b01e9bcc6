"""Checks that all ways of refocusing share."""

import numpy as np

from lf_flame.errors import InputError
from lf_flame.lightfield import LightField


def as_views(views) -> np.ndarray:
    return (views if isinstance(views, LightField) else LightField(views)).views


def as_slopes(slopes) -> np.ndarray:
    slopes = np.atleast_1d(np.asarray(slopes, float))
    if slopes.ndim != 1 or slopes.size == 0 or not np.all(np.isfinite(slopes)):
        raise InputError(f"slopes must be one or more finite numbers, got {slopes}.")
    return slopes
