"""RefNet, in our reading: 7 x 7 views become sixteen refocused images at once.

E. Hedayati, T. C. Havens, J. P. Bos, "Machine learning method for light field refocusing", arXiv
2103.16020: images at alpha = 0.125, 0.250, ... 2.0. The layers are not published in the sources
available to us. Ours follow the group's sister network of the same year (LFCompressionByRCNN-JPEG):
bottleneck residual blocks, ELU, a tanh at the end, and the loss 0.85 (1 - SSIM) / 2 + 0.15 times
the mean absolute error. This is therefore a network in place of RefNet, not RefNet itself.

Alpha is not defined there either. Here alpha = 1 keeps the focus, and an image is refocused at
slope 1 - alpha, in pixels per view step. This is Ng's shear without his magnification; the
sixteen slopes are from 0.875 down to -1.
"""

from typing import Any

import keras
import numpy as np
from keras import layers, ops

from lf_flame.errors import InputError
from lf_flame.systems.base import NetworkSystem, ViewIndices
from lf_flame.systems.formulas import outer_square_of_views
from lf_flame.systems.similarity import ssim

SIDE = 7
ALPHAS = np.arange(1, 17) / 8
SLOPES = 1 - ALPHAS
BLOCKS, NARROW, WIDE = 4, 32, 128


def build_refnet(seed: int = 0) -> keras.Model:
    """Build RefNet in our reading: bottleneck residual blocks, ELU, a tanh at the end.

    Parameters
    ----------
    seed : int, optional
        Seed of the initial weights.

    Returns
    -------
    keras.Model
        Model with input (h, w, 50), the views row by row, and their distance; output (h, w, 16),
        from 0 to 1, one image for each of `ALPHAS`.

    Examples
    --------
    >>> from lf_flame.systems import build_refnet
    >>> build_refnet(seed=1).count_params() > 10_000
    True
    """
    numbers = iter(range(1000 * seed, 1000 * seed + 1000))

    def convolution(filters: int, side: int) -> layers.Conv2D:
        initial = keras.initializers.HeNormal(seed=next(numbers))
        return layers.Conv2D(filters, side, padding="same", kernel_initializer=initial)

    def block(x: Any) -> Any:
        y = layers.ELU()(convolution(NARROW, 1)(x))
        y = layers.ELU()(convolution(NARROW, 3)(y))
        y = layers.BatchNormalization()(convolution(WIDE, 1)(y))
        return layers.ELU()(layers.Add()([x, y]))

    views = keras.Input((None, None, SIDE**2 + 1), name="views")
    x = layers.ELU()(convolution(WIDE, 7)(views))
    for _ in range(BLOCKS):
        x = block(x)
    x = layers.Activation("tanh")(convolution(len(ALPHAS), 3)(x))
    return keras.Model(views, layers.Rescaling(0.5, offset=0.5)(x), name="refnet")


def refnet_loss(truth: Any, image: Any) -> Any:
    """Loss 0.85 (1 - SSIM) / 2 + 0.15 mean absolute error, for each sample."""
    error = ops.mean(ops.abs(truth - image), axis=(1, 2, 3))
    return 0.85 * (1 - ssim(truth, image)) / 2 + 0.15 * error


class RefNet(NetworkSystem):
    """RefNet applied to a light field.

    It uses 7 x 7 views spread over all views. For a slope between two of its own it interpolates
    their images linearly.
    """

    name = "RefNet (our reading)"
    smallest = 7 + 2 * (BLOCKS + 1)

    def view_indices(self, rows: int, columns: int) -> ViewIndices:
        """Choose 7 x 7 views, from the first to the last."""
        return outer_square_of_views(rows, columns, SIDE)

    def _check(self, shape: tuple[int, ...], slopes: np.ndarray, block: tuple[int, int]) -> None:
        super()._check(shape, slopes, block)
        if shape[0] != shape[1] or block[0] != block[1]:
            raise InputError(
                f"{self.name} needs as many views and lenslets per pixel down as across, got "
                f"{shape[0]} x {shape[1]} and {block[0]} x {block[1]}."
            )

    def slope_range(self, rows: int, columns: int) -> tuple[float, float]:
        """Range of the sixteen slopes."""
        return float(SLOPES.min()), float(SLOPES.max())

    def training_slopes(self, slopes: np.ndarray, block: tuple[int, int]) -> np.ndarray:
        """Return the network's own sixteen slopes."""
        return SLOPES * block[0]

    def prepare_input(self, views: np.ndarray, slopes: np.ndarray, block) -> np.ndarray:
        """Stack the views as channels, not aligned; one input for all slopes.

        Slopes are in steps of the camera's views, of which the network receives only some: a last
        channel has the number of steps between two of its views, halved to be about 1.
        """
        inputs = super().prepare_input(views, np.zeros(1), block)
        spacing = np.full_like(inputs[..., :1], (views.shape[0] - 1) / (SIDE - 1) / 2)
        return np.concatenate([inputs, spacing], axis=-1)

    def prepare_target(self, stack: np.ndarray) -> np.ndarray:
        """Stack the sixteen images as channels."""
        return np.moveaxis(stack, 0, -1)[None]

    def _apply(self, views: np.ndarray, slopes: np.ndarray, block: tuple[int, int]) -> np.ndarray:
        images = np.moveaxis(self.predict(self.prepare_input(views, slopes, block))[0], -1, 0)
        at = np.interp(slopes / block[0], SLOPES[::-1], np.arange(len(SLOPES))[::-1])
        below = np.clip(np.floor(at).astype(int), 0, len(SLOPES) - 2)
        weight = (at - below)[:, None, None].astype(np.float32)
        return (1 - weight) * images[below] + weight * images[below + 1]
