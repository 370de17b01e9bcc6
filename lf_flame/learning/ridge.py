"""Ridge regression of images on features, with the strength chosen on held-out samples.

The regression uses inner products with some of the samples, the landmarks (Saunders et al. 1998;
Smola & Schölkopf 2000 for a subset). The number of features therefore costs little, the time grows
only linearly with the number of samples, and each sample's features are used once and released.
Images are regressed as logits, which a sigmoid turns back.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh
from scipy.special import expit, logit

FLOOR = 1e-3
"""Distance from 0 and 1 to which images are clipped before the logit."""

STRENGTHS = 10.0 ** np.arange(-4.0, 0.1, 0.5)
"""Strengths of the regularisation that are tried, relative to the mean square of the centred
features."""

LANDMARKS = 2048
"""Number of samples (landmarks) whose features span the weights; up to it the ridge is exact."""

PRECISION = 1e-8
"""Mean square of a direction, relative to the largest, below which it is a rounding error."""

BLOCK = 1024
"""Number of samples with images that are processed together."""

VISIBILITY_SAMPLES = 512
"""Number of samples for the visibility of a pixel: a mean square is then known to some per cent."""


@dataclass(frozen=True)
class Products:
    """Inner products of samples' features with those of the landmarks.

    Attributes
    ----------
    landmarks : ndarray of float32, shape (m, features)
        Features of the first samples, minus the mean of these.
    mean : ndarray of float32, shape (features,)
        Mean of all samples.
    gram : ndarray of float32, shape (m, m)
        Inner products of the landmarks with each other.
    values : ndarray of float32, shape (n, m)
        Inner products of all features, minus their mean, with the landmarks.
    """

    landmarks: np.ndarray
    mean: np.ndarray
    gram: np.ndarray
    values: np.ndarray

    def of_others(self, features: np.ndarray) -> np.ndarray:
        """Inner products of other samples from their features: (n, features) to (n, m)."""
        return (features - self.mean) @ self.landmarks.T


class ProductGatherer:
    """Takes the features of samples block by block, and keeps their products with the landmarks.

    Parameters
    ----------
    count : int
        Number of samples that will be added.
    """

    def __init__(self, count: int):
        self._wanted = min(count, LANDMARKS)
        self._values = np.empty((count, self._wanted), np.float32)
        self._landmarks = self._centre = self._total = np.zeros(0)
        self._seen = 0

    def add(self, features: np.ndarray) -> None:
        """Add the next samples' features, shape (n, features)."""
        if not self._seen:
            self._landmarks = np.empty((self._wanted, features.shape[1]), np.float32)
            self._total = np.zeros(features.shape[1])
        self._total += features.sum(axis=0, dtype=float)
        first, last = self._seen, self._seen + len(features)
        self._seen = last
        if first < self._wanted:
            self._landmarks[first:last] = features[: self._wanted - first]
            if last >= self._wanted:
                self._settle()
        if last > self._wanted:
            later = max(first, self._wanted)
            about = features[later - first :] - self._centre
            self._values[later:last] = about @ self._landmarks.T

    def _settle(self) -> None:
        """Subtract the landmarks' mean from them as soon as they are complete."""
        self._centre = self._landmarks.mean(axis=0, dtype=float).astype(np.float32)
        self._landmarks -= self._centre
        self._values[: self._wanted] = self._landmarks @ self._landmarks.T

    def finish(self) -> Products:
        """Give the products when all samples have been added."""
        mean = (self._total / self._seen).astype(np.float32)
        gram = self._values[: self._wanted].copy()
        if self._seen > self._wanted:
            self._values -= (mean - self._centre) @ self._landmarks.T
        return Products(self._landmarks, mean, gram, self._values)


def gather_products(features: np.ndarray) -> Products:
    """Gather the products of features in one array, shape (n, features)."""
    gatherer = ProductGatherer(len(features))
    for part in _blocks(features):
        gatherer.add(features[part])
    return gatherer.finish()


@dataclass(frozen=True)
class Regression:
    """Result of a ridge regression.

    It predicts logits = (features - mean) @ landmarks.T @ turn @ images + offset.

    Parameters
    ----------
    landmarks, mean
        See `Products`.
    turn : ndarray of float32, shape (m, directions)
        Matrix from inner products with the landmarks to scores, orthogonal over the samples.
    squares : ndarray, shape (directions,)
        Sum of each score's squares over the samples.
    images : ndarray of float32, shape (directions, pixels)
        Logits that one unit of each score adds.
    offset : ndarray of float32, shape (pixels,)
        Mean logits.
    visibility : ndarray, shape (pixels,)
        Root mean square, over the first samples, of the derivative of a pixel's value with respect
        to its logit.
    samples : int
        Number of samples.
    strength : float
        Strength of `STRENGTHS` with the lowest error on the held-out samples.
    """

    landmarks: np.ndarray
    mean: np.ndarray
    turn: np.ndarray
    squares: np.ndarray
    images: np.ndarray
    offset: np.ndarray
    visibility: np.ndarray
    samples: int
    strength: float

    def weights(self) -> np.ndarray:
        """Weights of the features, shape (features, pixels)."""
        return self.of_features(self.turn @ self.images)

    def of_features(self, weights: np.ndarray) -> np.ndarray:
        """Turn weights of inner products, shape (m, k), into weights of features, (features, k)."""
        return self.landmarks.T @ weights

    def components(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Best approximation by few numbers: the principal components of the fitted values.

        This is reduced-rank regression (Izenman 1975), with each pixel weighted by the change of
        its value with its logit: differences between nearly black logits are invisible.

        Returns
        -------
        ndarray of float32, shape (m, count)
            Weights of the inner products in each number; over the samples it has mean square 1.
        ndarray of float32, shape (count, pixels)
            Logits that one unit of each number adds; 0 where the samples do not determine it.
        """
        length = np.sqrt(self.squares)[:, None]
        seen = (length * self.images * self.visibility).astype(np.float32)
        weights = np.zeros((len(self.landmarks), count), np.float32)
        images = np.zeros((count, self.images.shape[1]), np.float32)
        if not len(seen):  # all samples alike
            return weights, images
        least = max(len(seen) - count, 0)
        sizes, axes = eigh((seen @ seen.T).astype(float), subset_by_index=(least, len(seen) - 1))
        real = np.flatnonzero(sizes > PRECISION**2 * sizes[-1])[::-1]
        axes = axes[:, real]
        scale = (axes / length * np.sqrt(self.samples)).astype(np.float32)
        weights[:, : len(real)] = self.turn @ scale
        images[: len(real)] = (axes * length / np.sqrt(self.samples)).T @ self.images
        return weights, images


def ridge_regression(products: Products, images: np.ndarray, held_out: tuple) -> Regression:
    """Regress images on features.

    Parameters
    ----------
    products : Products
        Products of the samples' features.
    images : ndarray, shape (n, pixels)
        Images in [0, 1].
    held_out : (ndarray, ndarray)
        Features, shape (k, features), and images of other samples, for the choice of strength.

    Returns
    -------
    Regression
    """
    offset = _mean_logits(images)
    scores, turn, squares = _scores(products)
    sides = np.zeros((scores.shape[1], images.shape[1]))
    for part in _blocks(images):
        sides += scores[part].T @ (_logits(images[part]) - offset)
    mean_square = squares.sum() / len(images)
    held_out_scores = products.of_others(held_out[0]) @ turn

    def attempt(strength: float) -> tuple[float, float, np.ndarray]:
        found = (sides / (squares + strength * mean_square)[:, None]).astype(np.float32)
        error = np.mean((expit(held_out_scores @ found + offset) - held_out[1]) ** 2, dtype=float)
        return float(error), strength, found

    best = attempt(STRENGTHS[0])
    for strength in STRENGTHS[1:]:
        found = attempt(strength)
        if found[0] >= best[0]:
            break  # the error has a single minimum
        best = found
    value = expit(scores[:VISIBILITY_SAMPLES] @ best[2] + offset)
    visibility = np.sqrt(np.mean((value * (1 - value)) ** 2, axis=0, dtype=float))
    return Regression(
        products.landmarks, products.mean, turn, squares, best[2], offset, visibility,
        len(images), float(best[1]),
    )  # fmt: skip


def _scores(products: Products) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Orthogonal scores of the samples, the matrix to them, and the sums of their squares."""
    squares, axes = _principal_axes(products.gram)
    turn = axes / np.sqrt(squares)
    if len(products.values) == len(products.gram):
        scores = axes * np.sqrt(squares)  # equals values @ turn, without its rounding
    else:
        scores = products.values @ turn.astype(np.float32)
        squares, axes = _principal_axes(scores.T @ scores)
        scores, turn = scores @ axes.astype(np.float32), turn @ axes
    return scores.astype(np.float32), turn.astype(np.float32), squares


def _principal_axes(gram: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the sums of squares along the principal axes, and the axes, shape (m, axes)."""
    if not len(gram):
        return np.zeros(0), np.zeros((0, 0))
    squares, axes = eigh(gram.astype(float))
    real = squares > PRECISION * max(squares[-1], np.finfo(float).tiny)
    return squares[real], axes[:, real]


def _mean_logits(images) -> np.ndarray:
    total = sum(_logits(images[part]).sum(axis=0, dtype=float) for part in _blocks(images))
    return (total / len(images)).astype(np.float32)


def _logits(images) -> np.ndarray:
    return logit(np.clip(images, FLOOR, 1 - FLOOR, dtype=np.float32))


def _blocks(samples) -> Iterator[slice]:
    return (slice(first, first + BLOCK) for first in range(0, len(samples), BLOCK))
