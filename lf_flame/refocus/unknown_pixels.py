"""Refocusing of light fields with unknown pixels: the mean over the views that are known."""

import logging
from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from lf_flame.lightfield import LightField
from lf_flame.refocus._arguments import Views

LOGGER = logging.getLogger(__name__)

LEAST_KNOWN = 0.1
"""Smallest share of the weights of known pixels by which a sum is divided. Below it, few views
would decide, and the ripples of "cubic" and "sinc" would be amplified."""

BOUND = 1e-3
"""Smallest excess, relative to the brightest value, that makes a value a lower bound."""

Refocusing = TypeVar("Refocusing", bound=Callable[..., np.ndarray])


def of_known_pixels(refocus: Refocusing) -> Refocusing:
    """Make a refocusing method, linear in the views, leave out the unknown pixels.

    A refocused pixel is the sum over the known pixels over the sum of their weights (normalised
    convolution: Knutsson, Westin, CVPR 1993); where hardly one is known, that over filled pixels.
    It is at least the mean of what all pixels hold, because that of an unknown pixel is a lower
    bound: where the brightest views are saturated, the mean of the others would be too dark. A
    warning counts the places where this decides.
    """

    @wraps(refocus)
    def refocused(light_field: Views, slopes: ArrayLike, **options: Any) -> np.ndarray:
        if not isinstance(light_field, LightField) or light_field.valid is None:
            return refocus(light_field, slopes, **options)
        views, weights = light_field.views, light_field.weights
        known = light_field.valid.astype(np.float32)
        colour = (..., None) if views.ndim == 5 else ...

        def mean(of: np.ndarray) -> np.ndarray:
            return refocus(LightField.trusted(of, weights=weights), slopes, **options)

        held, share = mean(views), mean(known)[colour]
        image = mean(views * known[colour]) / np.maximum(share, LEAST_KNOWN)
        if (few := np.broadcast_to(share < LEAST_KNOWN, image.shape)).any():
            image[few] = mean(light_field.filled)[few]
        bounds = held > image + BOUND * np.abs(held).max()
        if bounds.any():
            LOGGER.warning(
                f"{np.count_nonzero(bounds)} of the {bounds.size} refocused values are lower "
                f"bounds: views that are saturated there hold more light than the others."
            )
        return np.maximum(image, held, out=image)

    return cast(Refocusing, refocused)
