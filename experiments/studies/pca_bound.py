"""What a decoder can reach at best that draws all its images from a few fixed pictures.

Behind the pooling, the paper's decoder has k = 256 numbers. A dense layer turns them into images:
a fixed offset plus the sum of k fixed pictures, each times its number. Whatever the network knows
of a scene, what it draws lies in that space of k dimensions.

Of all such spaces, the one of the first k principal components about the mean leaves the smallest
squared error on the samples that it was made from (Eckart and Young 1936); projecting a sample onto
it takes the best numbers for that sample. Here the pictures come from the training targets, as a
decoder's do, and the numbers from the test targets themselves, which no network is shown. The PSNR
of the projections is what remains to be lost to anything but the few numbers.

It bounds linear decoders whose pictures suit the training targets best. The sigmoid behind the
pictures bends the space, which may do a little better where much is black or saturated.
"""

import numpy as np
from scipy.linalg import eigh

from lf_flame.learning.scores import psnr

MOST_SAMPLES = 4096
"""Training targets that the components are made from; the work grows with the cube of them."""


def principal_component_bound(
    train_targets: np.ndarray, test_targets: np.ndarray, k: int, bands: int = 1
) -> np.ndarray:
    """Find the PSNR of test targets projected on the first k components of training targets.

    Targets [n, plane, h, w] are in [0, 1]; of the training targets the first `MOST_SAMPLES` count,
    and there are fewer components where they span fewer. Returns a mean over the test samples for
    each plane, in dB.

    Bands are vertical parts of the image whose contents are independent of one another. Each
    component then keeps to one band, as it does by itself when the samples are many. With few,
    chance correlations between objects side by side spoil the components for new samples, and the
    bound comes out too low.
    """
    drawn = project(train_targets, test_targets, k, bands)
    return np.mean(
        [list(map(psnr, *pair)) for pair in zip(test_targets, drawn, strict=True)], axis=0
    )


def project(
    train_targets: np.ndarray, test_targets: np.ndarray, k: int, bands: int = 1
) -> np.ndarray:
    """Draw test targets, clipped to [0, 1], from the components of training targets, see above."""
    train_targets = train_targets[:MOST_SAMPLES]
    mean = train_targets.mean(axis=0, dtype=float).astype(np.float32)
    train, test = train_targets - mean, test_targets - mean
    width = train.shape[-1]
    edges = [band * width // bands for band in range(bands + 1)]
    parts = [(..., slice(*pair)) for pair in zip(edges, edges[1:], strict=False)]
    spectra = [_spectrum(_flat(train[part])) for part in parts]
    largest = np.sort(np.concatenate([squares for squares, _ in spectra]))[-k:]
    least = min(largest[largest > np.finfo(np.float32).eps * largest[-1]], default=np.inf)
    drawn = np.zeros_like(test)
    for part, (squares, directions) in zip(parts, spectra, strict=True):
        pictures, _ = np.linalg.qr(_flat(train[part]).T @ directions[:, squares >= least])
        drawn[part] = (_flat(test[part]) @ pictures @ pictures.T).reshape(test[part].shape)
    return np.clip(drawn + mean, 0, 1)


def _flat(x: np.ndarray) -> np.ndarray:
    return x.reshape(len(x), -1)


def _spectrum(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Squares of the singular values of (n, pixels), and where they point among the samples.

    From the inner products of the samples, of which there are far fewer than pixels.
    """
    squares, directions = eigh((samples @ samples.T).astype(float))
    return squares, directions.astype(np.float32)
