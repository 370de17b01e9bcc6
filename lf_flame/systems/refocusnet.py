"""RefocusNet: four views, aligned at the desired slope beforehand, become one refocused image.

S. Ben Dayan, D. Mendlovic, R. Giryes, "Deep Sparse Light Field Refocusing", BMVC 2020, arXiv
2009.02582. Layers, positions of the views and order of the channels are those of the authors'
program (shacharBD/LightFieldRefocusing at 941ceeb, MIT licence), whose trained weights it accepts.
"""

from pathlib import Path

import keras
import numpy as np
from keras import layers

from lf_flame._common.arrays_in_files import open_arrays
from lf_flame.errors import InputError
from lf_flame.refocus import align_views
from lf_flame.systems.base import NetworkSystem, ViewIndices
from lf_flame.systems.formulas import diamond_of_views

VIEWS = 4
COLOURS = 3
TRUNK = (1, 3, 5, 7, 9, 11)
"""Numbers of the trunk's convolutions, 64 channels each, as in the authors' program."""

TAPS = {0: 2, 1: 4, 3: 6, 5: 8, 7: 10, 9: 12, 11: 14}
"""Number of the linear convolution after each of them (0: after the input), 12 channels each."""

LAST = 15

RECEPTIVE_FIELD = 17

OFFICIAL = "the authors' weights"
"""Words for these weights in a network's name."""


def build_refocusnet(seed: int = 0) -> keras.Model:
    """Build the network of the authors' program; 234,795 parameters.

    It has six 3 x 3 convolutions of 64 channels with ReLU, and a linear one of 12 channels after
    each and after the input. These seven are summed; a last convolution of the sum to three colours
    is added to the mean of the sum's four views.

    Parameters
    ----------
    seed : int, optional
        Seed of the initial weights, Glorot-uniform.

    Returns
    -------
    keras.Model
        Model with input (h, w, 12), of any size: red, green and blue of one aligned view after the
        other; output (h, w, 3), not clipped.

    Examples
    --------
    >>> from lf_flame.systems import build_refocusnet
    >>> build_refocusnet(seed=1).count_params() > 10_000
    True
    """

    def convolution(number: int, filters: int, activation: str | None = None) -> layers.Conv2D:
        initial = keras.initializers.GlorotUniform(seed=1000 * seed + number)
        return layers.Conv2D(
            filters, 3, padding="same", activation=activation, kernel_initializer=initial,
            name=f"w{number}",
        )  # fmt: skip

    seen = keras.Input((None, None, VIEWS * COLOURS), name="aligned_views")
    x, taps = seen, [convolution(TAPS[0], VIEWS * COLOURS)(seen)]
    for number in TRUNK:
        x = convolution(number, 64, "relu")(x)
        taps.append(convolution(TAPS[number], VIEWS * COLOURS)(x))
    total = layers.Add()(taps)
    views = [total[..., COLOURS * k : COLOURS * (k + 1)] for k in range(VIEWS)]
    image = layers.Add(name="image")([convolution(LAST, COLOURS)(total), layers.Average()(views)])
    return keras.Model(seen, image, name="refocusnet")


def load_official_weights(model: keras.Model, path: str | Path) -> None:
    """Load the authors' trained weights, a file ``.npz`` with the arrays ``w1``, ``b1`` ... ."""
    with open_arrays(path) as file:
        for number in (*TRUNK, *TAPS.values(), LAST):
            layer, names = model.get_layer(f"w{number}"), (f"w{number}", f"b{number}")
            found = [file.header(name).shape if name in file.names else "missing" for name in names]
            wanted = [tuple(x.shape) for x in layer.weights]
            if found != wanted:
                raise InputError(
                    f"{path} does not hold RefocusNet's weights: {names[0]} and {names[1]} must "
                    f"have shapes {wanted[0]} and {wanted[1]}, got {found[0]} and {found[1]}."
                )
            layer.set_weights(file.read(names))


class RefocusNet(NetworkSystem):
    """RefocusNet applied to a light field; grey becomes three equal colours.

    Parameters
    ----------
    model, name
        See `NetworkSystem`.
    colours : {1, 3}, optional
        Number of colours: 3 for weights that were trained on colours, such as the authors'. Ours
        were trained on grey, so they process one channel after the other.
    """

    name = "RefocusNet"
    smallest = RECEPTIVE_FIELD

    def __init__(self, model: keras.Model, name: str | None = None, colours: int = 1):
        super().__init__(model, name)
        self.colours = colours

    @classmethod
    def of_weights(cls, path: str | Path) -> "RefocusNet":
        """Load the authors' trained weights, see `load_official_weights`."""
        model = build_refocusnet()
        load_official_weights(model, path)
        return cls(model, f"{cls.name}, {OFFICIAL}", colours=COLOURS)

    def view_indices(self, rows: int, columns: int) -> ViewIndices:
        """Choose a diamond half-way to the outermost views, in the authors' order."""
        return diamond_of_views(rows, columns)

    def show(self, views: np.ndarray, slopes: np.ndarray, block: tuple[int, int]) -> np.ndarray:
        """Align the four views: red, green and blue of one after the other."""
        aligned = align_views(views, slopes, self.view_indices(*views.shape[:2]), block=block)
        if views.ndim == 4:
            aligned = np.repeat(aligned[..., None], COLOURS, axis=-1)
        n, _, height, width, _ = aligned.shape
        return np.moveaxis(aligned, 1, 3).reshape(n, height, width, VIEWS * COLOURS)

    def truth(self, stack: np.ndarray) -> np.ndarray:
        """Repeat grey images in three colours."""
        return np.repeat(stack[..., None], COLOURS, axis=-1)

    def _draw(self, views: np.ndarray, slopes: np.ndarray, block: tuple[int, int]) -> np.ndarray:
        images = self.predict(self.show(views, slopes, block))
        return images if views.ndim == 5 else images.mean(axis=-1)
