"""Emission by depth from one light field: what is found, its error bars, and warnings."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from lf_flame._common import progress
from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.tomography.absorption import spread_thickness
from lf_flame.tomography.background import Level
from lf_flame.tomography.cell_detail import SmoothStack
from lf_flame.tomography.counted_views import counted_views
from lf_flame.tomography.data_checks import check_data, check_overlap, check_range, check_spacing
from lf_flame.tomography.error_bars import (
    check_bootstrap,
    noise_variance,
    redraw,
    scatter,
    standard_errors,
)
from lf_flame.tomography.explainer import Explainer
from lf_flame.tomography.frequency_gram import ROUGHNESS_ORDER, FrequencyGram
from lf_flame.tomography.frustum_grid import MOST_PLANES, FrustumGrid
from lf_flame.tomography.plane_fit import (
    PENALTIES,
    ROUGHNESS,
    FitOptions,
    PlaneFit,
    average_blocks,
)
from lf_flame.tomography.projection_operator import ProjectionOperator
from lf_flame.tomography.strength_search import TriedStrength

ITERATIONS = 160
"""Number of steps of the splitting, for the solution. For each strength that is tried an eighth of
them, from the last one's; for each draw a quarter, from the solution: its scatter is that of half
of them within 5 %."""

FIT = "fit"
"""Value of `background` by which it is fitted."""

UNSETTLED = (
    "The correction for absorption has not settled: emission and optical thickness do not go "
    "together, or the thickness is too large."
)


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Emission by depth, and how far to trust it.

    Attributes
    ----------
    grid : FrustumGrid
    emission : ndarray of float32, shape (planes, rows, columns)
        Radiance that each plane adds along the line of sight, in the unit of the light field;
        rows and columns are the pixels of the central view. `per_mm` is emission by volume. With
        an optical thickness, the radiance that each would add if nothing were absorbed.
    correction : ndarray of float32, shape of `emission`
        What was added to the fit, for what penalty and even cells do to a flame; zeros where
        nothing was.
    draws : ndarray of float32, shape (draws, planes, rows, columns)
        Emission of light fields that were drawn anew from what was found, with noise, and with the
        penalty's prior drawn anew; of the correction each takes between none and twice. What the
        aperture cannot tell in depth is not all in their scatter.
    sigma_linear : ndarray of float64, shape (planes,)
        That of each plane's cells by the covariance, were light allowed to be negative: how much
        the bound at zero adds to what the light field itself tells.
    noise : float
        Standard deviation of the noise of a pixel, stated or measured, in the same unit.
    strength : float
        Of the penalty that was taken.
    tried : tuple of TriedStrength
        The L-curve: what was tried to find it, weakest first.
    chi_squared : ndarray of float64, shape (v, u)
        Mean squared residual of each view, in units of the noise's variance.
    warnings : tuple of str
        Where data and model disagree.
    background, background_sigma : float
        Even background that was fitted and taken off, and its standard deviation; 0 without.
    """

    grid: FrustumGrid
    emission: np.ndarray
    correction: np.ndarray
    draws: np.ndarray
    sigma_linear: np.ndarray
    noise: float
    strength: float
    tried: tuple[TriedStrength, ...]
    chi_squared: np.ndarray
    warnings: tuple[str, ...]
    background: float = 0.0
    background_sigma: float = 0.0

    @cached_property
    def sigma(self) -> np.ndarray | None:
        """Standard error of each cell by noise, penalty and cells; None where nothing was drawn.

        float32, shape of `emission`. What the aperture cannot tell in depth is not all in it: of a
        flame that is thick in depth the truth lies outside many bars.
        """
        return scatter(self.draws, self.emission) if len(self.draws) else None

    @property
    def light_sigma(self) -> np.ndarray | None:
        """Give the same of the sum over each plane's cells, float64, shape (planes,)."""
        if not len(self.draws):
            return None
        sums = (one.sum(axis=(-2, -1), dtype=np.float64) for one in (self.draws, self.emission))
        return scatter(*sums)

    @property
    def spacing_mm(self) -> float | None:
        """Distance between neighbouring planes, where all are as far apart."""
        steps = np.abs(np.diff(self.grid.depths_mm))
        return float(steps[0]) if steps.size and np.ptp(steps) <= 1e-6 * steps[0] else None

    @property
    def per_mm(self) -> np.ndarray:
        """Emission by length of the line of sight: each plane's over the planes' distance.

        Radiance per mm, shape of `emission`; times 4 pi, power per volume where the light field
        is in radiance.

        Raises
        ------
        InputError
            If the planes are not evenly spaced.
        """
        if self.spacing_mm is None:
            raise InputError(
                f"Emission by volume needs two or more evenly spaced planes, got the depths "
                f"{list(self.grid.depths_mm)}."
            )
        return self.emission / np.float32(self.spacing_mm)


def reconstruct(
    light_field: LightField,
    grid: FrustumGrid,
    *,
    noise: float | None = None,
    strength: float | None = None,
    order: int = ROUGHNESS_ORDER,
    nonnegative: bool = True,
    iterations: int = ITERATIONS,
    dark_cells: bool = True,
    corrected: bool = True,
    whole_curve: bool = False,
    bootstrap: int = 0,
    rng: int | np.random.Generator | None = 0,
    optical_thickness: ArrayLike | None = None,
    penalty: str = ROUGHNESS,
    background: str | None = None,
) -> Reconstruction:
    """Find the emission of the planes of a grid that explains a light field.

    Least squares with a penalty on roughness and no negative light. The strength of the penalty
    follows the discrepancy principle (Morozov 1966): the residual is to be what noise leaves, less
    the degrees of freedom that the fit itself takes up (Wahba, SIAM J. Numer. Anal. 14, 651, 1977),
    here the trace of the linear fit times the share of cells above zero. Where the model's own
    error keeps the residual above that, the strength is taken at which it is least above it.

    Parameters
    ----------
    light_field : LightField
        Grey, of the grid's camera; black level subtracted, divided by a white image.
    grid : FrustumGrid
    noise : float, optional
        Standard deviation of a pixel's noise, after averaging over blocks, in the unit of the
        light field. Default: measured, as what no emission on the grid explains.
    strength : float, optional
        Of the penalty, instead of the principle's.
    order : int, optional
        Of the differences that are penalised: 1 to 4.
    nonnegative : bool, optional
    iterations : int, optional
        Of the splitting that keeps light from being negative.
    dark_cells : bool, optional
        Whether light that is hardly more than what noise alone makes is taken for none, unless the
        light field speaks against it: see `lf_flame.tomography.foreground`.
    corrected : bool, optional
        Whether what penalty and even cells do to a flame is computed and taken off: see
        `lf_flame.tomography.plane_fit.PlaneFit.correct`.
    whole_curve : bool, optional
        Whether all strengths are tried, for the L-curve, instead of the few that are needed.
    bootstrap : int, optional
        Number of light fields of the found emission that are drawn with new noise, as uneven as
        that found, and fitted again, for `Reconstruction.sigma`: 0, or 2 and more.
    rng : int, numpy.random.Generator or None, optional
        Seed or generator of the bootstrap; None draws differently each time.
    optical_thickness : float, or array_like of shape (planes,) or (planes, rows, columns), optional
        Absorption along the line of sight, 0 or above, known from elsewhere: the total, spread
        evenly over the planes, or each plane's, even across it or by the pixels of the central
        view. A plane lets ``(1 - exp(-tau)) / tau`` of its own light out and ``exp(-tau)`` of what
        is behind it through, at greater depth, as a `Layer` does. The penalty then is on the
        emission as it leaves towards the camera. Default: light only adds.
    penalty : {"roughness", "variation"}, optional
        "variation" is for emission with sharp edges: total variation, whose strength is in standard
        deviations of a cell's filtered noise, 2 where none is said. There `order`, `nonnegative`,
        `dark_cells`, `corrected` and `whole_curve` are not asked.
    background : {"fit"}, optional
        "fit" takes an even background of unknown level off: the mean of the pixels that no
        emission reaches, so some of the field must be dark. Its error is in the error bars.
        Default: there is none.

    Returns
    -------
    Reconstruction

    Raises
    ------
    InputError
        If light field and grid do not fit, or a value cannot be used.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import numpy as np
    >>> from lf_flame import PAPER_CAMERA, render
    >>> from lf_flame.tomography import FrustumGrid
    >>> camera = replace(PAPER_CAMERA, views=5, lenslets=(32, 40))
    >>> grid = FrustumGrid(camera, [6.0, -6.0])

    >>> y, x = np.mgrid[-1:1:32j, -1:1:40j]
    >>> glow = np.exp(-8 * (x**2 + y**2))
    >>> cells = np.zeros(grid.shape)
    >>> grid.crop(cells)[...] = glow, 0.5 * glow
    >>> light_field = render(grid.scene(cells), camera)
    >>> from lf_flame.tomography import reconstruct
    >>> found = reconstruct(light_field, grid, noise=0.001)
    >>> bool(np.abs(found.emission - grid.crop(cells)).max() < 0.1)
    True
    """
    _check_options(noise, strength, order, iterations)
    if penalty not in PENALTIES:
        raise InputError(f"penalty must be one of {', '.join(PENALTIES)}, got {penalty!r}.")
    options = FitOptions(
        noise, strength, order, nonnegative, iterations, whole_curve, dark_cells, penalty
    )
    smooth_penalty = penalty == ROUGHNESS
    check_bootstrap(bootstrap)
    rng = np.random.default_rng(rng)
    light_field, camera, left_out = counted_views(light_field, grid.camera)
    grid = replace(grid, camera=camera) if left_out else grid
    thickness = None if optical_thickness is None else spread_thickness(grid, optical_thickness)
    if background not in (None, FIT):
        raise InputError(f"background must be None or {FIT!r}, got {background!r}.")
    views = average_blocks(light_field, grid.camera, grid.block)
    check_range(views, noise)
    operator, gram = ProjectionOperator(grid), FrequencyGram(grid)
    fit = PlaneFit(operator, gram, options)
    explain = Explainer(fit, grid, thickness)
    level = explain.level(views) if background == FIT else Level(0.0, 0.0)
    views = views - np.float32(level.mean) if level.mean else views
    found, settled = explain(views)
    seen, leaves = explain.seen(found.cells), explain.leaves
    residual = views - seen
    chi_squared = np.square(residual, dtype=np.float64).mean(axis=(2, 3))
    chi_squared /= noise_variance(found.noise)
    # All as it leaves towards the camera: noise is no other for what single views see absorbed.
    smooth = SmoothStack(grid)
    twice = smooth_penalty and nonnegative and corrected
    half, few = max(1, iterations // 2), max(1, iterations // 4)
    correction = fit.correct(found, smooth, half) if twice else np.zeros_like(found.cells)
    cells, again = found.cells + correction, []
    if bootstrap:
        prior = found.strength, order, found.lit_noise(seen) if smooth_penalty else 0.0
        drawn_from = smooth(cells), found.pixel_noise, level.error, prior
        drawn_anew = redraw(operator, gram, *drawn_from, bootstrap, rng)
        for one in progress.steps(drawn_anew, "error bars", bootstrap, "draw"):
            drawn = replace(found, cells=fit.again(one, found, few))
            # The correction of each draw is its own, and any from none to twice is as likely (JCGM
            # 100, 4.3.7): how much it leaves is not known.
            own = rng.uniform(0, 2) * fit.correct(drawn, smooth, few) if twice else 0
            again.append(grid.crop(drawn.cells + own) / leaves)
    emission = np.ascontiguousarray(grid.crop(cells) / leaves)
    return Reconstruction(
        grid=grid,
        emission=emission,
        correction=np.ascontiguousarray(grid.crop(correction) / leaves),
        draws=np.array(again, np.float32).reshape(-1, *emission.shape),
        sigma_linear=_raised(leaves)
        * standard_errors(gram, found.noise, found.strength if smooth_penalty else 0.0, order),
        noise=found.noise,
        strength=found.strength,
        tried=found.tried,
        chi_squared=chi_squared,
        warnings=(
            *left_out,
            *check_data(
                views,
                chi_squared,
                found.noise,
                found.measured,
                noise is not None,
                residual=residual,
            ),
            *check_spacing(grid),
            *(check_overlap(grid, emission) if again else ()),
            *(() if settled else (UNSETTLED,)),
        ),
        background=level.mean,
        background_sigma=level.error,
    )


def _raised(leaves: np.ndarray) -> np.ndarray:
    """By how much a plane's errors grow, root-mean-square, if this share of its light leaves it."""
    return np.sqrt(np.mean(np.square(1 / leaves, dtype=np.float64), axis=(1, 2)))


def _check_options(
    noise: float | None, strength: float | None, order: int, iterations: int
) -> None:
    for name, value in (("noise", noise), ("strength", strength)):
        if value is not None and not (np.isfinite(value) and value >= 0):
            raise InputError(f"{name} must be a finite number, 0 or above, got {value}.")
    if order not in (1, 2, 3, 4):
        raise InputError(f"order must be 1, 2, 3 or 4, got {order}.")
    if iterations < 1:
        raise InputError(f"iterations must be 1 or more, got {iterations}.")


def planes_between(from_mm: float, to_mm: float, step_mm: float) -> Sequence[float]:
    """Depths of evenly spaced planes, both ends included.

    Raises
    ------
    InputError
        If the step does not lead from one end to the other.
    """
    if not (np.isfinite([from_mm, to_mm, step_mm]).all() and step_mm > 0):
        raise InputError(
            f"Depths need finite ends and a step above 0 mm, got {from_mm}, {to_mm}, {step_mm}."
        )
    with np.errstate(over="ignore"):
        steps = np.abs(np.subtract(to_mm, from_mm)) / step_mm
    if not steps < MOST_PLANES:
        raise InputError(
            f"Depths must be at most {MOST_PLANES} planes, got {from_mm:g} to {to_mm:g} mm in "
            f"steps of {step_mm:g} mm."
        )
    count = round(float(steps))
    if abs(count * step_mm - abs(to_mm - from_mm)) > 1e-6 * step_mm:
        raise InputError(
            f"The step of {step_mm} mm must divide the way from {from_mm} to {to_mm} mm."
        )
    return [float(depth) for depth in np.linspace(from_mm, to_mm, count + 1)]
