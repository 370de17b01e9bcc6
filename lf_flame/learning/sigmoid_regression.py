"""Least-squares fit of images that are a sigmoid of a linear function of few numbers.

A regression of logits (`lf_flame.learning.ridge`) has the same relative accuracy for dark and
bright pixels. Here the error of the image itself is minimised. Its equations are nonlinear, but
separate for each pixel, with few unknowns: damped Gauss-Newton steps (Levenberg 1944, Marquardt
1963; Madsen, Nielsen & Tingleff 2004, section 3.2) run for all pixels in parallel.
"""

import numpy as np
from scipy.special import expit

DAMPING = 1e-2
"""First damping, relative to the normal matrix's diagonal; tenfold after each rejected step."""

LEAST_CURVATURE = 1e-6
"""Smallest scale of damping, relative to the largest unknown's, for unknowns of little effect."""

MATRIX_BYTES = 1 << 26
"""Memory in bytes for the normal matrices; it limits the number of pixels refined at a time."""

IMAGE_BYTES = 1 << 28
"""Memory in bytes for the images of these pixels; it limits them if there are many samples."""

SAMPLES = 2048
"""Number of samples that are added to the normal matrices at a time."""


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
        Numbers that determine each sample's image.
    images : ndarray, shape (n, pixels)
        True images, in [0, 1].
    drawings : ndarray, shape (count, pixels)
        Logits per unit of each number, at the start.
    offset : ndarray, shape (pixels,)
        Logits for numbers of 0, at the start.
    steps : int, optional
        Number of steps of each pixel. A step that would raise a pixel's error is rejected.

    Returns
    -------
    ndarray of float32, shape (count, pixels)
        Refined `drawings`.
    ndarray of float32, shape (pixels,)
        Refined `offset`.
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
    """J'J (pixels, unknowns, unknowns) and J'(image - drawn); J is the sigmoid's slope times x."""
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
