"""Measurements to which a law is fitted, and the fit with its uncertainty."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import t

from lf_flame.calibration.camera_law import CameraLaw


@dataclass(frozen=True, eq=False)
class Measurements:
    """Slopes and scales of targets at known depths, each of shape (n,).

    Attributes
    ----------
    depths : ndarray
        Depths in mm, increasing away from the camera, from any zero.
    slopes, slope_errors : ndarray
        Slopes in lenslets per view step, and their standard errors.
    scales, scale_errors : ndarray
        Sizes in mm of a lenslet's image at the target, and their standard errors.
    """

    depths: np.ndarray
    slopes: np.ndarray
    slope_errors: np.ndarray
    scales: np.ndarray
    scale_errors: np.ndarray

    def without(self, number: int) -> "Measurements":
        """Leave one target out."""
        return Measurements(*(np.delete(x, number) for x in vars(self).values()))


@dataclass(frozen=True, eq=False)
class LawFit:
    """A law, fitted to targets, and how well it holds.

    Attributes
    ----------
    law : CameraLaw
    covariance : ndarray, shape (5, 5)
        Covariance of a, b, c, d and e of the law.
    freedom : int
        Number of degrees of freedom.
    position_error_mm : float
        Error of a target's position that explains what noise does not, in mm; 0 if noise explains
        the residuals.
    depth_residuals_mm, scale_residuals : ndarray, shape (n,)
        Depth by the law minus the known one, and relative error of the law's scale.
    left_out_mm, left_out_scale : ndarray, shape (n,)
        The same by the law of the other targets; NaN for three targets.
    notes : list of str
        Sentences for the user.
    """

    law: CameraLaw
    covariance: np.ndarray
    freedom: int
    position_error_mm: float
    depth_residuals_mm: np.ndarray
    scale_residuals: np.ndarray
    left_out_mm: np.ndarray
    left_out_scale: np.ndarray
    notes: list[str]

    @property
    def coverage(self) -> float:
        """Number of standard deviations within which the truth is with 95 % (Student's t)."""
        return float(t.ppf(0.975, self.freedom))

    def depth_error_mm(self, depth_mm: float) -> float:
        """Find the standard deviation in mm of the law's depth for a slope known exactly."""
        b, c = self.law.slope_mm, self.law.slope_centre_mm
        apart = depth_mm - c
        gradient = np.array([1, 1 / apart, b / apart**2, 0, 0]) * apart**2 / b
        return float(np.sqrt(gradient @ self.covariance @ gradient))

    def scale_error(self, depth_mm: float) -> float:
        """Find the standard deviation in mm of the size of a lenslet's image at a depth."""
        gradient = np.array([0, 0, 0, depth_mm - self.law.scale_centre_mm, -self.law.scale])
        return float(np.sqrt(gradient @ self.covariance @ gradient))


def notes_on(position: float, p: np.ndarray) -> list[str]:
    """Sentences on turned views, errors of the positions in mm and a second centre.

    The positions are those of the targets; p is (a, b, c, d) or (a, b, c, d, e).
    """
    notes = []
    if p[1] > 0:
        notes.append(
            "Slopes fall with depth, and those of a camera rise: the views are stored turned "
            "round, in both axes; state the turned order (--order=-row,-col instead of row,col) "
            "here and for every picture, or the signs of all slopes stay reversed."
        )
    if position > 0:
        notes.append(
            f"The noise of the pictures alone does not explain the residuals: errors of "
            f"{position:.2g} mm in the positions of the targets would, and the standard deviations "
            f"allow for them."
        )
    if len(p) == 5:
        notes.append(
            f"Slope and scale have different centres ({p[2]:.4g} and {p[4]:.4g} mm): "
            f"the camera is no thin lens, and only its law is written."
        )
    return notes
