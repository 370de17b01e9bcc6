"""The volumetric system: an image from few views, and a U-Net that removes its ghosts.

T. Samarakoon, K. Abeywardena, C. U. S. Edussooriya, "Arbitrary Volumetric Refocusing of Dense and
Sparse Light Fields", arXiv 2502.19238. A cross of 17 views replaces all 81, and a U-Net turns the
image from the cross into that from all views. The U-Net's depth and channels are not published;
they are our choice. Refocusing region by region is in `lf_flame.systems.region_refocus`.
"""

import keras
import numpy as np
from keras import layers, ops

from lf_flame.systems.base import NetworkSystem, ViewIndices
from lf_flame.systems.formulas import ShiftAndSum, cross_of_views, square_of_views
from lf_flame.systems.similarity import ms_ssim

FILTERS = (16, 32, 64)

SSIM_WEIGHT, PSNR_WEIGHT = 0.65, 500.0
"""Weights in the loss, as published: of 1 - MS-SSIM (the absolute error has the rest of 1), and of
1 / PSNR."""


def build_unet(seed: int = 0) -> keras.Model:
    """Build a U-Net that corrects an image (O. Ronneberger et al., MICCAI 2015).

    Parameters
    ----------
    seed : int, optional
        Seed of the initial weights, Glorot-uniform ("Xavier").

    Returns
    -------
    keras.Model
        Model with input and output (h, w, 1), sides multiples of 4; the input is added to the
        result of the last convolution.

    Examples
    --------
    >>> from lf_flame.systems import build_unet
    >>> build_unet(seed=1).count_params() > 10_000
    True
    """
    numbers = iter(range(1000 * seed, 1000 * seed + 1000))

    def convolution(filters: int, activation: str | None = "relu"):
        initial = keras.initializers.GlorotUniform(seed=next(numbers))
        return layers.Conv2D(
            filters, 3, padding="same", activation=activation, kernel_initializer=initial
        )

    def pair(x, filters: int):
        return convolution(filters)(convolution(filters)(x))

    image = keras.Input((None, None, 1), name="sparse_image")
    x, skipped = image, []
    for filters in FILTERS[:-1]:
        x = pair(x, filters)
        skipped.append(x)
        x = layers.MaxPooling2D()(x)
    x = pair(x, FILTERS[-1])
    for filters, skip in zip(FILTERS[-2::-1], skipped[::-1], strict=True):
        initial = keras.initializers.GlorotUniform(seed=next(numbers))
        x = layers.Conv2DTranspose(filters, 2, strides=2, kernel_initializer=initial)(x)
        x = pair(layers.Concatenate()([skip, x]), filters)
    return keras.Model(image, layers.Add()([image, convolution(1, None)(x)]), name="unet")


def unet_loss(truth, image):
    """Loss MSE + 0.65 (1 - MS-SSIM) + 0.35 L1 + 500 / PSNR, PSNR in dB, for each sample.

    500 / PSNR dominates, as published. PSNR is bounded at 1 dB, because the term would change sign
    below 0 dB.
    """
    squared = ops.mean(ops.square(truth - image), axis=(1, 2, 3))
    absolute = ops.mean(ops.abs(truth - image), axis=(1, 2, 3))
    decibels = -10 * ops.log10(ops.maximum(squared, 1e-10))
    return (
        squared
        + SSIM_WEIGHT * (1 - ms_ssim(truth, image))
        + (1 - SSIM_WEIGHT) * absolute
        + PSNR_WEIGHT / ops.maximum(decibels, 1.0)
    )


class SparseUNet(NetworkSystem):
    """Shift-and-sum of a cross of 17 views, corrected by the U-Net."""

    name = "Volumetric: cross of 17 views, U-Net"
    smallest = 49
    multiple = 4

    def view_indices(self, rows: int, columns: int) -> ViewIndices:
        """Choose the cross."""
        return cross_of_views(rows, columns)

    def prepare_input(self, views: np.ndarray, slopes: np.ndarray, block) -> np.ndarray:
        """Refocus with the cross alone."""
        return ShiftAndSum(selection=self.view_indices).refocus(views, slopes, block)[..., None]


class NineViewUNet(SparseUNet):
    """The same U-Net after shift-and-sum of ApertureNet's nine views: equal inputs for both."""

    name = "U-Net, ApertureNet's 9 views"

    def view_indices(self, rows: int, columns: int) -> ViewIndices:
        """Choose the views at the centres of 3 x 3 equal parts of the aperture."""
        return square_of_views(rows, columns)
