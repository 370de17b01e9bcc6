"""Slope and scale of a flat target in a light field, from its corners in all views.

A point of the target moves by its slope, in lenslets, from one view to the next. A regression of
the positions of all corners in all views is far more exact than a search for the sharpest slope.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import map_coordinates

from lf_flame._common.arrays import centred
from lf_flame.calibration.brightness import brightness
from lf_flame.calibration.lattice import find_lattice, spacing
from lf_flame.calibration.plane import LatticeFit, fit_lattice, fit_slopes
from lf_flame.calibration.symmetry import centres
from lf_flame.errors import InputError
from lf_flame.lightfield import LightField

RADIUS = 0.5
"""Radius of the disc around a corner, in squares: the four squares that meet there, or one dot."""

LEAST_SHARE = 0.5
"""Smallest share of the counted views in which a corner must be found."""

OUTLIER = 5.0
"""Distance of an outlier from the regression, in standard deviations."""

WORST_RESIDUAL = 0.1
"""Largest residual of the corners, in squares, root mean square."""


MOIRE = 0.003
"""Error in lenslets that neighbouring corners share, where sharp squares are seen by pixels that do
not overlap: measured on pinhole pictures of boards at all angles, root mean square."""

LEAST_MEAN = 0.2
"""Smallest mean of a picture, in its standard deviations, with which brightness is measured."""

MOST_UNEVEN = 0.15
"""Largest difference of the motions down and right, and largest rotation in rad."""


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
    anisotropy, rotation_rad : float
        Relative difference of the slopes down and right, and rotation of the views' directions
        against the image; both are about 0 where lenslets and pixels are square and aligned. NaN
        for a target so near the focal plane that they cannot be told.
    views, lenslets : (int, int)
        Number of views, and of pixels of a view.
    levels : ndarray, shape (v, u)
        Brightness of the target in each view, relative to the central one; NaN of views that do not
        count, and of a picture without a level.
    """

    indices: np.ndarray
    points: np.ndarray
    slopes: np.ndarray
    residual: float
    anisotropy: float
    rotation_rad: float
    views: tuple[int, int]
    lenslets: tuple[int, int]
    levels: np.ndarray

    @property
    def slope(self) -> float:
        """Slope of the target at the centre of the image, in lenslets per view step."""
        return self.slope_at_centre()[0]

    def slope_at_centre(self, distortion: float = 0.0) -> tuple[float, float, np.ndarray]:
        """Slope at the centre of the image, its standard error, and its change per lenslet.

        Parameters
        ----------
        distortion : float, optional
            Radial distortion per lenslet squared.
        """
        return fit_slopes(self.points, self.slopes, distortion)

    def squares_per_lenslet(self, distortion: float | None = 0.0) -> LatticeFit:
        """Fit the lattice: its scale at the centre of the image, in squares per lenslet.

        Parameters
        ----------
        distortion : float or None, optional
            Radial distortion per lenslet squared; None fits it too.
        """
        found = fit_lattice(self.indices, self.points, distortion)
        # Moire between squares and pixels moves neighbouring corners alike, which their spread does
        # not show; it averages out where the target moves by pixels from view to view.
        motion = abs(self.slope) * (min(self.views) - 1)
        moire = MOIRE / max(1.0, np.pi * motion) / float(np.std(self.points))
        return replace(found, scale_error=float(np.hypot(found.scale_error, found.scale * moire)))


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
    v, u, t, s = views.shape
    counted = np.ones((v, u), bool) if weights is None else weights > 0
    if min(v, u) < 3 or counted.sum() < 5:
        raise InputError(
            f"The slope of a target needs at least 3 x 3 views that count, got {v} x {u}."
        )
    middle = _central(counted)
    indices, points = find_lattice(views[middle], dots=dots)
    pitch = spacing(indices, points)
    points = centres(views[middle], points, RADIUS * pitch)
    sound = np.isfinite(points[:, 0])
    indices, points = indices[sound], points[sound]
    _refuse_few(indices)
    offsets = np.stack(np.meshgrid(centred(v), centred(u), indexing="ij"), axis=-1)
    start = _coarse_slope(views, middle, counted, points, pitch)
    near = counted & (np.abs(offsets - offsets[middle]).max(axis=-1) <= 1)
    # The slope from the neighbouring views is exact enough for a start in the outermost ones.
    tracks = _track(views, near, offsets, middle, points, start, pitch)
    slope = float(np.median(_regress(tracks, offsets[near])[1].mean(axis=1)))
    tracks = _track(views, counted, offsets, middle, points, slope, pitch)
    levels = np.full((v, u), np.nan)
    box = np.stack([points.min(axis=0), points.max(axis=0)])
    levels[counted] = brightness(views, np.argwhere(counted), slope, box)
    # Around a mean of 0, as of a picture less its mean, nothing is brighter or darker.
    known = levels[middle] > LEAST_MEAN * np.std(views[middle])
    levels = levels / levels[middle] if known else np.full((v, u), np.nan)
    return _target(indices, tracks, offsets[counted], pitch, levels, (t, s))


def _central(counted: np.ndarray) -> tuple[int, int]:
    """Row and column of the counted view nearest to the centre."""
    places = np.argwhere(counted)
    distance = np.hypot(*(places - (np.array(counted.shape) - 1) / 2).T)
    row, column = places[np.argmin(distance)]
    return int(row), int(column)


def _refuse_few(indices: np.ndarray) -> None:
    counts = [len(np.unique(column)) for column in indices.T]
    if len(indices) < 9 or min(counts) < 3:
        raise InputError(
            f"At least 3 x 3 corners or dots must be found in most views, got {counts[0]} x "
            f"{counts[1]}: let the target fill more of the picture, or use smaller squares."
        )


def _coarse_slope(views, middle, counted, points, pitch: float) -> float:
    """Slope at which the neighbours of the central view are most like it around the corners.

    Within half a square per view step, beyond which one corner may be taken for the next.
    """
    reach = np.arange(-2, 3) * pitch / 5
    patch = np.stack(np.meshgrid(reach, reach, indexing="ij"), axis=-1).reshape(-1, 2)
    places = (points[:, None] + patch).reshape(-1, 2)
    model = map_coordinates(views[middle], places.T, order=1, mode="nearest")
    model = model - model.mean()
    slopes = np.arange(-0.5, 0.5, 1 / max(4 * pitch, 20)) * pitch
    likeness = np.zeros(len(slopes))
    for step in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        row, column = np.add(middle, step)
        if not (0 <= row < len(counted) and 0 <= column < counted.shape[1]):
            continue
        if not counted[row, column]:
            continue
        for k, slope in enumerate(slopes):
            moved = places + slope * np.array(step)
            seen = map_coordinates(views[row, column], moved.T, order=1, mode="nearest")
            likeness[k] += model @ seen
    return float(slopes[np.argmax(likeness)])


def _track(views, chosen, offsets, middle, points, slope: float, pitch: float) -> np.ndarray:
    """Positions of the corners in the chosen views, shape (views, corners, 2); NaN if not found."""
    tracks = []
    for row, column in np.argwhere(chosen):
        starts = points + slope * (offsets[row, column] - offsets[middle])
        tracks.append(centres(views[row, column], starts, RADIUS * pitch))
    return np.array(tracks)


def _regress(tracks: np.ndarray, offsets: np.ndarray) -> tuple[np.ndarray, ...]:
    """Regress each corner's position on the view's offset; all pairs are down and right.

    Gives positions in the central view, slopes, motions down with the column of the view and right
    with its row, each of shape (n, 2), and residuals, shape (views, n, 2).
    """
    design = np.column_stack([np.ones(len(offsets)), offsets])
    known = np.isfinite(tracks).all(axis=2)
    normal = np.einsum("vn,vi,vj->nij", known, design, design)
    normal += 1e-12 * np.eye(3)
    right = np.einsum("vi,vnk->nik", design, np.where(known[..., None], tracks, 0.0))
    solved = np.linalg.solve(normal, right)
    residuals = tracks - np.einsum("vi,nik->vnk", design, solved)
    slopes = np.stack([solved[:, 1, 0], solved[:, 2, 1]], axis=1)
    return solved[:, 0], slopes, np.stack([solved[:, 2, 0], solved[:, 1, 1]], axis=1), residuals


def _target(indices, tracks, offsets, pitch: float, levels, lenslets) -> Target:
    """Regress the tracks, without corners that are seldom found and without outliers."""
    often = np.isfinite(tracks[..., 0]).mean(axis=0) >= LEAST_SHARE
    indices, tracks = indices[often], tracks[:, often]
    _refuse_few(indices)
    residuals = _regress(tracks, offsets)[3]
    usual = 1.4826 * np.nanmedian(np.abs(residuals)) + 1e-9
    tracks[np.abs(residuals).max(axis=2) > OUTLIER * usual] = np.nan
    often = np.isfinite(tracks[..., 0]).mean(axis=0) >= LEAST_SHARE / 2
    indices, tracks = indices[often], tracks[:, often]
    _refuse_few(indices)
    points, slopes, crossed, residuals = _regress(tracks, offsets)
    residual = float(np.sqrt(2 * np.nanmean(residuals**2)))
    if residual > WORST_RESIDUAL * pitch:
        raise InputError(
            f"The corners must move evenly from view to view, got residuals of {residual:.2g} "
            f"lenslets: the views are not in order, or the target is not flat."
        )
    points = points - (np.array(lenslets) - 1) / 2
    each = slopes.mean(axis=1)
    motion = np.array([np.mean(slopes, axis=0), np.mean(crossed, axis=0)])
    anisotropy, rotation = _directions(motion, fit_slopes(points, each)[1])
    return Target(
        indices,
        points,
        each,
        residual,
        anisotropy,
        rotation,
        levels.shape,
        lenslets,
        levels,
    )


def _directions(motion: np.ndarray, error: float) -> tuple[float, float]:
    """Anisotropy and rotation of the motion; NaN for a target that hardly moves.

    Raises
    ------
    InputError
        If the motion is not about the same down and right.
    """
    (down, right), (across_down, across_right) = motion
    size = max(abs(down), abs(right), abs(across_down), abs(across_right))
    if size < 20 * error:
        return np.nan, np.nan
    if max(abs(down - right), abs(across_down), abs(across_right)) > MOST_UNEVEN * size:
        raise InputError(
            f"Views must be ordered by row and column, at equal steps: from row to row the corners "
            f"move by ({down:.3g}, {across_right:.3g}) lenslets down and right, from column to "
            f"column by ({across_down:.3g}, {right:.3g})."
        )
    mean = (down + right) / 2
    return float((down - right) / mean), float((across_right - across_down) / 2 / mean)
