"""Least squares of images that a linear layer and a sigmoid draw from few numbers.

Regression of logits (`lf_flame.learning.ridge`) asks a dark pixel to be right to the same share of
its value as a bright one. What is wanted is the smallest error of the image itself. Its equations
are not linear, but each pixel has its own, in few unknowns: damped Gauss-Newton steps (Levenberg
1944, Marquardt 1963; Madsen, Nielsen & Tingleff 2004, section 3.2) for all pixels side by side.
"""

import numpy as np
from scipy.special import expit

DAMPING = 1e-2
"""First damping, relative to the normal matrix's diagonal; ten times more after a step in vain."""

LEAST_CURVATURE = 1e-6
"""Unknowns that hardly change a pixel are damped as if they had this share of the largest."""

MATRIX_BYTES = 1 << 26
"""Memory of the normal matrices; as many pixels are refined at a time as fit."""

IMAGE_BYTES = 1 << 28
"""Memory of what is drawn of these pixels; with very many samples there are fewer of them."""

SAMPLES = 2048
"""Samples that enter the normal matrices at a time."""


def refine(
    numbers: np.ndarray,
    images: np.ndarray,
    drawings: np.ndarray,
    offset: np.ndarray,
    steps: int = 2,
) -> tuple[np.ndarray, np.ndarray]:
    """Lower the squared error of ``sigmoid(numbers @ drawings + offset)``, pixel by pixel.

    Parameters
    ----------
    numbers : ndarray, shape (n, count)
        What each sample is drawn from.
    images : ndarray, shape (n, pixels)
        What should be drawn, in [0, 1].
    drawings : ndarray, shape (count, pixels)
    offset : ndarray, shape (pixels,)
        Where to begin.
    steps : int, optional
        Steps of each pixel. A step that would raise a pixel's error is not taken.

    Returns
    -------
    ndarray of float32, shape (count, pixels)
        Better drawings.
    ndarray of float32, shape (pixels,)
        Better offset.
    """
    known = np.column_stack([numbers, np.ones(len(numbers))]).astype(np.float32)
    unknown = np.vstack([drawings, offset]).astype(np.float32)
    pixels = min(MATRIX_BYTES // (8 * len(unknown) ** 2), IMAGE_BYTES // (4 * len(known)))
    pixels = max(pixels, 1)
    for first in range(0, unknown.shape[1], pixels):
        part = slice(first, first + pixels)
        unknown[:, part] = _refine_pixels(known, images[:, part], unknown[:, part], steps)
    return unknown[:-1], unknown[-1]


def _refine_pixels(known, images, unknown, steps: int) -> np.ndarray:
    damping = np.full(images.shape[1], DAMPING)
    drawn = expit(known @ unknown)
    error = _error(drawn, images)
    for _ in range(steps):
        matrices, sides = _normal_equations(known, images, drawn)
        tried = unknown + _solve_damped(matrices, sides, damping)
        drawn_then = expit(known @ tried)
        error_then = _error(drawn_then, images)
        better = error_then < error
        unknown = np.where(better, tried, unknown)
        drawn = np.where(better, drawn_then, drawn)
        error = np.where(better, error_then, error)
        damping = np.where(better, damping, 10 * damping)
    return unknown


def _error(drawn: np.ndarray, images: np.ndarray) -> np.ndarray:
    """Squared error of each pixel."""
    return np.sum((drawn - images) ** 2, axis=0, dtype=float)


def _normal_equations(known, images, drawn) -> tuple[np.ndarray, np.ndarray]:
    """J'J (pixels, unknowns, unknowns) and J'(image - drawn); J: the sigmoid's slope times x."""
    unknowns = known.shape[1]
    row, column = np.triu_indices(unknowns)
    triangles = np.zeros((images.shape[1], len(row)))
    sides = np.zeros((images.shape[1], unknowns))
    for first in range(0, len(known), SAMPLES):
        part = slice(first, first + SAMPLES)
        x, value = known[part], drawn[part]
        slope = value * (1 - value)
        triangles += (slope * slope).T @ (x[:, row] * x[:, column])
        sides += (slope * (images[part] - value)).T @ x
    matrices = np.empty((len(sides), unknowns, unknowns))
    matrices[:, row, column] = matrices[:, column, row] = triangles
    return matrices, sides


def _solve_damped(matrices, sides, damping) -> np.ndarray:
    """Marquardt's step of each pixel, shape (unknowns, pixels)."""
    diagonal = np.einsum("pkk->pk", matrices)
    scale = np.maximum(diagonal, LEAST_CURVATURE * diagonal.max(axis=1, keepdims=True))
    diagonal += damping[:, None] * np.maximum(scale, np.finfo(float).tiny)
    return np.linalg.solve(matrices, sides[..., None])[..., 0].T.astype(np.float32)
