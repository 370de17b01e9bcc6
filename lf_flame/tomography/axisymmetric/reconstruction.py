"""Emission of an axisymmetric flame with an upright axis from one light field: Abel inversion.

For one view with parallel rays this is Abel's integral equation (Hansen and Law, J. Opt. Soc. Am. A
2, 510, 1985, for its numerical side). Here rays are those of the camera, all views are used, and
the fit is regularised and without negative light.
"""

from dataclasses import dataclass

import numpy as np

from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.tomography.axisymmetric.axis import find_axis
from lf_flame.tomography.axisymmetric.fit import AxisymmetricFit, BandedGram
from lf_flame.tomography.axisymmetric.grid import AxisymmetricGrid
from lf_flame.tomography.axisymmetric.operator import AxisymmetricOperator
from lf_flame.tomography.axisymmetric.roundness import (
    DepthRatio,
    check_misfit,
    check_roundness,
    check_stated,
    name_unseen,
)
from lf_flame.tomography.counted_views import fitted_views
from lf_flame.tomography.data_checks import check_data, check_range
from lf_flame.tomography.error_bars import (
    bar_times,
    check_bootstrap,
    noise_by_pixel,
    noise_variance,
)
from lf_flame.tomography.frequency_gram import ROUGHNESS_ORDER
from lf_flame.tomography.plane_fit import average_blocks
from lf_flame.tomography.strength_search import StrengthSearch

MODEL_ERROR = 1e-3
"""Noise relative to the brightest pixel below which not the noise but the grid limits a fit."""

ITERATIONS = 200
"""Number of iterations of the splitting (ADMM) for the solution; a quarter of it for each strength
that is tried and for each draw."""


@dataclass(frozen=True, eq=False)
class AxisymmetricFlame:
    """Emission of an axisymmetric flame by height and radius, with errors and warnings.

    Attributes
    ----------
    grid : AxisymmetricGrid
        Nodes of the half section.
    emission : ndarray of float32, shape (heights, radii)
        Emission along the line of sight, in the light field's unit per mm. If that unit is a
        radiance, 4 pi times the emission is power per volume.
    draws : ndarray of float32, shape (draws, heights, radii)
        Random draws of emission (bootstrap) that light field and penalty allow.
    noise : float
        Standard deviation of a pixel's noise, stated or measured.
    strength : float
        Strength of the regularisation that was used.
    chi_squared : ndarray of float64, shape (v, u)
        Mean squared residual of each view, in units of the noise's variance; NaN of views that
        are not fitted.
    warnings : tuple of str
        Sentences on disagreements of data and model.
    unseen : tuple of str
        Departures from an upright, axisymmetric flame that this light field would not show.
    """

    grid: AxisymmetricGrid
    emission: np.ndarray
    draws: np.ndarray
    noise: float
    strength: float
    chi_squared: np.ndarray
    warnings: tuple[str, ...]
    unseen: tuple[str, ...] = ()

    @property
    def sigma(self) -> np.ndarray | None:
        """Standard deviation of each node due to noise and penalty, None without draws."""
        return self.draws.std(axis=0, ddof=1) if len(self.draws) else None

    @property
    def bar(self) -> np.ndarray | None:
        """Half-width of each node's 95 % error bar, None without draws.

        It excludes errors from curvature of the emission between nodes, as with large blocks.
        """
        if self.sigma is None:
            return None
        # With few draws the standard deviation is uncertain: Student's t.
        return (bar_times(len(self.draws) - 1) * self.sigma).astype(np.float32)


def reconstruct_axisymmetric(
    light_field: LightField,
    grid: AxisymmetricGrid,
    *,
    noise: float | None = None,
    strength: float | None = None,
    bootstrap: int = 0,
    rng: int | np.random.Generator | None = 0,
) -> AxisymmetricFlame:
    """Find the emission of an axisymmetric flame that explains a light field.

    Parameters
    ----------
    light_field : LightField
        Grey light field of the grid's camera, black level subtracted, divided by a white image
        (flat field). If the grid uses only the central view, that view alone is enough.
    grid : AxisymmetricGrid
        Grid with the axis, as `lf_flame.tomography.find_axis` finds it or as it is known.
    noise : float, optional
        Standard deviation of a pixel's noise, after averaging over blocks. Default: measured from
        the part that no axisymmetric flame on the grid explains.
    strength : float, optional
        Strength of the regularisation, a penalty on third differences. Default: the strength with
        the least expected error of the light field, see `StrengthSearch.find_by_risk`.
    bootstrap : int, optional
        Number of draws for the error bars, 0, or 2 and more: noise with the measured dependence on
        brightness is added to the light field and to the prior, and the fit is repeated
        (`AxisymmetricFit.draw`).
    rng : int, numpy.random.Generator or None, optional
        Seed or generator of the bootstrap, and of vectors that estimate degrees of freedom; with
        None every call draws differently.

    Returns
    -------
    AxisymmetricFlame
        Emission with error bars and warnings.

    Raises
    ------
    InputError
        If light field and grid do not match, or a value cannot be used.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from lf_flame import PAPER_CAMERA
    >>> from lf_flame.tomography import AxisymmetricGrid
    >>> camera = replace(PAPER_CAMERA, views=3, lenslets=(24, 40))
    >>> grid = AxisymmetricGrid(camera, axis_mm=0.0, depth_mm=0.0, radius_mm=1.5)

    >>> import numpy as np
    >>> from lf_flame import LightField
    >>> from lf_flame.tomography import AxisymmetricOperator, reconstruct_axisymmetric
    >>> glow = np.outer(np.ones(grid.shape[0]), np.exp(-4 * grid.radii_mm**2))
    >>> operator = AxisymmetricOperator(grid)
    >>> views = np.reshape(operator @ glow.ravel(), operator.dimsd)
    >>> found = reconstruct_axisymmetric(LightField(views), grid)
    >>> bool(np.abs(found.emission - glow)[2:-2].max() < 0.01)  # but at the field's edges
    True
    """
    check_fit_options(noise, strength, bootstrap)
    rng = np.random.default_rng(rng)
    left_out: tuple[str, ...] = ()
    even = grid.camera.corrected(light_field)
    if grid.which == "all":
        grid, left_out = fitted_views(even, grid)
    views = _looked_at(even, grid)
    check_range(views, noise)
    depth = grid.depth_mm if light_field.views.shape[1] < 3 else None
    axis = find_axis(light_field, grid.camera, depth)
    operator, gram = AxisymmetricOperator(grid), BandedGram(grid)
    back = operator.rmatvec(views.ravel().astype(float)).reshape(grid.shape)
    squared = float(np.sum(np.square(views, dtype=np.float64)))
    problem = AxisymmetricFit(gram, back, squared, views.size, rng)
    measured = problem.measure_noise()
    sd = measured if noise is None else float(noise)
    best = problem.unpenalised()
    uneven = noise_by_pixel(operator, views, best)
    # With photon noise, bright nodes see more noise than the mean pixel.
    seen = operator.rmatvec(np.broadcast_to(uneven, views.shape).ravel())
    by_node = seen / np.maximum(operator.rmatvec(np.ones(views.size)), 1e-300)
    by_node = by_node.reshape(grid.shape)
    limited = max(sd, MODEL_ERROR * float(views.max()))
    variance = noise_variance(limited) * float(by_node.mean())
    share = by_node / by_node.sum()
    search = StrengthSearch(problem, variance, share, ROUGHNESS_ORDER, True, ITERATIONS // 4)
    chosen = search.find_by_risk() if strength is None else float(strength)
    options = (chosen, ROUGHNESS_ORDER, True, ITERATIONS)
    cells = problem.solve(*options, search.nearest(chosen)).cells
    fitted = operator.matvec(cells.ravel()).reshape(views.shape)
    residual = views - fitted
    chi_squared = np.square(residual, dtype=np.float64).mean(axis=(2, 3))
    chi_squared = grid.place(chi_squared / noise_variance(sd), np.nan)
    by_place = sd * np.sqrt(uneven)
    # The prior's scale is the noise inside the flame, for which the strength was chosen.
    light = max(float(np.sum(cells)), 1e-300)
    lit_sd = sd * np.sqrt(float(np.sum(by_node * cells[0])) / light)
    draws, fewer = [], (*options[:3], ITERATIONS // 4)
    for _ in range(bootstrap):
        noise_alone = by_place * rng.standard_normal(views.shape)
        back = operator.rmatvec(noise_alone.ravel()).reshape(grid.shape)
        draws.append(problem.draw(back, lit_sd, fewer, cells, rng))
    rest = views - operator.matvec(best.ravel()).reshape(views.shape)
    depth_ratio = DepthRatio(operator, problem, cells[0], rest, by_place)
    departures = check_roundness(axis) + check_stated(axis, grid, views)
    # A wrong axis or radius would look like another depth ratio.
    departures = departures or depth_ratio.check()
    misfit = check_misfit(grid, residual, float(views.max()))
    unsaid = None if misfit else residual
    return AxisymmetricFlame(
        grid=grid,
        emission=cells[0].astype(np.float32),
        draws=np.array(draws, np.float32).reshape(-1, *grid.shape),
        noise=sd,
        strength=chosen,
        chi_squared=chi_squared,
        warnings=(
            *left_out,
            *departures,
            *misfit,
            *check_data(views, chi_squared, sd, measured, noise is not None, residual=unsaid),
        ),
        unseen=name_unseen(axis, depth_ratio),
    )


def _looked_at(light_field: LightField, grid: AxisymmetricGrid) -> np.ndarray:
    """Select the views that a grid uses, averaged over its blocks."""
    if grid.which == "central" and light_field.views.shape[:2] == (1, 1):
        alone = grid.camera.with_views(1)
        return average_blocks(light_field, alone, grid.block)
    return grid.pick(average_blocks(light_field, grid.camera, grid.block))


def check_fit_options(noise: float | None, strength: float | None, bootstrap: int) -> None:
    """Refuse unusable options of a fit before any computation.

    Raises
    ------
    InputError
        If noise or strength is negative or not finite, or the number of draws is 1 or negative.
    """
    for name, value in (("noise", noise), ("strength", strength)):
        if value is not None and not (np.isfinite(value) and value >= 0):
            raise InputError(f"{name} must be a finite number, 0 or above, got {value}.")
    check_bootstrap(bootstrap)
