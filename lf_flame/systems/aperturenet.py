"""ApertureNet, our own: nine views, each for a ninth of the aperture, and the widths of their blur.

The square aperture of the main lens is divided into 3 x 3 squares, and the network receives the
view at the centre of each. The image of an out-of-focus object that moves by d pixels over the
whole aperture moves by d / 3 within a square. All views of a square together therefore give its
central view, blurred by a box d / 3 wide; the mean of the nine blurred views is the image from all
views. This is exact for objects at one depth and views without gaps; only d is unknown, for each
pixel. (Shift-and-sum of nine views assumes d = 0, and shows ghosts.)

The network thus only has to find the width. From the aligned views it computes weights of a few
boxes for each pixel, and mixes the blurred means with these weights (as kernel-predicting networks
mix filters: S. Bako et al., ACM Transactions on Graphics 36(4), 2017). A small correction is added
for what no box describes, such as occluding edges. The network is fully convolutional and depends
on slopes only through the alignment: it works for any slope and any size.
"""

import keras
import numpy as np
from keras import layers, ops

from lf_flame.systems.base import NetworkSystem, ViewIndices
from lf_flame.systems.formulas import square_of_views

SIDE = 3
VIEWS = SIDE**2

WIDTHS = (1.0, 2.0, 3.0, 4.5, 6.0, 8.0)
"""Widths of the boxes in pixels; the first leaves the image unchanged."""

BOX_SIDE = 9
"""Side of the boxes' kernels in pixels: the widest box, and the pixels that it covers in part."""

FILTERS = 32, 48
"""Number of filters at half and at a quarter of the resolution."""

INITIAL_LOGIT = 4.0
"""Initial logit of the first box: training starts near shift-and-sum."""

MAX_LOGIT = 20.0
"""Largest absolute logit, so that no weight is infinite."""


def build_aperturenet(seed: int = 0) -> keras.Model:
    """Build the network.

    Half the resolution, and a quarter for large displacements, is enough to measure how much the
    views differ. All sharp detail comes from the mean of the views.

    Parameters
    ----------
    seed : int, optional
        Seed of the initial weights, He-normal.

    Returns
    -------
    keras.Model
        Model with input (h, w, 9), the aligned views, sides multiples of 4; output (h, w, 1), not
        clipped.

    Examples
    --------
    >>> from lf_flame.systems import build_aperturenet
    >>> build_aperturenet(seed=1).count_params() > 10_000
    True
    """
    views = keras.Input((None, None, VIEWS), name="aligned_views")
    features = _features(views, seed)
    logits = _zero_convolution(len(WIDTHS), "box_logits")(features)
    logits += np.array([INITIAL_LOGIT] + [0] * (len(WIDTHS) - 1), np.float32)
    weights = ops.exp(ops.clip(logits, -MAX_LOGIT, MAX_LOGIT))
    mixed = ops.mean(weights * _blurred_means(views), -1, True) / ops.mean(weights, -1, True)
    correction = _zero_convolution(1, "correction")(features)
    return keras.Model(views, mixed + correction, name="aperturenet")


def _features(views, seed: int):
    """Features of the differences between the views: (h/2, w/2, 32)."""
    numbers = iter(range(1000 * seed, 1000 * seed + 1000))

    def convolution(filters: int, side: int, kind=layers.Conv2D, **options):
        initial = keras.initializers.HeNormal(seed=next(numbers))
        return kind(filters, side, padding="same", kernel_initializer=initial, **options)

    half, quarter = FILTERS
    near = views - ops.mean(views, axis=-1, keepdims=True)
    near = convolution(half, 4, strides=2, activation="relu")(near)
    far = convolution(quarter, 3, strides=2, activation="relu")(near)
    for _ in range(2):
        far = convolution(quarter, 3, activation="relu")(far)
    far = convolution(half, 2, layers.Conv2DTranspose, strides=2)(far)
    x = layers.ReLU()(layers.Add()([near, far]))
    return convolution(half, 3, activation="relu")(x)


def _zero_convolution(filters: int, name: str):
    """Make a convolution to twice the resolution with zero weights: no effect before training."""
    return layers.Conv2DTranspose(
        filters, 4, strides=2, padding="same", kernel_initializer="zeros", name=name
    )


def _blurred_means(views):
    """Blur the mean of the views by every box: (h, w, boxes)."""
    boxes = layers.Conv2D(
        len(WIDTHS), BOX_SIDE, padding="same", use_bias=False, trainable=False, name="boxes"
    )
    boxes.build((None, None, None, 1))
    boxes.set_weights([make_boxes()])
    mean = ops.mean(views, axis=-1, keepdims=True)
    return boxes(mean) / boxes(ops.ones_like(mean))  # the divisor is below 1 at the edges


def make_boxes() -> np.ndarray:
    """Make boxes of `WIDTHS` with partly covered pixels: float32, (9, 9, 1, boxes)."""
    distances = np.abs(np.arange(BOX_SIDE) - BOX_SIDE // 2)
    lines = [np.clip(width / 2 - distances + 0.5, 0, 1) for width in WIDTHS]
    squares = [np.outer(line, line) / line.sum() ** 2 for line in lines]
    return np.stack(squares, axis=-1)[:, :, None].astype(np.float32)


class ApertureNet(NetworkSystem):
    """ApertureNet applied to a light field."""

    name = "ApertureNet (ours)"
    smallest = 35
    multiple = 4

    def view_indices(self, rows: int, columns: int) -> ViewIndices:
        """Choose the views at the centres of 3 x 3 equal parts of the aperture."""
        return square_of_views(rows, columns, SIDE)
