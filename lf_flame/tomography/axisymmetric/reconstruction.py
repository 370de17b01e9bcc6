"""Emission of a flame that is round about an upright axis, from one light field: Abel inversion.

For one view with parallel rays this is Abel's integral equation (Hansen and Law, J. Opt. Soc. Am. A
2, 510, 1985, for its numerical side). Here rays run as the camera sees them, every view counts, and
the fit is penalised and without negative light.
"""

from dataclasses import dataclass, replace

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
from lf_flame.tomography.counted_views import counted_views
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
"""Share of the brightest pixel below which noise does not limit a fit: the grid does."""

ITERATIONS = 200
"""Iterations of the splitting for the solution; a quarter for each strength that is tried and for
each draw."""


@dataclass(frozen=True, eq=False)
class AxisymmetricFlame:
    """Emission of a round flame by height and radius, and how far to trust it.

    Attributes
    ----------
    grid : AxisymmetricGrid
    emission : ndarray of float32, shape (heights, radii)
        Radiance per mm along the line of sight, in the light field's unit per mm; times 4 pi, power
        per volume where that is radiance.
    draws : ndarray of float32, shape (draws, heights, radii)
        Emission that light field and penalty leave as possible, drawn at random.
    noise : float
        Standard deviation of a pixel's noise, stated or measured.
    strength : float
        Strength of the penalty that was taken.
    chi_squared : ndarray of float64, shape (v, u)
        Mean squared residual of each view that was looked at, in units of the noise's variance.
    warnings : tuple of str
        Where data and model disagree.
    unseen : tuple of str
        Departures from a round, upright flame that this light field would not show.
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
        """Standard deviation of each node by noise and penalty, None without draws."""
        return self.draws.std(axis=0, ddof=1) if len(self.draws) else None

    @property
    def bar(self) -> np.ndarray | None:
        """Half of the width of each node's bar of 95 %, None without draws.

        Light that bends between nodes, as with coarse blocks, is not in it.
        """
        if self.sigma is None:
            return None
        # Few draws know their own scatter badly: Student's t.
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
    """Find the emission of a round flame that explains a light field.

    Parameters
    ----------
    light_field : LightField
        Grey, of the grid's camera; black level subtracted, divided by a white image. A grid that
        looks at the central view takes that view alone, too.
    grid : AxisymmetricGrid
        With the axis, as `lf_flame.tomography.find_axis` finds it or as it is known.
    noise : float, optional
        Standard deviation of a pixel's noise, after averaging over blocks. Default: measured, as
        what no round flame on the grid explains.
    strength : float, optional
        Of the penalty on third differences. Default: that of least expected error of the light
        field, see `StrengthSearch.find_by_risk`.
    bootstrap : int, optional
        Number of draws for the error bars: noise, as uneven as that found, is added to the light
        field and to the prior, and all is fitted again (`AxisymmetricFit.draw`); 0, or 2 and more.
    rng : int, numpy.random.Generator or None, optional
        Seed or generator of the bootstrap, and of vectors that estimate degrees of freedom; None
        draws differently each time.

    Returns
    -------
    AxisymmetricFlame

    Raises
    ------
    InputError
        If light field and grid do not fit, or a value cannot be used.

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
    light_field, camera, left_out = counted_views(light_field, grid.camera)
    grid = replace(grid, camera=camera) if left_out else grid
    views = _looked_at(light_field, grid)
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
    # Bright nodes see more noise than a mean pixel holds, where light comes in portions.
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
    chi_squared = np.square(residual, dtype=np.float64).mean(axis=(2, 3)) / noise_variance(sd)
    by_place = sd * np.sqrt(uneven)
    # The prior's scale is the noise where light is, as the strength was chosen for that.
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
    # Another axis or radius looks like another depth, too.
    departures = departures or depth_ratio.check()
    misfit = check_misfit(residual, float(views.max()))
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
    """Average the views that a grid looks at over its blocks."""
    if grid.which == "central" and light_field.views.shape[:2] == (1, 1):
        alone = replace(grid.camera, views=1, pixel_pitch_mm=None)
        return average_blocks(light_field, alone, grid.block)
    return grid.pick(average_blocks(light_field, grid.camera, grid.block))


def check_fit_options(noise: float | None, strength: float | None, bootstrap: int) -> None:
    """Refuse options of a fit that cannot be used, before anything that takes time.

    Raises
    ------
    InputError
    """
    for name, value in (("noise", noise), ("strength", strength)):
        if value is not None and not (np.isfinite(value) and value >= 0):
            raise InputError(f"{name} must be a finite number, 0 or above, got {value}.")
    check_bootstrap(bootstrap)
