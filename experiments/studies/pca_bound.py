"""Bound on a decoder that composes its images from k fixed pictures.

After the pooling, the paper's decoder has k = 256 numbers; a dense layer turns them into a fixed
offset plus k fixed pictures, each times its number. Among all such sets of pictures, the first k
principal components of the training targets leave the smallest squared error on these targets
(Eckart and Young 1936), and projecting a test target onto them gives its best numbers, which no
network knows. The PSNR of the projections therefore bounds linear decoders. The sigmoid after the
pictures may do a little better where much is black or saturated.
"""

import numpy as np
from scipy.linalg import eigh

MOST_SAMPLES = 4096
"""Maximum number of training targets for the components; the work grows with its cube."""


def project(
    train_targets: np.ndarray, test_targets: np.ndarray, k: int, bands: int = 1
) -> np.ndarray:
    """Project test targets onto the first k components of training targets, clipped to [0, 1].

    Targets have the shape (n, plane, h, w). Bands are vertical parts of the image whose contents
    are independent of one another; each component then lies in one band. Without them, chance
    correlations in few samples spoil the components, and the bound comes out too low.
    """
    train_targets = train_targets[:MOST_SAMPLES]
    mean = train_targets.mean(axis=0, dtype=float).astype(np.float32)
    train, test = train_targets - mean, test_targets - mean
    width = train.shape[-1]
    edges = [band * width // bands for band in range(bands + 1)]
    parts = [(..., slice(*pair)) for pair in zip(edges, edges[1:], strict=False)]
    spectra = [_spectrum(_flat(train[part])) for part in parts]
    largest = np.sort(np.concatenate([squares for squares, _ in spectra]))[-k:]
    least = min(largest[largest > np.finfo(np.float32).eps * largest[-1]], default=np.inf)
    projected = np.zeros_like(test)
    for part, (squares, directions) in zip(parts, spectra, strict=True):
        pictures, _ = np.linalg.qr(_flat(train[part]).T @ directions[:, squares >= least])
        projected[part] = (_flat(test[part]) @ pictures @ pictures.T).reshape(test[part].shape)
    return np.clip(projected + mean, 0, 1)


def _flat(x: np.ndarray) -> np.ndarray:
    return x.reshape(len(x), -1)


def _spectrum(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Squared singular values of (n, pixels), and their directions among the samples.

    From the inner products of the samples, because there are far fewer samples than pixels.
    """
    squares, directions = eigh((samples @ samples.T).astype(float))
    return squares, directions.astype(np.float32)
