"""ApertureNet, ours: nine views, each for a ninth of the aperture, and how wide to blur them.

Cut the square aperture of the main lens into 3 x 3 squares, and take the view in the middle of
each. Something out of focus, whose image moves by d pixels over the whole aperture, moves by d / 3
within a square. So what all the views of a square would have drawn is its middle view, blurred by
a box d / 3 wide; and the mean of the nine, so blurred, is what all views together give. That is
exact for things at one depth and views without gaps; only d, for each pixel, is not known.
(Shift-and-sum of nine views takes it for 0, and shows ghosts.) In a round aperture the parts at the
corners count for less, and the rest of it is for the network to learn.

So the network has one thing to find: how wide. From the aligned views it draws, for each pixel, the
weights of some boxes, and mixes the blurred means by them (as kernel-predicting networks mix
filters: S. Bako et al., ACM Transactions on Graphics 36(4), 2017); a small correction is added for
what no box does, such as edges that hide something. It is fully convolutional and sees slopes only
through the alignment: any slope and any size will do.
"""

import keras
import numpy as np
from keras import layers, ops

from lf_flame.refocus import align_views, round_aperture
from lf_flame.systems.base import NetworkSystem, ViewIndices
from lf_flame.systems.view_selection import square_of_views

SIDE = 3
VIEWS = SIDE**2

ROUND = round_aperture((SIDE, SIDE))
"""How much of each part lies in the round aperture that touches the square's sides."""

WIDTHS = (1.0, 2.0, 3.0, 4.5, 6.0, 8.0)
"""Of the boxes, in pixels; the first leaves the picture as it is."""

BOX_SIDE = 9
"""Pixels along the sides of the boxes' kernels: the widest box, and what it covers in part."""

FILTERS = 32, 48
"""At half and at a quarter of the resolution."""

CONVINCED = 4.0
"""Logit by which the first box is preferred at the start: training starts from shift-and-sum."""

SURE = 20.0
"""Logits are cut off here, so that no weight is infinite."""

BLOCK = 2
"""Side of the blocks of pixels that space-to-depth moves into channels."""

PIXELS = BLOCK**2
"""Channels that one channel becomes: the pixels of a block, row by row."""


def build_aperturenet(seed: int = 0, view_weights: np.ndarray | None = None) -> keras.Model:
    """Build the network.

    Half the resolution, and a quarter for what moves far, is enough to see how far the views
    disagree. All that is sharp comes from the mean of the views, whose pixels are moved, four by
    four, into the channels of half the resolution (space to depth; W. Shi et al., CVPR 2016), where
    convolutions have enough of them to be fast.

    Parameters
    ----------
    seed : int, optional
        Of the initial weights, He-normal.
    view_weights : ndarray, shape (3, 3), optional
        How much each part of the aperture counts, as in `ROUND`. Default: all alike.

    Returns
    -------
    keras.Model
        Input (h, w, 9), the aligned views; sides multiples of 4. Output (h, w, 1), not clipped.

    Examples
    --------
    >>> from lf_flame.systems import build_aperturenet
    >>> build_aperturenet(seed=1).count_params() > 10_000
    True
    """
    # Names of layers, "shares" and "mean_in_quads" too, are those of networks trained before.
    seen = keras.Input((None, None, VIEWS), name="aligned_views")
    features = _see_disagreement(seen, seed)
    boxes = _box_weights(features)
    shares = np.ones((SIDE, SIDE)) if view_weights is None else np.asarray(view_weights)
    mixed = _mix_boxes(boxes, _blurred_means(seen, shares.ravel() / shares.sum()))
    correction = _from_zero(PIXELS, "correction")(features)
    return keras.Model(seen, _depth_to_space(mixed + correction), name="aperturenet")


def _see_disagreement(seen, seed: int):
    """From how the views differ, draw features at half the resolution: (h/2, w/2, 32)."""
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
    """For each pixel, how much each box counts, above 0: (h/2, w/2, box and pixel of a block)."""
    channels = PIXELS * len(WIDTHS)
    first_box = np.float32([CONVINCED] * PIXELS + [0] * (channels - PIXELS))
    logits = _from_zero(channels, "shares")(features) + first_box
    return ops.exp(ops.clip(logits, -SURE, SURE))


def _blurred_means(seen, shares: np.ndarray):
    """Blur the mean of the views by every box: (h/2, w/2, box and pixel of a block)."""
    mean = _fixed("mean_in_quads", _mean_to_depth(shares), strides=BLOCK)(seen)
    boxes = _fixed("boxes", _kernels_in_depth(make_boxes()))
    return boxes(mean) / boxes(ops.ones_like(mean))  # which at the edges is below 1


def _mix_boxes(weights, blurred):
    """Take the weighted mean over the boxes, for each pixel: (h/2, w/2, pixel of a block)."""
    every_box = np.tile(np.eye(PIXELS), (len(WIDTHS), 1))[None, None]
    over_boxes = _fixed("over_boxes", every_box)
    return over_boxes(weights * blurred) / over_boxes(weights)


def _depth_to_space(x):
    """Put the pixels of the blocks back in their places: (h, w, 1)."""
    back = np.eye(PIXELS).reshape(BLOCK, BLOCK, 1, PIXELS)
    return _fixed("image", back, layers.Conv2DTranspose, strides=BLOCK)(x)


def _from_zero(filters: int, name: str):
    """Make a convolution that starts at zero: until it has learnt something, it adds nothing."""
    return layers.Conv2D(filters, 3, padding="same", kernel_initializer="zeros", name=name)


def _fixed(name: str, kernel: np.ndarray, kind=layers.Conv2D, **options):
    """Make a convolution that does not learn."""
    transposed = kind is layers.Conv2DTranspose
    layer = kind(
        kernel.shape[2 if transposed else 3], kernel.shape[:2], padding="same", use_bias=False,
        trainable=False, name=name, **options,
    )  # fmt: skip
    layer.build((None, None, None, kernel.shape[3 if transposed else 2]))
    layer.set_weights([kernel])
    return layer


def _mean_to_depth(shares: np.ndarray) -> np.ndarray:
    """Kernel of the weighted mean over the views, from space to depth: (2, 2, 9, 4)."""
    return np.eye(PIXELS).reshape(BLOCK, BLOCK, 1, PIXELS) * shares[:, None]


def _kernels_in_depth(kernels: np.ndarray) -> np.ndarray:
    """Turn kernels for pixels into one that does the same on pixels moved into channels.

    Parameters
    ----------
    kernels : ndarray, shape (side, side, 1, count)

    Returns
    -------
    ndarray, shape (blocks, blocks, 4, count * 4)
        From the pixels of a block to every kernel's result at the pixels of a block.
    """
    side, count = kernels.shape[0], kernels.shape[3]
    reach = -(-(side // 2) // BLOCK)
    out = np.zeros((2 * reach + 1,) * 2 + (BLOCK, BLOCK, count, BLOCK, BLOCK))
    for i, j, a, b in np.ndindex(side, side, BLOCK, BLOCK):
        # Pixel (a, b) of a block reads this pixel of the block that far away.
        (down, row), (right, column) = (divmod(n - side // 2, BLOCK) for n in (i + a, j + b))
        out[down + reach, right + reach, row, column, :, a, b] = kernels[i, j, 0]
    return out.reshape(*out.shape[:2], PIXELS, count * PIXELS)


def make_boxes() -> np.ndarray:
    """Make boxes of `WIDTHS`, in pixels that they cover in part: float32, (9, 9, 1, boxes)."""
    distances = np.abs(np.arange(BOX_SIDE) - BOX_SIDE // 2)
    lines = [np.clip(width / 2 - distances + 0.5, 0, 1) for width in WIDTHS]
    squares = [np.outer(line, line) / line.sum() ** 2 for line in lines]
    return np.stack(squares, axis=-1)[:, :, None].astype(np.float32)


class ApertureNet(NetworkSystem):
    """ApertureNet on a light field."""

    name = "ApertureNet (ours)"
    smallest = 37
    multiple = 4

    def view_indices(self, rows: int, columns: int) -> ViewIndices:
        """Choose the views in the middles of 3 x 3 equal parts of the aperture."""
        return square_of_views(rows, columns, SIDE)

    def show(self, views: np.ndarray, slopes: np.ndarray, block) -> np.ndarray:
        """Align them."""
        aligned = align_views(views, slopes, self.view_indices(*views.shape[:2]), block=block)
        return np.moveaxis(aligned, 1, -1)
