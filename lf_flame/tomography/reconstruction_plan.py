"""Plan of a reconstruction: what does not depend on the light field is made once."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.tomography.absorption import Absorption, spread_thickness
from lf_flame.tomography.background import Level
from lf_flame.tomography.data_checks import check_range, check_unknown
from lf_flame.tomography.error_bars import check_bootstrap
from lf_flame.tomography.explainer import Explainer, Fitted, draw_again
from lf_flame.tomography.explanation import Explanation
from lf_flame.tomography.fitted_views import average_blocks, fitted_views, known_blocks
from lf_flame.tomography.frustum_grid import FrustumGrid
from lf_flame.tomography.iterative_methods import (
    MOST,
    PENALISED,
    check_bars,
    check_method,
    iterate,
)
from lf_flame.tomography.operators import Operators
from lf_flame.tomography.penalties import ROUGHNESS, Penalty, Roughness, as_penalty
from lf_flame.tomography.plane_fit import FitOptions, PlaneFit
from lf_flame.tomography.reconstruction_result import Reconstruction

ITERATIONS = 80
"""Largest number of iterations of the splitting for the solution, in two fits. Each strength that
is tried, and each draw, takes at most half, starting from the nearest solution."""

FIT = "fit"
"""Value of `background` with which a background is fitted."""


class ReconstructionPlan:
    """Everything of `reconstruct` that does not depend on the light field, for videos.

    Parameters
    ----------
    grid : FrustumGrid
        Depth planes and cells.
    noise, strength, iterations, optical_thickness, penalty, background, method
        As for `reconstruct`.

    Raises
    ------
    InputError
        If a value cannot be used.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from lf_flame import PAPER_CAMERA, render
    >>> from lf_flame.scenes.flames import flame_texture
    >>> from lf_flame.tomography import FrustumGrid, ReconstructionPlan
    >>> camera = replace(PAPER_CAMERA, views=5, lenslets=(32, 40))
    >>> plan = ReconstructionPlan(FrustumGrid(camera, [6.0, -6.0]))

    >>> from lf_flame import Layer, Scene
    >>> last = None
    >>> for height in (2.0, 2.2):
    ...     flame = Layer(flame_texture(height, 0.3, cell_mm=0.05), 6.0, (height, 1.92))
    ...     last = plan.reconstruct(render(Scene([flame]), camera), start=last)
    >>> last.emission.shape
    (2, 32, 40)
    """

    def __init__(
        self,
        grid: FrustumGrid,
        *,
        noise: float | None = None,
        strength: float | None = None,
        iterations: int | None = None,
        optical_thickness: ArrayLike | None = None,
        penalty: str | Penalty = ROUGHNESS,
        background: str | None = None,
        method: str = PENALISED,
    ):
        check_method(method, strength, penalty != ROUGHNESS)
        if background not in (None, FIT):
            raise InputError(f"background must be None or {FIT!r}, got {background!r}.")
        self.grid, self._background = grid, background
        self._method, self._most = method, MOST if iterations is None else iterations
        few = ITERATIONS if iterations is None else iterations
        if method != PENALISED:
            # Other methods take noise, background and warnings from a fit that is linear, which is
            # quick, unless a background is measured where no light is found.
            penalty = Roughness(nonnegative=background == FIT, corrected=False)
            few = min(few, ITERATIONS)
        self._options = FitOptions(noise, strength, few, as_penalty(penalty))
        self._thickness = _spread(grid, optical_thickness)
        self.operators = Operators(grid)
        self._absorption: Absorption | None = None

    def absorbing(
        self, optical_thickness: ArrayLike | None, *, strength: float | None = None
    ) -> ReconstructionPlan:
        """Plan with the same operators and options, and another optical thickness.

        Parameters
        ----------
        optical_thickness : float, array_like or None
            As for `reconstruct`.
        strength : float, optional
            As for `reconstruct`. Default: as in this plan.

        Raises
        ------
        InputError
            If a shape or a value cannot be used.
        """
        plan = copy.copy(self)
        if strength is not None:
            plan._options = replace(self._options, strength=strength)
        plan._thickness, plan._absorption = _spread(self.grid, optical_thickness), None
        return plan

    def reconstruct(
        self,
        light_field: LightField,
        *,
        start: Reconstruction | None = None,
        bootstrap: int = 0,
        rng: int | np.random.Generator | None = 0,
        prior_rng: np.random.Generator | None = None,
    ) -> Reconstruction:
        """Find the emission that explains a light field.

        Parameters
        ----------
        light_field : LightField
            As for `reconstruct`.
        start : Reconstruction, optional
            Result of the frame before. The fit starts from it, and takes from it the strength, and
            how noise depends on pixel and brightness, and is correlated. Default: the light field
            alone decides.
        bootstrap, rng
            As for `reconstruct`.
        prior_rng : numpy.random.Generator, optional
            Generator of the bootstrap's prior and multiples of the correction. Colours of one flame
            share it, each with a new one of the same seed: penalty and cells act on all colours
            alike, and the ratio of two does not feel it. Default: `rng`.

        Returns
        -------
        Reconstruction

        Raises
        ------
        InputError
            If the light field does not match the grid, or `start` is of another grid.
        """
        check_bootstrap(bootstrap)
        check_bars(self._method, bootstrap)
        rng = np.random.default_rng(rng)
        grid, views, valid, left_out = self._pick(light_field)
        self._keep(grid)
        first = None if start is None else _checked_start(start, grid)
        fit = PlaneFit(self.operators, self._options, valid, first)
        explain = Explainer(fit, self._absorption)
        level = explain.level(views) if self._background == FIT else Level(0.0, 0.0)
        views = views - np.float32(level.mean) if level.mean else views
        found = explain(views)
        fitted = Fitted(views, level, found, explain.seen(found.cells), valid)
        # Fit, correction and draws are light that leaves towards the camera, whose noise absorption
        # does not change; `Explainer.emission` turns it into emission.
        correction = fit.correct(found, max(1, self._options.iterations // 2))
        emission = explain.emission(found.cells + correction)
        drawn = draw_again(fit, fitted, correction, bootstrap, rng, prior_rng or rng)
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
            fit=found,
        )
        said = fitted.disagreements(
            result, stated=self._options.noise is not None, even=self._background == FIT
        )
        result = replace(result, warnings=(*left_out, *said))
        return result if self._method == PENALISED else self._iterated(result, fitted, explain)

    def _pick(
        self, light_field: LightField
    ) -> tuple[FrustumGrid, np.ndarray, np.ndarray | None, tuple[str, ...]]:
        """Pick the views that count: their grid, light, known rays, and what to say of others."""
        light_field = self.grid.camera.corrected(light_field)
        grid, left_out = fitted_views(light_field, self.grid)
        views = grid.pick(average_blocks(light_field, grid.camera, grid.block))
        check_range(views, self._options.noise)
        known = known_blocks(light_field, grid.camera, grid.block)
        valid = None if known is None else grid.pick(known)
        return grid, views, valid, (*left_out, *check_unknown(valid))

    def _iterated(
        self, result: Reconstruction, fitted: Fitted, explain: Explainer
    ) -> Reconstruction:
        """Find the emission by another method, with what a fit tells of noise and background."""
        done = iterate(
            self._method, explain.operator, fitted.views, fitted.valid, result.noise, self._most
        )
        cells = done.cells.reshape(result.grid.shape)
        seen = fitted._replace(seen=explain.seen(cells))
        return replace(
            result,
            emission=explain.emission(cells),
            strength=0.0,
            tried=(),
            chi_squared=result.grid.place(seen.chi_squared, np.nan),
            warnings=(*result.warnings, *done.warnings),
            iterations=done.iterations,
        )

    def _keep(self, grid: FrustumGrid) -> None:
        """Keep the operators of the views that count, made anew where others count."""
        if not grid.matches(self.operators.grid):
            self.operators, self._absorption = Operators(grid), None
        if self._absorption is None and self._thickness is not None and self._thickness.any():
            self._absorption = Absorption(self.operators.projection, grid, self._thickness)


def _spread(grid: FrustumGrid, optical_thickness: ArrayLike | None) -> np.ndarray | None:
    return None if optical_thickness is None else spread_thickness(grid, optical_thickness)


def _checked_start(start: Reconstruction, grid: FrustumGrid) -> Explanation:
    """Fit from which to start; refused if it is of another grid."""
    if not grid.matches(start.grid):
        raise InputError(
            f"start must be a reconstruction on the plan's grid with the same views, got one of "
            f"{start.grid.view_count} views at the depths {list(start.grid.depths_mm)}."
        )
    return start.fit
