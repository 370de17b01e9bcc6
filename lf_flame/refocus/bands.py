"""Refocusing of light fields larger than memory, one band of rows after the other."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from lf_flame.errors import InputError
from lf_flame.lazy_light_field import LazyLightField
from lf_flame.refocus._arguments import Views, as_numbers, as_slopes
from lf_flame.refocus.grey_views import reach_of

Refocusing = TypeVar("Refocusing", bound=Callable[..., np.ndarray])


def in_bands(refocus: Refocusing) -> Refocusing:
    """Make a refocusing method take a `LazyLightField` too, of which it reads bands of rows.

    A row of the image is made from the rows within the largest shift of a view; of such a band the
    method gives the same as of the whole.
    """

    @wraps(refocus)
    def refocused(light_field: Views, slopes: ArrayLike, **options: Any) -> np.ndarray:
        if not isinstance(light_field, LazyLightField):
            return refocus(light_field, slopes, **options)
        numbers = as_numbers(slopes, "slopes")
        as_slopes(numbers.ravel())  # refuses none, NaN and infinity
        maps, lenslets = numbers.ndim > 1, light_field.shape[2:4]
        if maps and numbers.shape[-2:] != lenslets:
            raise InputError(
                f"A slope map must have the {lenslets[0]} x {lenslets[1]} lenslets of the views, "
                f"got an array of shape {numbers.shape}."
            )
        rows = (slice(None),) * (numbers.ndim - 2 if maps else numbers.ndim)
        parts = []
        for band, window in light_field.bands(reach_of(numbers, light_field.shape[0])):
            some = numbers[..., band.read, :] if maps else slopes
            # A copy, so that the rows beyond the band are freed.
            parts.append(refocus(window, some, **options)[(*rows, band.inner)].copy())
        return np.concatenate(parts, axis=len(rows))

    return cast(Refocusing, refocused)
