"""Emission of a flame that is round about an upright axis, from one light field: Abel inversion.

For one view with parallel rays this is Abel's integral equation (Hansen and Law, J. Opt. Soc. Am. A
2, 510, 1985, for its numerical side). Here rays run as the camera sees them, every view counts, and
the fit is penalised and without negative light.
"""

from dataclasses import dataclass, replace

import numpy as np

from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.tomography.axisymmetric_fit import AxisymmetricFit, BandedGram
from lf_flame.tomography.axisymmetric_grid import AxisymmetricGrid
from lf_flame.tomography.axisymmetric_operator import AxisymmetricOperator
from lf_flame.tomography.counted_views import counted_views
from lf_flame.tomography.data_checks import check_data, check_range
from lf_flame.tomography.error_bars import MOST_REDRAWS, noise_by_pixel, noise_variance
from lf_flame.tomography.flame_axis import FlameAxis
from lf_flame.tomography.frequency_gram import ROUGHNESS_ORDER
from lf_flame.tomography.plane_fit import average_blocks
from lf_flame.tomography.strength_search import StrengthSearch

MODEL_ERROR = 1e-3
"""Of the brightest pixel: noise below it does not limit a fit, so no weaker penalty is tried."""

ITERATIONS = 200
"""Of the splitting, for the solution; a quarter of them for each strength that is tried."""

MOST_LEAN_DEG = 1.0
"""Lean of the axis above which a warning is due: at 25 mm of height it is half a millimetre."""

MOST_LOPSIDED = 0.03
"""Difference of the halves above which a flame is not round."""


@dataclass(frozen=True, eq=False)
class AxisymmetricFlame:
    """Emission of a round flame by height and radius, and how far to trust it.

    Attributes
    ----------
    grid : AxisymmetricGrid
    emission : ndarray of float32, shape (heights, radii)
        Radiance per mm along the line of sight, in the light field's unit per mm; times 4 pi, power
        per volume where that is radiance.
    draws : ndarray of float32, shape (redraws, heights, radii)
        The same from light fields of the found emission with noise drawn anew.
    noise : float
        Standard deviation of a pixel's noise, stated or measured.
    strength : float
        Of the penalty that was taken.
    chi_squared : ndarray of float64, shape (v, u)
        Mean squared residual of each view that was looked at, in units of the noise's variance.
    warnings : tuple of str
        Where data and model disagree.
    """

    grid: AxisymmetricGrid
    emission: np.ndarray
    draws: np.ndarray
    noise: float
    strength: float
    chi_squared: np.ndarray
    warnings: tuple[str, ...]

    @property
    def sigma(self) -> np.ndarray | None:
        """Standard deviation of each node by noise, None without draws."""
        return self.draws.std(axis=0, ddof=1) if len(self.draws) else None


def reconstruct_axisymmetric(
    light_field: LightField,
    grid: AxisymmetricGrid,
    noise: float | None = None,
    strength: float | None = None,
    redraws: int = 0,
    rng: np.random.Generator | None = None,
) -> AxisymmetricFlame:
    """Find the emission of a round flame that explains a light field.

    Parameters
    ----------
    light_field : LightField
        Grey, of the grid's camera; black level subtracted, divided by a white image.
    grid : AxisymmetricGrid
        With the axis, as `lf_flame.tomography.find_axis` finds it or as it is known.
    noise : float, optional
        Standard deviation of a pixel's noise, after averaging over blocks. Default: measured, as
        what no round flame on the grid explains.
    strength : float, optional
        Of the penalty on third differences. Default: that of least expected error of the light
        field, see `StrengthSearch.find_by_risk`.
    redraws : int, optional
        Light fields of the found emission that are drawn with new noise, as uneven as that found,
        and fitted again: 0, or 2 and more.
    rng : numpy.random.Generator, optional
        Of redraws, and of vectors that estimate degrees of freedom. Default: seed 0.

    Returns
    -------
    AxisymmetricFlame

    Raises
    ------
    InputError
        If light field and grid do not fit, or a value cannot be used.
    """
    _check_options(noise, strength, redraws)
    rng = np.random.default_rng(0) if rng is None else rng
    light_field, camera, left_out = counted_views(light_field, grid.camera)
    grid = replace(grid, camera=camera) if left_out else grid
    views = grid.pick(average_blocks(light_field, grid.camera, grid.block))
    check_range(views, noise)
    operator, gram = AxisymmetricOperator(grid), BandedGram(grid)

    def problem_of(seen: np.ndarray) -> AxisymmetricFit:
        back = operator.rmatvec(seen.ravel().astype(float)).reshape(grid.shape)
        squared = float(np.sum(np.square(seen, dtype=np.float64)))
        return AxisymmetricFit(gram, back, squared, seen.size, rng)

    problem = problem_of(views)
    measured = problem.measure_noise()
    sd = measured if noise is None else float(noise)
    share = np.full(grid.shape, 1 / np.prod(grid.shape))
    variance = noise_variance(max(sd, MODEL_ERROR * float(views.max())))
    search = StrengthSearch(problem, variance, share, ROUGHNESS_ORDER, True, ITERATIONS // 4)
    chosen = search.find_by_risk() if strength is None else float(strength)
    options = (chosen, ROUGHNESS_ORDER, True, ITERATIONS)
    cells = problem.solve(*options, search.nearest(chosen)).cells
    fitted = operator.matvec(cells.ravel()).reshape(views.shape)
    residual = np.square(views - fitted, dtype=np.float64)
    chi_squared = residual.mean(axis=(2, 3)) / noise_variance(sd)
    by_place = sd * np.sqrt(noise_by_pixel(operator, views, problem.unpenalised()))
    draws = [
        problem_of(fitted + by_place * rng.standard_normal(views.shape)).solve(*options, cells)
        for _ in range(redraws)
    ]
    return AxisymmetricFlame(
        grid=grid,
        emission=cells[0].astype(np.float32),
        draws=np.array([draw.cells[0] for draw in draws], np.float32).reshape(-1, *grid.shape),
        noise=sd,
        strength=chosen,
        chi_squared=chi_squared,
        warnings=(*left_out, *check_data(views, chi_squared, sd, measured, noise is not None)),
    )


def check_roundness(axis: FlameAxis) -> tuple[str, ...]:
    """Say in words why a flame is not round about an upright axis, as far as it shows."""
    found = []
    if abs(axis.lean_deg) > MOST_LEAN_DEG:
        found.append(
            f"The axis leans by {axis.lean_deg:.1f} degrees: the inversion takes it for upright, "
            f"so rotate the picture, or look at fewer heights."
        )
    if axis.lopsided > MOST_LOPSIDED:
        found.append(
            f"The flame's halves differ by {axis.lopsided:.1%} of its light: it is not round, and "
            f"what is found is the round flame most like it."
        )
    return tuple(found)


def _check_options(noise: float | None, strength: float | None, redraws: int) -> None:
    for name, value in (("noise", noise), ("strength", strength)):
        if value is not None and not (np.isfinite(value) and value >= 0):
            raise InputError(f"{name} must be a finite number, 0 or above, got {value}.")
    if not 0 <= redraws <= MOST_REDRAWS or redraws == 1:
        raise InputError(f"redraws must be 0, or 2 to {MOST_REDRAWS}, got {redraws}.")
