"""Ridge regression of images on features, its strength chosen on samples that were held out.

The regression is done on the samples' inner products (Saunders et al. 1998), so the number of
features costs next to nothing. Images are regressed as logits, which a sigmoid turns back.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh
from scipy.special import expit, logit

FLOOR = 1e-3
"""Images are clipped to [FLOOR, 1 - FLOOR] before the logit."""

STRENGTHS = 10.0 ** np.arange(-4.0, 0.1, 0.5)
"""Strengths that are tried, relative to the mean square of the features about their mean."""

PRECISION = 1e-10
"""Components whose mean square is a smaller share of the largest one are rounding errors."""


@dataclass(frozen=True)
class Regression:
    """What ridge regression found: logits = (features - mean) @ centred.T @ dual + offset.

    Parameters
    ----------
    centred : ndarray of float32, shape (n, features)
        Training features about their mean.
    mean : ndarray of float32, shape (features,)
    dual : ndarray of float32, shape (n, pixels)
    offset : ndarray of float32, shape (pixels,)
    strength : float
        The one of `STRENGTHS` with the lowest error on the held-out samples.
    """

    centred: np.ndarray
    mean: np.ndarray
    dual: np.ndarray
    offset: np.ndarray
    strength: float

    def weights(self) -> np.ndarray:
        """Weights of the features, shape (features, pixels)."""
        return self.centred.T @ self.dual

    def components(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Best approximation by few numbers: the principal components of what was fitted.

        Reduced-rank regression (Izenman 1975), each pixel weighted by how much its value changes
        with its logit: nobody sees by how much a black pixel is black.

        Returns
        -------
        ndarray of float32, shape (features, count)
            Weights of the features in each number; over the samples it has mean square 1.
        ndarray of float32, shape (count, pixels)
            Logits that one unit of each number adds. What the samples do not determine is zero.
        """
        samples, pixels = self.dual.shape
        fitted = (self.centred @ self.centred.T) @ self.dual
        value = expit(fitted + self.offset)
        weighted = fitted * np.mean((value * (1 - value)) ** 2, axis=0)
        gram = weighted.astype(float) @ fitted.T.astype(float)
        most = (max(samples - count, 0), samples - 1)
        squares, scores = eigh(gram, subset_by_index=most)
        real = np.flatnonzero(squares > PRECISION * squares[-1])[::-1]
        scores = scores[:, real].astype(np.float32) * np.sqrt(samples, dtype=np.float32)
        weights = np.zeros((self.centred.shape[1], count), np.float32)
        images = np.zeros((count, pixels), np.float32)
        duals = self.dual @ (weighted.T @ scores / squares[real].astype(np.float32))
        weights[:, : len(real)] = self.centred.T @ duals
        images[: len(real)] = scores.T @ fitted / samples
        return weights, images


def ridge_regression(training: tuple, held_out: tuple) -> Regression:
    """Regress images on features.

    Parameters
    ----------
    training, held_out : (ndarray, ndarray)
        Features, shape (n, features), and images in [0, 1], shape (n, pixels).

    Returns
    -------
    Regression
    """
    features, images = (np.asarray(x, np.float32) for x in training)
    logits = logit(np.clip(images, FLOOR, 1 - FLOOR))
    mean, offset = features.mean(axis=0, dtype=float), logits.mean(axis=0, dtype=float)
    mean, offset = mean.astype(np.float32), offset.astype(np.float32)
    centred = features - mean
    squares, directions = eigh((centred @ centred.T).astype(float))
    squares = np.maximum(squares, 0)
    across = (held_out[0] - mean) @ centred.T
    turned = directions.T.astype(np.float32) @ (logits - offset)

    def attempt(strength: float) -> tuple[float, float, np.ndarray]:
        gain = 1 / (squares + max(strength * squares.mean(), np.finfo(float).tiny))
        dual = (directions * gain).astype(np.float32) @ turned
        error = np.mean((expit(across @ dual + offset) - held_out[1]) ** 2, dtype=float)
        return float(error), strength, dual

    best = attempt(STRENGTHS[0])
    for strength in STRENGTHS[1:]:
        found = attempt(strength)
        if found[0] >= best[0]:
            break  # the error has one minimum: too little noise taken out before, too much after
        best = found
    return Regression(centred, mean, best[2], offset, float(best[1]))
