"""The simplest rival: ridge regression from the network's own picture to the images, no network.

With centred pictures P and images I of the training samples, one sample a row, a new picture p is
given the image (Hoerl and Kennard 1970, in the dual form of Saunders, Gammerman and Vovk 1998)

    mean image + (p - mean picture) P^T (P P^T + strength * k)^-1 I,

where k is the mean of the diagonal of P P^T. The strength is that of the lowest validation loss, by
which the network's epoch is chosen too.
"""

import numpy as np

from lf_flame.datasets.store import Dataset

NAME = "linear: ridge from the picture, no network"

STRENGTHS = [float(f"1e{k}") for k in range(-8, 3)]
"""Strengths to choose from, relative to the mean of the kernel's diagonal."""


class Ridge:
    """Ridge regression fitted to the training samples of a data set.

    Any input encoding will do: the picture is the network's input. `parts` are the indices of the
    samples by "train" and "validation".
    """

    def __init__(self, dataset: Dataset, parts: dict[str, np.ndarray]):
        inputs, targets, train = dataset.inputs, dataset.targets, parts["train"]
        pictures, images = _rows(inputs[train]), _rows(targets[train])
        self.shape, self.mean_image = targets.shape[1:], images.mean(axis=0)
        self.mean_picture = pictures.mean(axis=0)
        self.centred = pictures - self.mean_picture
        images -= self.mean_image
        values, directions = np.linalg.eigh(self.centred @ self.centred.T)
        rotated = directions.T @ images
        del images
        truth, scale = targets[parts["validation"]], values.mean()
        kernel = (_rows(inputs[parts["validation"]]) - self.mean_picture) @ self.centred.T
        losses = {}
        for strength in STRENGTHS:
            found = self._images(kernel @ (directions / (values + strength * scale)) @ rotated)
            losses[strength] = np.mean((found - truth) ** 2)
        self.strength = min(losses, key=losses.__getitem__)
        self.weights = (directions / (values + self.strength * scale)) @ rotated

    def predict(self, inputs: np.ndarray) -> np.ndarray:
        """Predict the images (n, planes, h, w) of inputs (n, h', w', channels)."""
        return self._images(((_rows(inputs) - self.mean_picture) @ self.centred.T) @ self.weights)

    def _images(self, departures: np.ndarray) -> np.ndarray:
        images = np.clip(self.mean_image + departures, 0, 1)
        return images.astype(np.float32).reshape(-1, *self.shape)


def _rows(samples: np.ndarray) -> np.ndarray:
    return samples.reshape(len(samples), -1).astype(float)
