"""Slope and scale of a flat target in a light field, from its corners in all views.

A point of the target moves by its slope, in lenslets, from one view to the next. A regression of
the positions of all corners in all views is far more exact than a search for the sharpest slope.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from lf_flame._common.arrays import centred
from lf_flame.calibration.corners import centres, find_lattice, lattice_steps, refuse_few
from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.refocus import align_views, find_sharpest_slope


class LatticeFit(NamedTuple):
    """Scale of a lattice at the centre of the image, radial distortion, and standard errors."""

    scale: float  # squares per lenslet
    scale_error: float
    distortion: float  # k of r (1 + k r^2), which is free of distortion, per lenslet squared
    distortion_error: float


@dataclass(frozen=True, eq=False)
class Target:
    """A flat target, as measured in one light field.

    Attributes
    ----------
    indices : ndarray of int, shape (n, 2)
        Row and column of each corner or dot on the target.
    points : ndarray, shape (n, 2)
        Position of each in the central view, row and column in lenslets from the image's centre.
    slopes : ndarray, shape (n,)
        Slope of each, in lenslets per view step.
    residual : float
        Distance of a corner from the regression over the views, root mean square, in lenslets.
    levels : ndarray, shape (v, u)
        Brightness of the target in each view, relative to the central one; NaN of views that are
        left out, and of a picture around a mean of 0.
    shape : (int, int, int, int)
        Shape of the views (v, u, t, s).
    """

    indices: np.ndarray
    points: np.ndarray
    slopes: np.ndarray
    residual: float
    levels: np.ndarray
    shape: tuple[int, int, int, int]

    @property
    def slope(self) -> float:
        """Slope of the target at the centre of the image, in lenslets per view step."""
        return self.slope_at_centre()[0]

    def slope_at_centre(self, distortion: float = 0.0) -> tuple[float, float, np.ndarray]:
        """Slope at the centre of the image, its standard error, its gradient per lenslet.

        A plane through the slopes of the corners is exact for a flat target, tilted or not. The
        error is from the spread over the corners, which includes noise and each corner's own bias.
        Distortion lowers the slope of a corner as it lowers the image's scale there, by
        ``1 / (1 + k r^2)`` across the radius and ``1 / (1 + 3 k r^2)`` along it.
        """
        bent = distortion * np.sum(self.points**2, axis=1)
        slopes = self.slopes / (0.5 / (1 + bent) + 0.5 / (1 + 3 * bent))
        design = np.column_stack([np.ones(len(slopes)), self.points])
        plane, *_ = np.linalg.lstsq(design, slopes, rcond=None)
        variance = np.sum((slopes - design @ plane) ** 2) / max(len(slopes) - 3, 1)
        error = float(np.sqrt(variance * inverse(design.T @ design)[0, 0]))
        return float(plane[0]), error, plane[1:]

    def squares_per_lenslet(self, distortion: float | None = 0.0) -> LatticeFit:
        """Fit ``index = i0 + A x' / (1 + g x')``, a plane in perspective, ``x' = x (1 + k x^2)``.

        The root of the determinant of A is the scale at the centre of the image, where x = 0. With
        a distortion k of None it is fitted as well.
        """
        points, free = self.points, distortion is None
        size = float(np.abs(points).max())
        ones = np.ones(len(points))
        affine, *_ = np.linalg.lstsq(np.column_stack([ones, points]), self.indices, rcond=None)

        def residuals(p: np.ndarray) -> np.ndarray:
            k = p[8] / size**2 if distortion is None else distortion
            straight = points * (1 + k * np.sum(points**2, axis=1, keepdims=True))
            plane = straight @ p[2:6].reshape(2, 2) / (1 + straight @ p[6:8, None] / size)
            return (p[:2] + plane - self.indices).ravel()

        start = np.concatenate([affine[0], affine[1:].ravel(), np.zeros(2 + free)])
        fit = least_squares(residuals, start, x_scale="jac", method="lm", xtol=1e-14, ftol=1e-14)
        freedom = max(fit.fun.size - fit.x.size, 1)
        covariance = inverse(fit.jac.T @ fit.jac) * (fit.fun @ fit.fun) / freedom
        a, b, c, d = fit.x[2:6]
        scale = float(np.sqrt(abs(a * d - b * c)))
        gradient = np.array([d, -c, -b, a]) / (2 * scale) * np.sign(a * d - b * c)
        error = float(np.sqrt(gradient @ covariance[2:6, 2:6] @ gradient))
        # Moire between sharp squares and pixels that do not overlap moves neighbouring corners
        # as one, which their spread does not show: by 0.003 lenslets (root mean square, measured on
        # pinhole pictures of boards at all angles). It averages out where the target moves by
        # pixels from view to view.
        motion = abs(self.slope) * (min(self.shape[:2]) - 1)
        moire = 0.003 / max(1.0, np.pi * motion) / float(np.std(points))
        return LatticeFit(
            scale,
            float(np.hypot(error, scale * moire)),
            float(fit.x[8] / size**2) if free else float(distortion or 0.0),
            float(np.sqrt(covariance[8, 8])) / size**2 if free else 0.0,
        )


def inverse(matrix: np.ndarray) -> np.ndarray:
    """Invert a matrix of a fit; refuse one that is singular to rounding."""
    scale = np.sqrt(np.diag(matrix))
    even = matrix / scale[:, None] / scale
    if not (np.all(np.isfinite(even)) and np.linalg.cond(even) < 1e14):
        raise InputError(
            "The corners of a target must spread over the picture, and the depths of the targets "
            "be far apart; these do not determine the law."
        )
    return np.linalg.inv(even) / scale[:, None] / scale


def measure_target(light_field: LightField, *, dots: bool = False) -> Target:
    """Measure the slope and the lattice of a flat target.

    Parameters
    ----------
    light_field : LightField
        Picture of a checkerboard, or of a square grid of round dots. Views of weight 0 are left
        out; colours are averaged.
    dots : bool, optional
        Whether the target is a grid of dots.

    Returns
    -------
    Target

    Raises
    ------
    InputError
        If there are fewer than 3 x 3 views or 4 x 4 squares, or the corners cannot be followed
        from view to view.

    Examples
    --------
    A checkerboard with squares of 8 lenslets, at slope 0.5:

    >>> import numpy as np
    >>> from lf_flame import LightField
    >>> from lf_flame.calibration import measure_target
    >>> t, s = np.mgrid[:48, :56]
    >>> steps = np.arange(-2, 3)
    >>> board = lambda v, u: np.sin((t - 0.5 * v) * np.pi / 8) * np.sin((s - 0.5 * u) * np.pi / 8)
    >>> target = measure_target(LightField([[board(v, u) for u in steps] for v in steps]))
    >>> round(target.slope, 3), round(target.squares_per_lenslet().scale, 4)
    (0.5, 0.125)
    """
    views, weights = light_field.grey().filled, light_field.weights
    v, u, *_ = views.shape
    counted = np.ones((v, u), bool) if weights is None else weights > 0
    if min(v, u) < 3 or counted.sum() < 5:
        raise InputError(
            f"A target needs 3 x 3 views or more, 5 with weight, got {counted.sum()} of {v} x {u}."
        )
    offsets = np.stack(np.meshgrid(centred(v), centred(u), indexing="ij"), axis=-1)
    places = np.argwhere(counted)
    middle = tuple(places[np.argmin(np.hypot(*offsets[counted].T))].tolist())
    indices, points = find_lattice(views[middle], dots=dots)
    pitch = float(np.sqrt(abs(np.linalg.det(lattice_steps(indices, points)))))
    radius = pitch / 2  # of the disc around a corner: the four squares that meet there, or one dot
    points = centres(views[middle], points, radius)
    sound = np.isfinite(points[:, 0])
    indices, points = indices[sound], points[sound]
    refuse_few(indices, dots=dots)

    def track(chosen: np.ndarray, slope: float) -> np.ndarray:
        """Positions of the corners in views, shape (views, corners, 2); NaN if not found."""
        starts = points + slope * (offsets[chosen] - offsets[middle])[:, None]
        both = zip(views[chosen], starts, strict=True)
        return np.array([centres(view, start, radius) for view, start in both])

    # The slope from the neighbouring views is exact enough for a start in the outermost ones.
    near = counted & (np.abs(offsets - offsets[middle]).max(axis=-1) <= 1)
    tracks = track(near, _sharpest_slope(views, near, middle, points, pitch))
    slope = float(np.median(_slopes(_regress(tracks, offsets[near])[1])))
    levels = _levels(views, counted, middle, slope, points)
    tracks = track(counted, slope)
    indices, points, motions, residuals = _sound_corners(indices, tracks, offsets[counted], dots)
    residual = float(np.sqrt(2 * np.nanmean(residuals**2)))
    if residual > 0.1 * pitch:
        raise InputError(
            f"The corners must move evenly from view to view, got residuals of {residual:.2g} "
            f"lenslets: the views are not in order, or the target is not flat."
        )
    points = points - (np.array(views.shape[2:]) - 1) / 2
    target = Target(indices, points, _slopes(motions), residual, levels, views.shape)
    _check_motion(motions.mean(axis=0), target.slope_at_centre()[1])
    return target


def _sharpest_slope(views, near: np.ndarray, middle, points: np.ndarray, pitch: float) -> float:
    """Slope at which the target is sharpest in the views around the middle one.

    Within half a square per view step, beyond which one corner may be mistaken for the next.
    """
    slopes = pitch * np.linspace(-0.5, 0.5, 2 * int(max(2 * pitch, 10)) + 1)
    (top, left), (bottom, right) = points.min(axis=0).astype(int), points.max(axis=0).astype(int)
    block = tuple(slice(max(k - 1, 0), k + 2) for k in middle)
    region = (top, bottom, left, right)
    return find_sharpest_slope(views[block], slopes, region=region, weights=near[block]).slope


def _levels(views, counted, middle, slope: float, points: np.ndarray) -> np.ndarray:
    """Brightness of the target in each view, over the part of it that all views see."""
    levels = np.full(counted.shape, np.nan)
    reach = abs(slope) * (np.array(views.shape[:2]) - 1) / 2
    low = np.ceil(np.maximum(points.min(axis=0), reach)).astype(int)
    last = np.array(views.shape[2:]) - 1 - reach
    high = np.floor(np.minimum(points.max(axis=0), last)).astype(int)
    if np.all(high - low >= 2):  # else it moves by nearly the whole image
        aligned = align_views(views, slope, [(int(v), int(u)) for v, u in np.argwhere(counted)])
        part = aligned[:, low[0] : high[0] + 1, low[1] : high[1] + 1]
        levels[counted] = part.mean(axis=(1, 2), dtype=np.float64)
    # Around a mean of 0, as of a picture less its mean, nothing is brighter or darker.
    known = levels[middle] > 0.2 * np.std(views[middle])
    return levels / levels[middle] if known else np.full_like(levels, np.nan)


def _regress(tracks: np.ndarray, offsets: np.ndarray) -> tuple[np.ndarray, ...]:
    """Regress each corner's position on the view's offset; all pairs are down and right.

    Gives positions in the central view, shape (n, 2), motions with the row and with the column of
    the view, shape (n, 2, 2), and residuals, shape (views, n, 2).
    """
    design = np.column_stack([np.ones(len(offsets)), offsets])
    known = np.isfinite(tracks).all(axis=2)
    normal = np.einsum("vn,vi,vj->nij", known, design, design)
    normal += 1e-12 * np.eye(3)
    right = np.einsum("vi,vnk->nik", design, np.where(known[..., None], tracks, 0.0))
    solved = np.linalg.solve(normal, right)
    return solved[:, 0], solved[:, 1:], tracks - np.einsum("vi,nik->vnk", design, solved)


def _slopes(motions: np.ndarray) -> np.ndarray:
    """Mean of the motions down with the row, and to the right with the column of the view."""
    return np.trace(motions, axis1=1, axis2=2) / 2


def _sound_corners(indices, tracks, offsets, dots: bool) -> tuple[np.ndarray, ...]:
    """Regress the tracks, without corners that most views do not show and without outliers."""
    for least in (0.5, 0.25):
        often = np.isfinite(tracks[..., 0]).mean(axis=0) >= least
        indices, tracks = indices[often], tracks[:, often]
        refuse_few(indices, dots=dots)
        points, motions, residuals = _regress(tracks, offsets)
        if least == 0.5:
            usual = 1.4826 * np.nanmedian(np.abs(residuals)) + 1e-9
            tracks[np.abs(residuals).max(axis=2) > 5 * usual] = np.nan
    return indices, points, motions, residuals


def _check_motion(motion: np.ndarray, slope_error: float) -> None:
    """Refuse views that are not in rows and columns of one step, by the mean motion, (2, 2)."""
    (down, aside), (across, right) = motion
    size = np.abs(motion).max()
    # A real array is rotated, or its pitches differ, by far less than 0.15.
    uneven = max(abs(down - right), abs(aside), abs(across)) > 0.15 * size
    if uneven and size >= 20 * slope_error:  # else it hardly moves
        raise InputError(
            f"Views must be ordered by row and column, at equal steps: from row to row the corners "
            f"move by ({down:.3g}, {aside:.3g}) lenslets down and right, from column to column by "
            f"({across:.3g}, {right:.3g})."
        )
