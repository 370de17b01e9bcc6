"""Emission by depth from one light field, with error bars and warnings."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lf_flame._common import progress
from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.tomography.absorption import spread_thickness
from lf_flame.tomography.background import Level
from lf_flame.tomography.counted_views import fitted_views
from lf_flame.tomography.data_checks import (
    check_data,
    check_overlap,
    check_range,
    check_spacing,
    check_unknown,
)
from lf_flame.tomography.error_bars import (
    Expected,
    check_bootstrap,
    noise_variance,
    redraw,
    scatter,
)
from lf_flame.tomography.explainer import Explainer
from lf_flame.tomography.frequency_gram import FrequencyGram
from lf_flame.tomography.frustum_grid import MOST_PLANES, FrustumGrid
from lf_flame.tomography.iterative_methods import (
    MOST,
    PENALISED,
    check_bars,
    check_method,
    iterate,
)
from lf_flame.tomography.penalties import ROUGHNESS, Penalty, Roughness, as_penalty
from lf_flame.tomography.plane_fit import (
    Explanation,
    FitOptions,
    PlaneFit,
    average_blocks,
    known_blocks,
)
from lf_flame.tomography.projection_operator import ProjectionOperator
from lf_flame.tomography.strength_search import TriedStrength

ITERATIONS = 160
"""Number of iterations of the splitting for the solution. Each strength that is tried takes an
eighth of them, starting from the previous one; each draw takes a quarter, starting from the
solution, with a scatter that is within 5 % of that of half the iterations."""

FIT = "fit"
"""Value of `background` with which a background is fitted."""

UNSETTLED = (
    "The correction for absorption has not converged: emission and optical thickness are "
    "inconsistent, or the thickness is too large."
)


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Emission by depth, with its error bars and warnings.

    Attributes
    ----------
    grid : FrustumGrid
        Depth planes and cells.
    emission : ndarray of float32, shape (planes, rows, columns)
        Radiance that each depth plane adds along the line of sight, in the unit of the light field;
        rows and columns are the pixels of the central view. `per_mm` is emission by volume. With
        an optical thickness, it is the radiance that each plane would add without absorption.
    correction : ndarray of float32, shape of `emission`
        Part of the emission that was added to the fit to correct the effect of penalty and constant
        cells; zeros without correction.
    draws : ndarray of float32, shape (draws, planes, rows, columns)
        Bootstrap draws of the emission: refits with redrawn noise and redrawn prior of the penalty,
        each with a random multiple, between 0 and 2, of the correction. Their scatter does not
        include all of the uncertainty in depth.
    sigma_linear : ndarray of float64, shape (planes,)
        Standard deviation of the unconstrained linear fit, one number for each plane. Compared with
        `sigma`, it shows how much the constraint of no negative light contributes.
    noise : float
        Standard deviation of a pixel's noise, stated or measured, in the unit of the light field.
    strength : float
        Strength of the regularisation that was used; 0 for a method that stops early.
    tried : tuple of TriedStrength
        Strengths that were tried (the L-curve), weakest first.
    chi_squared : ndarray of float64, shape (v, u)
        Mean squared residual of each view, in units of the noise's variance; NaN of views that are
        not fitted.
    warnings : tuple of str
        Sentences on disagreements of data and model.
    background, background_sigma : float
        Uniform background that was fitted and subtracted, and its standard deviation; 0 without.
    iterations : int or None
        Number of iterations after which a method stopped; None for the penalised fit.
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
    iterations: int | None = None

    @cached_property
    def sigma(self) -> np.ndarray | None:
        """Standard error of each cell due to noise, penalty and cells; None without draws.

        float32, shape of `emission`. It does not include all of the uncertainty in depth: for a
        flame that is thick in depth, the truth is outside many error bars.
        """
        return scatter(self.draws, self.emission) if len(self.draws) else None

    @property
    def light_sigma(self) -> np.ndarray | None:
        """Standard error of the sum over each plane's cells, float64, shape (planes,), or None."""
        if not len(self.draws):
            return None
        sums = (one.sum(axis=(-2, -1), dtype=np.float64) for one in (self.draws, self.emission))
        return scatter(*sums)

    @property
    def spacing_mm(self) -> float | None:
        """Distance between neighbouring planes in mm, if it is the same for all; else None."""
        steps = np.abs(np.diff(self.grid.depths_mm))
        return float(steps[0]) if steps.size and np.ptp(steps) <= 1e-6 * steps[0] else None

    @property
    def per_mm(self) -> np.ndarray:
        """Emission per length of the line of sight: a plane's emission over the planes' distance.

        It is in radiance per mm, shape of `emission`; times 4 pi it is power per volume, if the
        light field is in radiance.

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
    iterations: int | None = None,
    bootstrap: int = 0,
    rng: int | np.random.Generator | None = 0,
    optical_thickness: ArrayLike | None = None,
    penalty: str | Penalty = ROUGHNESS,
    background: str | None = None,
    method: str = PENALISED,
) -> Reconstruction:
    """Find the emission on a grid's depth planes that explains a light field.

    It is a least-squares fit with regularisation (a penalty on roughness) and no negative light.
    The strength follows the discrepancy principle (Morozov 1966): the residual must equal the
    noise, reduced by the degrees of freedom of the fit (Wahba, SIAM J. Numer. Anal. 14, 651, 1977),
    here the trace of the linear fit times the fraction of cells above zero. If the model's own
    error keeps the residual higher, the strength with the smallest excess is used.

    Parameters
    ----------
    light_field : LightField
        Grey light field of the grid's camera, black level subtracted, divided by a white image
        (flat field). Unknown pixels (`LightField.valid`) have weight 0.
    grid : FrustumGrid
        Depth planes and cells.
    noise : float, optional
        Standard deviation of a pixel's noise, after averaging over blocks, in the unit of the
        light field. Default: measured from the part that no emission on the grid explains.
    strength : float, optional
        Strength of the regularisation. Default: by the discrepancy principle.
    iterations : int, optional
        Number of iterations (of the splitting method ADMM) that keep light from being negative,
        160 by default; or the largest number of another method, 1000 by default.
    bootstrap : int, optional
        Number of bootstrap light fields, each made of the found emission and new noise, with the
        measured dependence of noise on brightness, and fitted again for `Reconstruction.sigma`: 0,
        or 2 and more.
    rng : int, numpy.random.Generator or None, optional
        Seed or generator of the bootstrap; with None every call draws differently.
    optical_thickness : float, or array_like of shape (planes,) or (planes, rows, columns), optional
        Known absorption along the line of sight, 0 or above: the total, spread evenly over the
        planes, or a value for each plane, or for each plane and pixel of the central view. Like a
        `Layer`, a plane transmits ``(1 - exp(-tau)) / tau`` of its own light and ``exp(-tau)`` of
        the light from behind it, at greater depth. The penalty then acts on the emission as it
        leaves towards the camera. Default: no absorption.
    penalty : {"roughness", "variation"}, Roughness or TotalVariation, optional
        Kind of regularisation: roughness for flames, which are smooth, and total variation for
        emission with sharp edges, by name or as `lf_flame.tomography.Roughness` with its options.
        Strengths of "variation" are in standard deviations of a cell's filtered noise, 2 by
        default.
    background : {"fit"}, optional
        "fit" subtracts a uniform background of unknown level: the mean of the pixels that no
        emission reaches, so some of the field must be dark. Its error is in the error bars.
        Default: no background.
    method : {"penalised", "sart", "mlem", "lsqr", "nnls"}, optional
        Method: the penalised fit; or, to compare with, a classical one that has no penalty but
        stops as soon as the squared residual of the known rays falls to the noise. SART takes all
        views at once (SIRT), MLEM is Richardson-Lucy, NNLS is non-negative least squares by
        accelerated gradients, and LSQR is linear, with negative light. They have no error bars.

    Returns
    -------
    Reconstruction
        Emission with warnings, and with error bars if `bootstrap` is not 0.

    Raises
    ------
    InputError
        If light field and grid do not match, or a value cannot be used.

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
    check_bootstrap(bootstrap)
    check_method(method, strength, penalty != ROUGHNESS)
    check_bars(method, bootstrap)
    plain = method == PENALISED
    iterations = (ITERATIONS if plain else MOST) if iterations is None else iterations
    # Other methods take noise, background and warnings from a fit that is linear, which is quick,
    # unless a background is measured where no light is found.
    measuring = Roughness(nonnegative=background == FIT, corrected=False)
    few = iterations if plain else min(iterations, ITERATIONS)
    options = FitOptions(noise, strength, few, as_penalty(penalty) if plain else measuring)
    if background not in (None, FIT):
        raise InputError(f"background must be None or {FIT!r}, got {background!r}.")
    rng = np.random.default_rng(rng)
    light_field = grid.camera.corrected(light_field)
    grid, left_out = fitted_views(light_field, grid)
    thickness = None if optical_thickness is None else spread_thickness(grid, optical_thickness)
    views = grid.pick(average_blocks(light_field, grid.camera, grid.block))
    check_range(views, noise)
    known = known_blocks(light_field, grid.camera, grid.block)
    valid = None if known is None else grid.pick(known)
    left_out = (*left_out, *check_unknown(valid))
    fit = PlaneFit(ProjectionOperator(grid), FrequencyGram(grid), options, valid)
    explain = Explainer(fit, grid, thickness)
    level = explain.level(views) if background == FIT else Level(0.0, 0.0)
    views = views - np.float32(level.mean) if level.mean else views
    found = explain(views)
    fitted = _Fitted(views, level, found, explain.seen(found.cells), valid)
    # Fit, correction and draws are light that leaves towards the camera, whose noise absorption
    # does not change; `Explainer.emission` turns it into emission.
    correction = fit.correct(found, max(1, few // 2))
    emission = explain.emission(found.cells + correction)
    drawn = _draw_again(fit, fitted, correction, bootstrap, rng)
    draws = np.array([explain.emission(cells) for cells in drawn], np.float32)
    result = Reconstruction(
        grid=grid,
        emission=emission,
        correction=explain.emission(correction),
        draws=draws.reshape(-1, *emission.shape),
        sigma_linear=explain.error_factor * fit.linear_errors(found),
        noise=found.noise,
        strength=found.strength,
        tried=found.tried,
        chi_squared=grid.place(fitted.chi_squared, np.nan),
        warnings=left_out,
        background=level.mean,
        background_sigma=level.error,
    )
    said = _disagreements(result, fitted, stated=noise is not None)
    result = replace(result, warnings=(*left_out, *said))
    if plain:
        return result
    done = iterate(method, explain.operator, views, valid, found.noise, iterations)
    cells = done.cells.reshape(grid.shape)
    fitted = fitted._replace(seen=explain.seen(cells))
    return replace(
        result,
        emission=explain.emission(cells),
        strength=0.0,
        tried=(),
        chi_squared=grid.place(fitted.chi_squared, np.nan),
        warnings=(*result.warnings, *done.warnings),
        iterations=done.iterations,
    )


class _Fitted(NamedTuple):
    """Views without background, and their fit.

    Attributes
    ----------
    views : ndarray of float32, shape (v, u, t, s)
        Views that were fitted, averaged over blocks.
    level : Level
        Background that was subtracted.
    found : Explanation
        Light that explains the views.
    seen : ndarray of float32, shape of `views`
        Views of that light.
    valid : ndarray of bool, shape of `views`, or None
        Whether each ray is known; None if all are.
    """

    views: np.ndarray
    level: Level
    found: Explanation
    seen: np.ndarray
    valid: np.ndarray | None

    @property
    def known(self) -> np.ndarray:
        """Views, with the light of the fit for unknown rays."""
        return self.views if self.valid is None else np.where(self.valid, self.views, self.seen)

    @property
    def residual(self) -> np.ndarray:
        """Part of the views that the fit does not explain."""
        return self.known - self.seen

    @property
    def chi_squared(self) -> np.ndarray:
        """Mean squared residual of each fitted view, in units of the noise's variance."""
        power = np.square(self.residual, dtype=np.float64).sum(axis=(2, 3))
        rays = np.prod(self.views.shape[2:]) if self.valid is None else self.valid.sum(axis=(2, 3))
        with np.errstate(invalid="ignore"):  # of a view of which nothing is known
            return power / rays / noise_variance(self.found.noise)


def _draw_again(
    fit: PlaneFit, fitted: _Fitted, correction: np.ndarray, count: int, rng: np.random.Generator
) -> Iterator[np.ndarray]:
    """Fit light fields with redrawn noise, each with a correction of its own (bootstrap)."""
    if not count:
        return
    found, few = fitted.found, max(1, fit.options.iterations // 4)
    expected = Expected(
        fit.smooth(found.cells + correction),
        found.pixel_noise,
        fitted.level.error,
        fit.prior(found, fitted.seen),
    )
    redrawn = redraw(fit.operator, fit.gram, expected, count, rng)
    for problem in progress.steps(redrawn, "error bars", count, "draw"):
        drawn = replace(found, cells=fit.again(problem, found, few))
        if not fit.options.penalty.corrects:
            yield drawn.cells
            continue
        # The correction of each draw is multiplied by any number from 0 to 2 with equal probability
        # (JCGM 100, 4.3.7), because the remaining error of the correction is unknown.
        yield drawn.cells + rng.uniform(0, 2) * fit.correct(drawn, few)


def _disagreements(result: Reconstruction, fitted: _Fitted, stated: bool) -> tuple[str, ...]:
    """Sentences on disagreements of data and model; `stated`: whether the user gave the noise."""
    found = fitted.found
    return (
        *check_data(
            fitted.known,
            result.chi_squared,
            found.noise,
            found.measured,
            stated,
            residual=fitted.residual,
        ),
        *check_spacing(result.grid),
        *(check_overlap(result.grid, result.emission) if len(result.draws) else ()),
        *(() if found.settled else (UNSETTLED,)),
    )


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
