"""Least-squares fit of a camera's law to targets at known distances, with its uncertainty."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq, least_squares
from scipy.stats import f, t

from lf_flame.calibration.camera_law import CameraLaw
from lf_flame.calibration.targets import Target, inverse
from lf_flame.errors import InputError

LEAST_DISTANCES = 3
"""Smallest number of different distances: a law has four numbers, a target gives two."""

BEYOND = 0.25
"""Part of the span of distances by which a law is trusted beyond the nearest and the farthest."""

WORST_SHARE = 0.02
"""Largest error of positions, relative to the span of distances, with which a law is accepted."""

SURE = 0.999
"""Probability above which more than noise, or a second centre, is taken to be there."""

NAMES = ("slope_at_infinity", "slope_mm", "slope_centre_mm", "scale", "scale_centre_mm")


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
    >>> round(fit.law.slope_centre_mm)  # both are infinite at z = -400 mm
    -400
    """
    if not 0 < square_mm < np.inf:
        raise InputError(f"square_mm must be above 0, got {square_mm}.")
    shapes = {(one.levels.shape, one.lenslets) for one in targets}
    if len(shapes) > 1:
        raise InputError(
            "All targets must be pictures of one camera, got views of different numbers or sizes."
        )
    refuse_few_depths(depths_mm)
    ((views, lenslets),) = shapes
    if views[0] != views[1]:
        raise InputError(f"The number of views must be the same down and right, got {views}.")
    distortion, error = _distortion(targets)
    lattices = [one.squares_per_lenslet(distortion) for one in targets]
    slopes = [one.slope_at_centre(distortion) for one in targets]
    measured = Measurements(
        np.asarray(depths_mm, float),
        np.array([slope for slope, _, _ in slopes]),
        np.array([error for _, error, _ in slopes]),
        square_mm * np.array([one.scale for one in lattices]),
        square_mm * np.array([one.scale_error for one in lattices]),
    )
    # An error of the distortion changes all scales by one factor.
    moved = [one.squares_per_lenslet(distortion + error).scale for one in targets]
    ratios = [other / one.scale - 1 for one, other in zip(lattices, moved, strict=True)]
    return fit_law(
        measured,
        views=views[0],
        lenslets=lenslets,
        distortion=distortion,
        scale_error=float(np.mean(np.abs(ratios))),
        fall_off=_fall_off([one.levels for one in targets]),
    )


def _fall_off(levels: Sequence[np.ndarray]) -> tuple[tuple[float, ...], ...] | None:
    """Brightness of each view over three targets or more; None unless it surely differs by 1 %."""
    seen = np.array([one for one in levels if np.isfinite(one).any()])
    if len(seen) < 3:
        return None
    middle, errors = np.median(seen, axis=0), np.std(seen, axis=0, ddof=1) / np.sqrt(len(seen))
    if not (np.abs(middle - 1) > np.maximum(0.01, 4 * errors)).any():
        return None
    return tuple(map(tuple, np.round(np.nan_to_num(middle), 4).tolist()))


def _distortion(targets: Sequence[Target]) -> tuple[float, float]:
    """Radial distortion that all targets share, and its standard error; 0 and 0 unless sure."""
    free = [one.squares_per_lenslet(None) for one in targets]
    values = np.array([one.distortion for one in free])
    weights = 1 / np.maximum([one.distortion_error for one in free], 1e-15) ** 2
    mean = float(weights @ values / weights.sum())
    misfit = weights @ (values - mean) ** 2 / (len(free) - 1)
    error = float(np.sqrt(max(misfit, 1.0) / weights.sum()))
    sure = t.ppf((1 + SURE) / 2, len(free) - 1)
    return (mean, error) if abs(mean) > sure * error else (0.0, 0.0)


def refuse_few_depths(depths_mm: ArrayLike) -> None:
    """Refuse fewer than three different depths, or depths that are not finite."""
    depths = np.asarray(depths_mm, float)
    different = len(np.unique(depths))
    if different < LEAST_DISTANCES or not np.all(np.isfinite(depths)):
        raise InputError(
            f"A calibration needs targets at {LEAST_DISTANCES} different distances at least, "
            f"better 5 or more over the whole range of use, got {different}."
        )


def fit_law(
    measured: Measurements,
    *,
    views: int,
    lenslets: tuple[int, int],
    distortion: float = 0.0,
    scale_error: float = 0.0,
    fall_off: tuple[tuple[float, ...], ...] | None = None,
) -> LawFit:
    """Fit a law to measured slopes and scales, one centre for both unless two are sure.

    Parameters
    ----------
    measured : Measurements
    views, lenslets, distortion, fall_off
        Facts of the law.
    scale_error : float, optional
        Relative standard error that all scales share.

    Raises
    ------
    InputError
        If there are fewer than three depths, or the measurements follow no law.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.calibration import Measurements, fit_law
    >>> z = np.array([-20.0, 0.0, 25.0])
    >>> errors = np.full(3, 1e-6)
    >>> measured = Measurements(z, 2 - 800 / (z + 400), errors, 0.002 * (z + 400), errors)
    >>> round(fit_law(measured, views=9, lenslets=(60, 90)).law.slope_centre_mm, 3)
    -400.0
    """
    refuse_few_depths(measured.depths)
    span = float(np.ptp(measured.depths))
    start = _start(measured)
    solved, position = _explained(measured, start, span, free=False)
    if len(measured.depths) > LEAST_DISTANCES:
        two, smaller = _explained(measured, start, span, free=True)
        if _is_better(measured, solved.x, two, smaller):
            solved, position = two, smaller
    _refuse_misfit(measured, solved, position, span)
    numbers = [0, 1, 2, 3, 4 if len(solved.x) == 5 else 2]
    covariance = inverse(solved.jac.T @ solved.jac)[np.ix_(numbers, numbers)]
    covariance[3, 3] += (scale_error * solved.x[3]) ** 2
    values = dict(zip(NAMES, map(float, solved.x[numbers]), strict=True))
    deviations = dict(zip(NAMES, map(float, np.sqrt(np.diag(covariance))), strict=True))
    low, high = float(measured.depths.min()), float(measured.depths.max())
    centre = float(max(solved.x[numbers[2]], solved.x[numbers[4]]))
    law = CameraLaw(
        **values,
        # The law holds a little beyond the targets, before the lens.
        depth_range_mm=(max(low - BEYOND * span, (low + centre) / 2), high + BEYOND * span),
        views=views,
        lenslets=lenslets,
        distortion=distortion,
        fall_off=fall_off,
        standard_deviations=deviations,
    )
    freedom = 2 * len(measured.depths) - len(solved.x)
    off, left = _residuals(measured, solved.x), _left_out(measured, solved.x, position)
    notes = _notes(position, solved.x)
    return LawFit(law, covariance, freedom, position, *off, left[0], left[1], notes)


def _model(p: np.ndarray, depths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Slopes and scales of a law; p is (a, b, c, d) or (a, b, c, d, e)."""
    return p[0] + p[1] / (depths - p[2]), p[3] * (depths - p[-1 if len(p) == 5 else 2])


def _start(measured: Measurements) -> np.ndarray:
    """Law from two straight lines: the scale by depth, then the slope by inverse distance."""
    weights = 1 / np.maximum(measured.scale_errors, 1e-12 * np.abs(measured.scales).max())
    d, offset = np.polyfit(measured.depths, measured.scales, 1, w=weights)
    if not (d > 0 and -offset / d < measured.depths.min()):
        raise InputError(
            "The squares must look smaller at larger depths, in proportion to their distance: "
            "count depths positive away from the camera, and check which picture is at which."
        )
    inverse = 1 / (measured.depths + offset / d)
    b, a = np.polyfit(inverse, measured.slopes, 1)
    return np.array([a, b, -offset / d, d])


def _solve(measured: Measurements, start: np.ndarray, position: float):
    """Fit with the errors of measurement, and an error of position in mm on top.

    A slope, and a scale relative to itself, is never better than 1e-7, as pictures are float32.
    """
    apart = measured.depths - start[2]
    slope_errors = np.hypot(measured.slope_errors, position * start[1] / apart**2) + 1e-7
    scale_errors = np.hypot(measured.scale_errors, position * start[3])
    scale_errors += 1e-7 * np.abs(measured.scales)

    def residuals(p: np.ndarray) -> np.ndarray:
        slopes, scales = _model(p, measured.depths)
        off = [(slopes - measured.slopes) / slope_errors, (scales - measured.scales) / scale_errors]
        return np.nan_to_num(np.concatenate(off), nan=1e12, posinf=1e12, neginf=-1e12)

    return least_squares(residuals, start, method="lm", x_scale="jac", xtol=1e-14, ftol=1e-14)


def _explained(measured: Measurements, start: np.ndarray, span: float, *, free: bool):
    """Fit with the smallest error of position that explains the residuals."""
    start = np.append(start, start[2]) if free else start
    freedom = 2 * len(measured.depths) - len(start)

    def excess(position: float) -> float:
        return 2 * _solve(measured, start, position).cost / freedom - 1

    largest = 2 * WORST_SHARE * span
    if excess(0.0) <= 0:
        position = 0.0
    elif excess(largest) >= 0:
        position = largest  # refused by the caller
    else:
        position = brentq(excess, 0.0, largest, xtol=1e-6 * span)
    return _solve(measured, start, position), position


def _is_better(measured: Measurements, one: np.ndarray, two, position: float) -> bool:
    """Whether a second centre explains more than chance would (F test), and is a possible one."""
    freedom = 2 * len(measured.depths) - len(two.x)
    gain = 2 * (_solve(measured, one, position).cost - two.cost)
    share = gain / max(2 * two.cost / freedom, 1.0)
    return share > f.ppf(SURE, 1, freedom) and two.x[4] < measured.depths.min()


def _residuals(measured: Measurements, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the law's depths in mm, and relative errors of its scales."""
    depths = p[2] + p[1] / (measured.slopes - p[0])
    return depths - measured.depths, _model(p, measured.depths)[1] / measured.scales - 1


def _left_out(measured: Measurements, p: np.ndarray, position: float) -> np.ndarray:
    """Residuals of each target by the law of the others, shape (2, n)."""
    count = len(measured.depths)
    left = np.full((2, count), np.nan)
    for number in range(count):
        others = measured.without(number)
        if len(np.unique(others.depths)) >= LEAST_DISTANCES:
            law = _solve(others, p, position).x
            left[:, number] = [x[number] for x in _residuals(measured, law)]
    return left


def _refuse_misfit(measured: Measurements, solved, position: float, span: float) -> None:
    p = solved.x
    off = _residuals(measured, p)[0]
    worst = int(np.argmax(np.abs(off)))
    if position > WORST_SHARE * span or not p[2] < measured.depths.min():
        raise InputError(
            f"The targets follow no law of a camera: depths by it differ from the given ones by up "
            f"to {abs(off[worst]):.3g} mm, at {measured.depths[worst]:g} mm; check which picture "
            f"was taken at which depth, and that the camera was not changed between them."
        )


def _notes(position: float, p: np.ndarray) -> list[str]:
    """Sentences on reversed views, errors of the targets' positions in mm, and a second centre."""
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
