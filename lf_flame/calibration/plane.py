"""Scale, distortion and slope of a flat target at the centre of the image, from all its corners."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from lf_flame.errors import InputError


@dataclass(frozen=True)
class LatticeFit:
    """Scale of a lattice at the centre of the image, and its radial distortion.

    Attributes
    ----------
    scale, scale_error : float
        Number of squares per lenslet, and its standard error.
    distortion, distortion_error : float
        Coefficient k of ``r (1 + k r^2)``, by which a distance r in lenslets from the centre is
        multiplied to be free of distortion, per lenslet squared, and its standard error.
    residual : float
        Distance of a corner from the lattice, root mean square, in squares.
    """

    scale: float
    scale_error: float
    distortion: float
    distortion_error: float
    residual: float


def inverse(matrix: np.ndarray) -> np.ndarray:
    """Invert a matrix of a fit; refuse one that is singular to rounding."""
    scale = np.sqrt(np.diag(matrix))
    even = matrix / scale[:, None] / scale
    if not (np.all(np.isfinite(even)) and np.linalg.cond(even) < 1e14):
        raise InputError(
            "The corners of a target must spread over the picture, and the depths of the targets "
            "be far apart; from these the law cannot be told."
        )
    return np.linalg.inv(even) / scale[:, None] / scale


def fit_lattice(
    indices: np.ndarray, points: np.ndarray, distortion: float | None = 0.0
) -> LatticeFit:
    """Fit ``index = i0 + A x' / (1 + g x')``, a plane in perspective, with x' = x (1 + k x^2).

    The root of the determinant of A is the scale at the centre of the image, where x = 0.
    """
    affine, *_ = np.linalg.lstsq(
        np.column_stack([np.ones(len(points)), points]), indices.astype(float), rcond=None
    )
    size = float(np.abs(points).max())

    def residuals(p: np.ndarray) -> np.ndarray:
        k = distortion if distortion is not None else p[8] / size**2
        straight = points * (1 + k * np.sum(points**2, axis=1, keepdims=True))
        plane = straight @ p[2:6].reshape(2, 2) / (1 + straight @ p[6:8, None] / size)
        return (p[:2] + plane - indices).ravel()

    start = np.concatenate([affine[0], affine[1:].ravel(), np.zeros(2 + (distortion is None))])
    fit = least_squares(residuals, start, x_scale="jac", method="lm", xtol=1e-14, ftol=1e-14)
    freedom = max(fit.fun.size - fit.x.size, 1)
    covariance = inverse(fit.jac.T @ fit.jac) * (fit.fun @ fit.fun) / freedom
    a, b, c, d = fit.x[2:6]
    scale = float(np.sqrt(abs(a * d - b * c)))
    gradient = np.array([d, -c, -b, a]) / (2 * scale) * np.sign(a * d - b * c)
    error = float(np.sqrt(gradient @ covariance[2:6, 2:6] @ gradient))
    free = distortion is None
    return LatticeFit(
        scale,
        error,
        float(fit.x[8] / size**2) if free else float(distortion or 0.0),
        float(np.sqrt(covariance[8, 8])) / size**2 if free else 0.0,
        float(np.sqrt(np.mean(fit.fun**2) * 2)),
    )


def fit_slopes(
    points: np.ndarray, slopes: np.ndarray, distortion: float = 0.0
) -> tuple[float, float, np.ndarray]:
    """Fit a plane to the slopes of corners, which is exact for a plane in space, tilted or not.

    Distortion lowers the slope of a corner as it lowers the image's scale there, by
    ``1 / (1 + k r^2)`` across the radius and ``1 / (1 + 3 k r^2)`` along it.

    Returns
    -------
    slope, error : float
        Slope at the centre of the image, and its standard error: from the spread over the corners,
        which holds noise and each corner's own bias alike.
    gradient : ndarray, shape (2,)
        Change of the slope per lenslet down and right.
    """
    bent = distortion * np.sum(points**2, axis=1)
    slopes = slopes / (0.5 / (1 + bent) + 0.5 / (1 + 3 * bent))
    design = np.column_stack([np.ones(len(points)), points])
    plane, *_ = np.linalg.lstsq(design, slopes, rcond=None)
    variance = np.sum((slopes - design @ plane) ** 2) / max(len(slopes) - 3, 1)
    error = float(np.sqrt(variance * inverse(design.T @ design)[0, 0]))
    return float(plane[0]), error, plane[1:]
