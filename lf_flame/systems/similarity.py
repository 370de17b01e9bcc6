"""Structural similarity, also at several scales, as a loss for training networks.

It uses Keras's operations, so that it has a gradient on every backend; tables are scored with
scikit-image. The constants are those of Wang et al.: a Gaussian window of 11 x 11 pixels and
standard deviation 1.5, K1 = 0.01, K2 = 0.03, images from 0 to 1.
"""

from typing import Any

import numpy as np
from keras import ops

from lf_flame.errors import InputError

WINDOW, DEVIATION = 11, 1.5
C1, C2 = 0.01**2, 0.03**2

SCALE_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)
"""Weights of the scales, the finest first: Z. Wang, E. P. Simoncelli, A. C. Bovik, "Multiscale
structural similarity for image quality assessment", Asilomar 2003."""


def ssim(truth: Any, image: Any) -> Any:
    """Mean structural similarity of pairs of images (n, h, w, channels) from 0 to 1: shape (n,).

    Z. Wang et al., IEEE Transactions on Image Processing 13, 2004; windows are completely inside.
    """
    luminance, structure = _terms(truth, image)
    return ops.mean(luminance * structure, axis=(1, 2, 3))


def ms_ssim(truth: Any, image: Any) -> Any:
    """Structural similarity at several scales (MS-SSIM), each half the previous one: shape (n,).

    Five scales need images of 176 pixels; smaller images have as many scales as contain a window,
    with weights scaled to the same sum. A value of a scale below 1e-6 is set to 1e-6.
    """
    count = scales(truth.shape[1:3])
    weights = np.array(SCALE_WEIGHTS[:count]) / sum(SCALE_WEIGHTS[:count]) * sum(SCALE_WEIGHTS)
    total = 1.0
    for number, weight in enumerate(weights):
        if number:
            truth, image = (ops.average_pool(x, 2) for x in (truth, image))
        luminance, structure = _terms(truth, image)
        last = number == count - 1
        value = ops.mean(luminance * structure if last else structure, axis=(1, 2, 3))
        # A power has no gradient at 0.
        total *= ops.maximum(value, 1e-6) ** float(weight)
    return total


def scales(size: tuple[int, int]) -> int:
    """Count the scales at which a window fits into an image of this height and width."""
    count = sum(min(size) >> k >= WINDOW for k in range(len(SCALE_WEIGHTS)))
    if not count:
        raise InputError(
            f"Structural similarity needs images of {WINDOW} pixels or more along each side, got "
            f"{size[0]} x {size[1]}."
        )
    return count


def _terms(truth: Any, image: Any) -> tuple[Any, Any]:
    """Luminance, and contrast times structure, in every window: two tensors."""
    mean, other = _blur(truth), _blur(image)
    # Population moments of the weighted window, as in Wang's own program.
    spread = _blur(truth * truth) - mean * mean + _blur(image * image) - other * other
    joint = _blur(truth * image) - mean * other
    luminance = (2 * mean * other + C1) / (mean * mean + other * other + C1)
    return luminance, (2 * joint + C2) / (spread + C2)


def _blur(x: Any) -> Any:
    """Average each channel over the windows that are inside the image."""
    distances = np.arange(WINDOW) - WINDOW // 2
    weights = np.exp(-(distances**2) / (2 * DEVIATION**2))
    weights = (weights / weights.sum()).astype(np.float32)[:, None, None, None]
    kernel = np.tile(weights, (1, 1, x.shape[-1], 1))
    x = ops.depthwise_conv(x, kernel, padding="valid")
    return ops.depthwise_conv(x, np.swapaxes(kernel, 0, 1), padding="valid")
