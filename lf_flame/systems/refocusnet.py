"""RefocusNet: four views, aligned at the desired slope beforehand, become one refocused image.

S. Ben Dayan, D. Mendlovic, R. Giryes, "Deep Sparse Light Field Refocusing", BMVC 2020, arXiv
2009.02582. Layers, positions of the views and order of the channels are those of the authors'
program (shacharBD/LightFieldRefocusing at 941ceeb, MIT licence), whose trained weights it accepts.
"""

from pathlib import Path

import keras
import numpy as np
from keras import layers

from lf_flame._common.arrays_in_files import ArrayFile
from lf_flame.errors import InputError
from lf_flame.systems.base import NetworkSystem, ViewIndices
from lf_flame.systems.formulas import diamond_of_views

VIEWS = 4
COLOURS = 3
TRUNK = (1, 3, 5, 7, 9, 11)
"""Numbers of the trunk's convolutions, 64 channels each, as in the authors' program."""

TAPS = {0: 2, 1: 4, 3: 6, 5: 8, 7: 10, 9: 12, 11: 14}
"""Number of the linear convolution after each of them (0: after the input), 12 channels each."""

LAST = 15

OFFICIAL = "RefocusNet, the authors' weights"
"""Name of the system with these weights."""


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

    inputs = keras.Input((None, None, VIEWS * COLOURS), name="aligned_views")
    x, taps = inputs, [convolution(TAPS[0], VIEWS * COLOURS)(inputs)]
    for number in TRUNK:
        x = convolution(number, 64, "relu")(x)
        taps.append(convolution(TAPS[number], VIEWS * COLOURS)(x))
    total = layers.Add()(taps)
    views = [total[..., COLOURS * k : COLOURS * (k + 1)] for k in range(VIEWS)]
    image = layers.Add(name="image")([convolution(LAST, COLOURS)(total), layers.Average()(views)])
    return keras.Model(inputs, image, name="refocusnet")


class RefocusNet(NetworkSystem):
    """RefocusNet applied to a light field; grey becomes three equal colours.

    Parameters
    ----------
    model : keras.Model
        See `NetworkSystem`.
    colours : {1, 3}, optional
        Number of colours: 3 for weights that were trained on colours, such as the authors'. Ours
        were trained on grey, so they process one channel after the other.
    """

    name = "RefocusNet"
    smallest = 17

    def __init__(self, model: keras.Model, colours: int = 1):
        super().__init__(model)
        self.colours = colours

    @classmethod
    def of_weights(cls, path: str | Path) -> "RefocusNet":
        """Load the authors' trained weights, a file ``.npz`` with arrays ``w1``, ``b1`` ... ."""
        model = build_refocusnet()
        file = ArrayFile(path)
        for number in (*TRUNK, *TAPS.values(), LAST):
            layer, names = model.get_layer(f"w{number}"), (f"w{number}", f"b{number}")
            found = [file.header(x).shape if x in file.names else "missing" for x in names]
            wanted = [tuple(x.shape) for x in layer.weights]
            if found != wanted:
                raise InputError(
                    f"{path} does not contain RefocusNet's weights: {names[0]} and {names[1]} "
                    f"must have shapes {wanted[0]} and {wanted[1]}, got {found[0]} and "
                    f"{found[1]}."
                )
            layer.set_weights(file.read(names))
        system = cls(model, colours=COLOURS)
        system.name = OFFICIAL
        return system

    def view_indices(self, rows: int, columns: int) -> ViewIndices:
        """Choose a diamond half-way to the outermost views, in the authors' order."""
        return diamond_of_views(rows, columns)

    def prepare_input(self, views: np.ndarray, slopes: np.ndarray, block) -> np.ndarray:
        """Align the four views: red, green and blue of one after the other."""
        aligned = super().prepare_input(views, slopes, block)
        if views.ndim == 4:
            return np.repeat(aligned, COLOURS, axis=-1)
        return np.swapaxes(aligned, 3, 4).reshape(*aligned.shape[:3], VIEWS * COLOURS)

    def prepare_target(self, stack: np.ndarray) -> np.ndarray:
        """Repeat grey images in three colours."""
        return np.repeat(stack[..., None], COLOURS, axis=-1)

    def _apply(self, views: np.ndarray, slopes: np.ndarray, block: tuple[int, int]) -> np.ndarray:
        images = self.predict(self.prepare_input(views, slopes, block))
        return images if views.ndim == 5 else images.mean(axis=-1)
