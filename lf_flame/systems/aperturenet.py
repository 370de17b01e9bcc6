"""ApertureNet, ours: nine views, each for a ninth of the aperture, and the widths of their blur.

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

from lf_flame.refocus import align_views
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

CONVINCED = 4.0
"""Initial logit of the first box: training starts from shift-and-sum."""

SURE = 20.0
"""Largest absolute logit, so that no weight is infinite."""

BLOCK = 2
"""Side of the blocks of pixels that space-to-depth moves into channels."""

PIXELS = BLOCK**2
"""Number of channels that replace one channel: the pixels of a block, row by row."""


def build_aperturenet(seed: int = 0) -> keras.Model:
    """Build the network.

    Half the resolution, and a quarter for large displacements, is enough to see how far the views
    disagree. All sharp detail comes from the mean of the views. Its pixels are moved, four by four,
    into the channels of half the resolution (space to depth; W. Shi et al., CVPR 2016), where
    convolutions have enough channels to be fast.

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
    # Networks that were trained before need the layers' names, such as "shares".
    seen = keras.Input((None, None, VIEWS), name="aligned_views")
    features = _see_disagreement(seen, seed)
    boxes = _box_weights(features)
    mixed = _mix_boxes(boxes, _blurred_means(seen))
    correction = _from_zero(PIXELS, "correction")(features)
    return keras.Model(seen, _depth_to_space(mixed + correction), name="aperturenet")


def _see_disagreement(seen, seed: int):
    """Compute features from the differences of the views: (h/2, w/2, 32)."""
    numbers = iter(range(1000 * seed, 1000 * seed + 1000))

    def convolution(filters: int, side: int, kind=layers.Conv2D, **options):
        initial = keras.initializers.HeNormal(seed=next(numbers))
        return kind(filters, side, padding="same", kernel_initializer=initial, **options)

    half, quarter = FILTERS
    near = seen - ops.mean(seen, axis=-1, keepdims=True)
    near = convolution(half, 4, strides=2, activation="relu")(near)
    far = convolution(quarter, 3, strides=2, activation="relu")(near)
    for _ in range(2):
        far = convolution(quarter, 3, activation="relu")(far)
    far = convolution(half, 2, layers.Conv2DTranspose, strides=2)(far)
    x = layers.ReLU()(layers.Add()([near, far]))
    return convolution(half, 3, activation="relu")(x)


def _box_weights(features):
    """Weights of the boxes for each pixel, above 0: (h/2, w/2, box and pixel of a block)."""
    channels = PIXELS * len(WIDTHS)
    first_box = np.float32([CONVINCED] * PIXELS + [0] * (channels - PIXELS))
    logits = _from_zero(channels, "shares")(features) + first_box
    return ops.exp(ops.clip(logits, -SURE, SURE))


def _blurred_means(seen):
    """Blur the mean of the views by every box: (h/2, w/2, box and pixel of a block)."""
    mean = _fixed("mean_in_quads", _mean_to_depth(), strides=BLOCK)(seen)
    boxes = _fixed("boxes", _kernels_in_depth(make_boxes()))
    return boxes(mean) / boxes(ops.ones_like(mean))  # the divisor is below 1 at the edges


def _mix_boxes(weights, blurred):
    """Average the boxes with their weights, for each pixel: (h/2, w/2, pixel of a block)."""
    every_box = np.tile(np.eye(PIXELS), (len(WIDTHS), 1))[None, None]
    over_boxes = _fixed("over_boxes", every_box)
    return over_boxes(weights * blurred) / over_boxes(weights)


def _depth_to_space(x):
    """Move the pixels of the blocks back to their places: (h, w, 1)."""
    back = np.eye(PIXELS).reshape(BLOCK, BLOCK, 1, PIXELS)
    return _fixed("image", back, layers.Conv2DTranspose, strides=BLOCK)(x)


def _from_zero(filters: int, name: str):
    """Make a convolution with zero weights, which contributes nothing until it has learnt."""
    return layers.Conv2D(filters, 3, padding="same", kernel_initializer="zeros", name=name)


def _fixed(name: str, kernel: np.ndarray, kind=layers.Conv2D, **options):
    """Make a convolution with fixed weights."""
    transposed = kind is layers.Conv2DTranspose
    layer = kind(
        kernel.shape[2 if transposed else 3], kernel.shape[:2], padding="same", use_bias=False,
        trainable=False, name=name, **options,
    )  # fmt: skip
    layer.build((None, None, None, kernel.shape[3 if transposed else 2]))
    layer.set_weights([kernel])
    return layer


def _mean_to_depth() -> np.ndarray:
    """Kernel of the mean over the views, from space to depth: (2, 2, 9, 4)."""
    return np.repeat(np.eye(PIXELS).reshape(BLOCK, BLOCK, 1, PIXELS), VIEWS, axis=2) / VIEWS


def _kernels_in_depth(kernels: np.ndarray) -> np.ndarray:
    """Turn kernels (side, side, 1, count) into one that does the same on pixels in channels.

    It leads from the pixels of a block to every kernel's result there: (blocks, blocks, 4, count *
    4).
    """
    side, count = kernels.shape[0], kernels.shape[3]
    reach = -(-(side // 2) // BLOCK)
    out = np.zeros((2 * reach + 1,) * 2 + (BLOCK, BLOCK, count, BLOCK, BLOCK))
    for i, j, a, b in np.ndindex(side, side, BLOCK, BLOCK):
        # Pixel (a, b) of a block reads this pixel of the block at this offset.
        (down, row), (right, column) = (divmod(n - side // 2, BLOCK) for n in (i + a, j + b))
        out[down + reach, right + reach, row, column, :, a, b] = kernels[i, j, 0]
    return out.reshape(*out.shape[:2], PIXELS, count * PIXELS)


def make_boxes() -> np.ndarray:
    """Make boxes of `WIDTHS` with partly covered pixels: float32, (9, 9, 1, boxes)."""
    distances = np.abs(np.arange(BOX_SIDE) - BOX_SIDE // 2)
    lines = [np.clip(width / 2 - distances + 0.5, 0, 1) for width in WIDTHS]
    squares = [np.outer(line, line) / line.sum() ** 2 for line in lines]
    return np.stack(squares, axis=-1)[:, :, None].astype(np.float32)


class ApertureNet(NetworkSystem):
    """ApertureNet applied to a light field."""

    name = "ApertureNet (ours)"
    smallest = 37
    multiple = 4

    def view_indices(self, rows: int, columns: int) -> ViewIndices:
        """Choose the views at the centres of 3 x 3 equal parts of the aperture."""
        return square_of_views(rows, columns, SIDE)

    def show(self, views: np.ndarray, slopes: np.ndarray, block) -> np.ndarray:
        """Align the nine views."""
        aligned = align_views(views, slopes, self.view_indices(*views.shape[:2]), block=block)
        return np.moveaxis(aligned, 1, -1)
