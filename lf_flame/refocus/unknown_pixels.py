"""Refocusing of light fields with unknown pixels: the mean over the views that are known."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextvars import ContextVar
from functools import partial, wraps
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from lf_flame.lightfield import LightField
from lf_flame.refocus._arguments import Views

LOGGER = logging.getLogger(__name__)

WARN: ContextVar[Callable[[str], object]] = ContextVar("WARN", default=LOGGER.warning)
"""Function of the warning on lower bounds: it is logged, or kept with the frame of a video."""

LEAST_KNOWN = 0.02
"""Smallest share of the weights of known pixels by which a sum is divided; below it, few views
would decide."""

BOUND = 1e-3
"""Smallest excess, relative to the brightest value, that makes a value a lower bound."""

Refocusing = TypeVar("Refocusing", bound=Callable[..., np.ndarray])


def ignoring_unknown(
    plain: Callable[..., np.ndarray] | None = None,
) -> Callable[[Refocusing], Refocusing]:
    """Make a refocusing method, linear in the views, leave out the unknown pixels.

    A refocused pixel is the sum over the known pixels over the sum of their weights (normalised
    convolution: Knutsson, Westin, CVPR 1993); where almost none is known, that over filled pixels.
    It is at least the mean of all stored values, because that of an unknown pixel is a lower
    bound: where the brightest views are saturated, the mean of the others would be too dark. A
    warning counts the points where this decides.

    These means are of linear or nearest pixels, whose weights are 0 or above. A method of other
    interpolation refocuses filled views, and the difference that leaving out makes is added: it
    is 0 where all is known, so that the holes do not ring.

    Parameters
    ----------
    plain : callable, optional
        Method of the same arguments with linear interpolation. Default: the method itself.
    """

    def decorate(refocus: Refocusing) -> Refocusing:
        @wraps(refocus)
        def refocused(light_field: Views, slopes: ArrayLike, **options: Any) -> np.ndarray:
            if not isinstance(light_field, LightField) or light_field.valid is None:
                return refocus(light_field, slopes, **options)
            own = LightField.trusted(light_field.filled, weights=light_field.weights)
            wanted, weights = options.get("interpolation"), options.get("weights")
            way = "nearest" if wanted == "nearest" else "linear"
            mean = partial(_mean, plain or refocus, own.weights, slopes, way, weights)
            filled = mean(own.views)
            return refocus(own, slopes, **options) + (_best(light_field, filled, mean) - filled)

        return cast(Refocusing, refocused)

    return decorate


def _mean(plain: Callable, own, slopes, interpolation, weights, views: np.ndarray) -> np.ndarray:
    """Mean of shifted views, whose weights are all 0 or above."""
    light_field = LightField.trusted(views, weights=own)
    return plain(light_field, slopes, interpolation=interpolation, weights=weights)


def _best(light_field: LightField, filled: np.ndarray, mean: Callable) -> np.ndarray:
    """Mean of the known pixels, or that of filled ones, and at least that of all stored values."""
    views, known = light_field.views, np.asarray(light_field.valid, np.float32)
    colour = (..., None) if views.ndim == 5 else ...
    share = mean(known)[colour]
    image = mean(views * known[colour]) / np.maximum(share, LEAST_KNOWN)
    image = np.where(share < LEAST_KNOWN, filled, image)
    held = mean(views)
    bounds = held > image + BOUND * np.abs(held).max()
    bounds |= (share < LEAST_KNOWN) & (held >= filled)
    if bounds.any():
        WARN.get()(
            f"{np.count_nonzero(bounds)} of the {bounds.size} refocused values are lower bounds: "
            f"pixels that are unknown there, saturated or dark, have more light than the others."
        )
    return np.maximum(image, held)
