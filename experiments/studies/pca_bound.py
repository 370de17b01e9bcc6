"""Bound on a decoder that composes its images from k fixed pictures.

After the pooling, the paper's decoder has k = 256 numbers; a dense layer turns them into a fixed
offset plus k fixed pictures, each times its number. Among all such sets of pictures, the first k
principal components of the training targets leave the smallest squared error on these targets
(Eckart and Young 1936), and projecting a test target onto them gives its best numbers, which no
network knows. The PSNR of the projections therefore bounds linear decoders. The sigmoid after the
pictures may do a little better where much is black or saturated.
"""

from itertools import pairwise

import numpy as np


def project(
    train_targets: np.ndarray, test_targets: np.ndarray, k: int, bands: int = 1
) -> np.ndarray:
    """Project test targets onto the first k components of training targets, clipped to [0, 1].

    Targets have the shape (n, plane, h, w). Bands are vertical parts of the image whose contents
    are independent of one another; each component then lies in one band. Without them, chance
    correlations in few samples spoil the components, and the bound comes out too low.
    """
    mean = train_targets.mean(axis=0, dtype=float).astype(np.float32)
    train, test = train_targets - mean, test_targets - mean
    edges = np.linspace(0, train.shape[-1], bands + 1).astype(int)
    parts = [(..., slice(*pair)) for pair in pairwise(edges)]
    spectra = [np.linalg.svd(_flat(train[part]), full_matrices=False)[1:] for part in parts]
    values = np.sort(np.concatenate([values for values, _ in spectra]))[::-1]
    least = max(values[:k][-1], 1e-6 * values[0], np.finfo(np.float32).tiny)
    projected = np.zeros_like(test)
    for part, (values, pictures) in zip(parts, spectra, strict=True):
        kept = pictures[values >= least]
        projected[part] = (_flat(test[part]) @ kept.T @ kept).reshape(test[part].shape)
    return np.clip(projected + mean, 0, 1)


def _flat(x: np.ndarray) -> np.ndarray:
    return x.reshape(len(x), -1)
