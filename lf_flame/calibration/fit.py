"""Least-squares fit of a camera's law to targets at known distances, with its uncertainty."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares
from scipy.stats import chi2, t

from lf_flame.calibration.camera_law import MEASURED, CameraLaw
from lf_flame.calibration.targets import Target, inverse
from lf_flame.errors import InputError

SURE = 0.999
"""Probability above which distortion, or a misfit, is significant."""


class Measurements(NamedTuple):
    """Slopes and scales of targets at known depths, with standard errors, each of shape (n,)."""

    depths: np.ndarray  # mm, from any zero
    slopes: np.ndarray  # lenslets per view step
    slope_errors: np.ndarray
    scales: np.ndarray  # mm on the target per lenslet
    scale_errors: np.ndarray


@dataclass(frozen=True, eq=False)
class LawFit:
    """A law, fitted to targets, and how well it fits.

    Attributes
    ----------
    law : CameraLaw
    measured : Measurements
        Slopes and scales of the targets.
    covariance : ndarray, shape (4, 4)
        Covariance of a, b, c and d of the law.
    misfit_mm : float
        Root mean square of the depth residuals in mm; 0 unless it exceeds the noise significantly.
    residuals : ndarray, shape (2, n)
        Depth by the law minus the known one in mm, and relative error of the law's scale.
    """

    law: CameraLaw
    measured: Measurements
    covariance: np.ndarray
    misfit_mm: float
    residuals: np.ndarray

    @property
    def coverage(self) -> float:
        """Number of standard deviations that contain the truth with 95 % (Student's t)."""
        return float(t.ppf(0.975, self.residuals.size - len(MEASURED)))

    def depth_error_mm(self, depth_mm: float) -> float:
        """Find the standard deviation in mm of the law's depth for a slope known exactly."""
        apart = depth_mm - self.law.centre_mm
        gradient = np.array([apart**2 / self.law.slope_mm, apart / self.law.slope_mm, 1, 0])
        return float(np.sqrt(gradient @ self.covariance @ gradient))

    def scale_error(self, depth_mm: float) -> float:
        """Find the standard deviation in mm of the size of a lenslet's image at a depth."""
        gradient = np.array([0, 0, -self.law.scale, depth_mm - self.law.centre_mm])
        return float(np.sqrt(gradient @ self.covariance @ gradient))


def fit_targets(
    depths_mm: Sequence[float], targets: Sequence[Target], *, square_mm: float
) -> LawFit:
    """Fit how slope and scale (mm per lenslet) depend on depth, from pictures of a target.

    Parameters
    ----------
    depths_mm : sequence of float
        Depth of each target in mm, increasing away from the camera; the zero may be anywhere.
    targets : sequence of Target
        Results of `measure_target`, of the same camera.
    square_mm : float
        Side of a square of the checkerboard, or distance between neighbouring dots, in mm.

    Returns
    -------
    LawFit
        Fitted `CameraLaw` with standard errors and residuals.

    Raises
    ------
    InputError
        If there are fewer than three depths, the targets are of different cameras, or no
        law fits them.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import LightField
    >>> from lf_flame.calibration import fit_targets, measure_target
    >>> t, s = np.mgrid[:48, :56]
    >>> def draw_board(slope, side):  # a checkerboard with squares of that many lenslets
    ...     wave = lambda x, step: np.sin((x - slope * step) * np.pi / side)
    ...     steps = (-1, 0, 1)
    ...     return LightField([[wave(t, v) * wave(s, u) for u in steps] for v in steps])
    >>> depths = [-20.0, 0.0, 25.0]
    >>> boards = [draw_board(2 - 800 / (z + 400), 4000 / (z + 400)) for z in depths]
    >>> fit = fit_targets(depths, [measure_target(board) for board in boards], square_mm=5.0)
    >>> round(fit.law.centre_mm)  # both are infinite at z = -400 mm
    -400
    """
    if not 0 < square_mm < np.inf:
        raise InputError(f"square_mm must be above 0, got {square_mm}.")
    shapes = {one.shape for one in targets}
    if len(shapes) > 1:
        raise InputError(
            "All targets must be pictures of one camera, got views of different numbers or sizes."
        )
    refuse_few_depths(depths_mm)
    if len(depths_mm) != len(targets):
        raise InputError(f"Each target needs its depth, got {len(depths_mm)} for {len(targets)}.")
    ((rows, columns, *lenslets),) = shapes
    if rows != columns:
        raise InputError(
            f"The number of views must be the same along both axes, got {rows} x {columns}."
        )
    distortion, error = _distortion(targets)
    lattices = [one.squares_per_lenslet(distortion) for one in targets]
    slopes, slope_errors = np.transpose([one.slope_at_centre(distortion)[:2] for one in targets])
    scales, scale_errors = square_mm * np.transpose([(x.scale, x.scale_error) for x in lattices])
    depths = np.asarray(depths_mm, float)
    measured = Measurements(depths, slopes, slope_errors, scales, scale_errors)
    # An error of the distortion changes all scales by one factor.
    moved = [one.squares_per_lenslet(distortion + error).scale for one in targets]
    ratios = [other / one.scale - 1 for one, other in zip(lattices, moved, strict=True)]
    return fit_law(
        measured,
        views=rows,
        lenslets=(lenslets[0], lenslets[1]),
        distortion=distortion,
        scale_error=float(np.mean(np.abs(ratios))),
        fall_off=_fall_off([one.levels for one in targets]),
    )


def _fall_off(levels: Sequence[np.ndarray]) -> tuple[tuple[float, ...], ...] | None:
    """Brightness of each view over three targets or more; None if 1 % is within its error."""
    seen = np.array([one for one in levels if np.isfinite(one).any()])
    if len(seen) < 3:
        return None
    middle, errors = np.median(seen, axis=0), np.std(seen, axis=0, ddof=1) / np.sqrt(len(seen))
    if not (np.abs(middle - 1) > np.maximum(0.01, 4 * errors)).any():
        return None
    return tuple(map(tuple, np.round(np.nan_to_num(middle), 4).tolist()))


def _distortion(targets: Sequence[Target]) -> tuple[float, float]:
    """Radial distortion that all targets share, 0 if insignificant, and its standard error."""
    free = [one.squares_per_lenslet(None) for one in targets]
    values = np.array([one.distortion for one in free])
    weights = 1 / np.maximum([one.distortion_error for one in free], 1e-15) ** 2
    mean = float(weights @ values / weights.sum())
    misfit = weights @ (values - mean) ** 2 / (len(free) - 1)
    error = float(np.sqrt(max(misfit, 1.0) / weights.sum()))
    sure = t.ppf((1 + SURE) / 2, len(free) - 1)
    return (mean, error) if abs(mean) > sure * error else (0.0, float(np.hypot(mean, error)))


def refuse_few_depths(depths_mm: ArrayLike) -> None:
    """Refuse fewer than three different depths, or depths that are not finite."""
    different = len(np.unique(np.asarray(depths_mm, float)[np.isfinite(depths_mm)]))
    if different < 3 or not np.all(np.isfinite(depths_mm)):
        raise InputError(
            f"A calibration needs targets at 3 or more different distances, better 5 or more, all "
            f"of them numbers, got {different}."
        )


def fit_law(measured: Measurements, *, scale_error: float = 0.0, **facts: Any) -> LawFit:
    """Fit a law to slopes and scales; all scales share the relative standard error `scale_error`.

    `facts` are further values of the law: views, lenslets, distortion, fall-off.
    """
    refuse_few_depths(measured.depths)
    low, high = float(measured.depths.min()), float(measured.depths.max())
    span = high - low
    solved = _solve(measured, _start(measured))
    residuals, centre = _residuals(measured, solved.x), float(solved.x[2])
    misfit_mm = float(np.sqrt(np.mean(residuals[0] ** 2)))
    if misfit_mm > 0.02 * span or not centre < low:
        worst = int(np.argmax(np.abs(residuals[0])))
        raise InputError(
            f"No camera law fits the targets: its depths differ from the given ones by up "
            f"to {abs(residuals[0, worst]):.3g} mm, at {measured.depths[worst]:g} mm; check which "
            f"picture was taken at which depth, and that the camera was not changed between them."
        )
    freedom, square = solved.fun.size - len(MEASURED), 2 * solved.cost
    sure = bool(square > chi2.ppf(SURE, freedom))
    # A wrong position changes slope and scale of a target together, which at most doubles the
    # variance of errors that are independent.
    covariance = max(square / freedom * (1 + sure), 1.0) * inverse(solved.jac.T @ solved.jac)
    covariance[3, 3] += (scale_error * solved.x[3]) ** 2
    law = CameraLaw(
        **dict(zip(MEASURED, solved.x.tolist(), strict=True)),
        # The law is trusted a little beyond the targets, in front of the lens.
        depth_range_mm=(max(low - span / 4, (low + centre) / 2), high + span / 4),
        standard_deviations=dict(zip(MEASURED, np.sqrt(np.diag(covariance)).tolist(), strict=True)),
        **facts,
    )
    return LawFit(law, measured, covariance, misfit_mm * sure, residuals)


def _start(measured: Measurements) -> np.ndarray:
    """Law from two straight lines: the scale by depth, then the slope by inverse distance."""
    weights = 1 / np.maximum(measured.scale_errors, 1e-12 * np.abs(measured.scales).max())
    d, offset = np.polyfit(measured.depths, measured.scales, 1, w=weights)
    if not (d > 0 and -offset / d < measured.depths.min()):
        raise InputError(
            "The squares must look smaller at larger depths, in proportion to their distance: "
            "count depths positive away from the camera, and check which picture is at which."
        )
    b, a = np.polyfit(1 / (measured.depths + offset / d), measured.slopes, 1)
    return np.array([a, b, -offset / d, d])


def _solve(measured: Measurements, start: np.ndarray):
    """Fit by least squares, weighted by the errors of measurement.

    A slope, and a scale relative to itself, is never better than 1e-7, as pictures are float32.
    """
    slope_errors = measured.slope_errors + 1e-7
    scale_errors = measured.scale_errors + 1e-7 * np.abs(measured.scales)

    def residuals(p: np.ndarray) -> np.ndarray:
        apart = measured.depths - p[2]
        slopes, scales = p[0] + p[1] / apart, p[3] * apart
        off = [(slopes - measured.slopes) / slope_errors, (scales - measured.scales) / scale_errors]
        return np.nan_to_num(np.concatenate(off), nan=1e12, posinf=1e12, neginf=-1e12)

    return least_squares(residuals, start, method="lm", x_scale="jac", xtol=1e-14, ftol=1e-14)


def _residuals(measured: Measurements, p: np.ndarray) -> np.ndarray:
    """Errors of the law's depths in mm, and relative errors of its scales, shape (2, n)."""
    depths = p[2] + p[1] / (measured.slopes - p[0])
    scales = p[3] * (measured.depths - p[2])
    return np.array([depths - measured.depths, scales / measured.scales - 1])
