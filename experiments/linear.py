"""Two linear rivals of the networks: a ridge regression, and a bound on linear decoders."""

from itertools import pairwise

import numpy as np

from lf_flame.datasets.store import Dataset

RIDGE = "linear: ridge from the picture, no network"

STRENGTHS = [float(f"1e{k}") for k in range(-8, 3)]
"""Strengths to choose from, relative to the mean of the kernel's diagonal."""


class Ridge:
    """Ridge regression from the network's own picture to the images of the training samples.

    With centred pictures P and images I, one sample per row, a new picture p is given the image
    (Hoerl and Kennard 1970, in the dual form of Saunders, Gammerman and Vovk 1998)

        mean image + (p - mean picture) P^T (P P^T + strength * k)^-1 I,

    where k is the mean of the diagonal of P P^T. The strength is that of the lowest validation
    loss, by which the network's epoch is chosen too. `parts` are the indices of the samples by
    "train" and "validation".
    """

    def __init__(self, dataset: Dataset, parts: dict[str, np.ndarray]):
        inputs, targets, train = dataset.inputs, dataset.targets, parts["train"]
        pictures, images = (_rows(x[train]).astype(float) for x in (inputs, targets))
        self.shape, self.mean_image = targets.shape[1:], images.mean(axis=0)
        self.mean_picture = pictures.mean(axis=0)
        self.centred = pictures - self.mean_picture
        images -= self.mean_image
        values, directions = np.linalg.eigh(self.centred @ self.centred.T)
        rotated = directions.T @ images
        del images
        truth, scale = targets[parts["validation"]], values.mean() or 1.0  # of equal pictures
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


def project(
    train_targets: np.ndarray, test_targets: np.ndarray, k: int, bands: int = 1
) -> np.ndarray:
    """Project test targets onto the first k components of training targets, clipped to [0, 1].

    After the pooling, the paper's decoder has k = 256 numbers; a dense layer turns them into a
    fixed offset plus k fixed pictures, each times its number. Among all such sets of pictures, the
    first k principal components of the training targets leave the smallest squared error on these
    targets (Eckart and Young 1936), and projecting a test target onto them gives its best numbers,
    which no network knows. The PSNR of the projections therefore bounds linear decoders.

    Targets have the shape (n, plane, h, w). Bands are vertical parts of the image whose contents
    are independent of one another; each component then lies in one band. Without them, chance
    correlations in few samples spoil the components, and the bound comes out too low.
    """
    mean = train_targets.mean(axis=0, dtype=float).astype(np.float32)
    train, test = train_targets - mean, test_targets - mean
    edges = np.linspace(0, train.shape[-1], bands + 1).astype(int)
    parts = [(..., slice(*pair)) for pair in pairwise(edges)]
    spectra = [np.linalg.svd(_rows(train[part]), full_matrices=False)[1:] for part in parts]
    values = np.sort(np.concatenate([values for values, _ in spectra]))[::-1]
    least = max(values[:k][-1], 1e-6 * values[0], np.finfo(np.float32).tiny)
    projected = np.zeros_like(test)
    for part, (values, pictures) in zip(parts, spectra, strict=True):
        kept = pictures[values >= least]
        projected[part] = (_rows(test[part]) @ kept.T @ kept).reshape(test[part].shape)
    return np.clip(projected + mean, 0, 1)


def _rows(samples: np.ndarray) -> np.ndarray:
    return samples.reshape(len(samples), -1)
