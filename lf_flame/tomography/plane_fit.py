"""Fit of depth planes to a light field: noise, strength, foreground, and detail within cells."""

from dataclasses import dataclass, replace

import numpy as np

from lf_flame._common import progress
from lf_flame.errors import InputError
from lf_flame.tomography.cell_detail import SmoothStack
from lf_flame.tomography.error_bars import (
    Prior,
    draw_noise,
    noise_by_pixel,
    noise_variance,
    standard_errors,
)
from lf_flame.tomography.explanation import Explanation
from lf_flame.tomography.foreground import Fitting, brightest_noise, find_foreground
from lf_flame.tomography.noise_correlation import correlation_factor
from lf_flame.tomography.operators import Operators
from lf_flame.tomography.penalised_fit import Fit, RangeFit
from lf_flame.tomography.penalties import Penalty, Roughness, TotalVariation
from lf_flame.tomography.strength_search import (
    StrengthSearch,
    check_noise_and_strength,
)
from lf_flame.tomography.total_variation import STRENGTH, fit_total_variation

MOST_TURNS, FILLED = 40, 1e-3
"""Largest number of times that a fit replaces the light of unknown rays, and the largest change,
relative to the brightest ray, that ends this."""

SMOOTH, SEARCHES = 1.0, 6
"""Smallest strength with which unknown rays get their first light, and largest number of searches
for the strength, which depends on their light."""

BEYOND, PART = 1.8, 4
"""Factor, below 2, by which a change of unknown rays is exceeded, because rays that no other ray
crosses change slowly; and the part of the iterations that a repeated fit takes."""


@dataclass(frozen=True)
class FitOptions:
    """Options of `lf_flame.tomography.reconstruct` that all of its fits share.

    Raises
    ------
    InputError
        If noise or strength is negative, not finite or too large, or there is no iteration.
    """

    noise: float | None
    strength: float | None
    iterations: int
    penalty: Penalty

    def __post_init__(self) -> None:
        check_noise_and_strength(self.noise, self.strength)
        if self.iterations < 1:
            raise InputError(f"iterations must be 1 or more, got {self.iterations}.")


class PlaneFit:
    """Fits the depth planes of a grid to light fields in which light only adds.

    Parameters
    ----------
    operators : Operators
    options : FitOptions
    valid : ndarray of bool, shape (v, u, t, s), optional
        Whether each ray is known; others have weight 0. Default: all are.
    start : Explanation, optional
        Fit of a similar light field, from which the first fit starts, and takes its strength and
        all that it tells of noise but the level.
    """

    def __init__(
        self,
        operators: Operators,
        options: FitOptions,
        valid: np.ndarray | None = None,
        start: Explanation | None = None,
    ):
        self.operator, self.gram, self._operators = operators.projection, operators.gram, operators
        self.start = start
        # A strength that a similar light field has found is as good as one that is stated.
        self.options = replace(options, strength=start.strength) if start else options
        self.valid = None if valid is None or valid.all() else valid

    @property
    def smooth(self) -> SmoothStack:
        """Filtered focal stack of smooth functions through cells."""
        return self._operators.smooth

    def explain(self, views: np.ndarray, known: Explanation | None = None) -> Explanation:
        """Fit a light field; if a fit is given, with its strength and foreground, starting from it.

        Unknown rays have weight 0: they take the light that the fit gives them, and the fit is
        repeated, until they do not change (expectation maximisation: Dempster, Laird, Rubin, J. R.
        Stat. Soc. B 39, 1, 1977). The strength is searched for anew, until it stays.

        Parameters
        ----------
        views : ndarray of float32, shape (v, u, t, s)
        known : Explanation, optional
        """
        found = self._explain(views, known)
        if self.valid is None:
            return found
        # At first smoothly, as a weak penalty would keep the light that unknown rays hold.
        found = replace(found, strength=max(found.strength, SMOOTH))
        for _ in range(SEARCHES):
            before = found.strength
            views, _ = self._settle(views, found)
            found = self._explain(views, known)
            if found.strength == before:
                break
        return self._settle(views, found)[1]

    def _settle(self, views: np.ndarray, found: Explanation) -> tuple[np.ndarray, Explanation]:
        """Repeat a fit until the light of unknown rays, which it replaces, does not change."""
        few, valid = max(1, self.options.iterations // PART), self.valid is None or self.valid
        for _ in range(MOST_TURNS):
            seen = self.operator.matvec(found.cells.ravel()).reshape(views.shape)
            change = np.where(valid, 0, seen - views)
            views = views + np.float32(BEYOND) * change
            if float(np.abs(change).max()) <= FILLED * float(views.max()):
                break
            found = self._explain(views, found, few)
        return views, found

    def _explain(
        self, views: np.ndarray, known: Explanation | None, iterations: int | None = None
    ) -> Explanation:
        """Fit a light field of which all rays are known."""
        options = self.options
        with progress.stage("Preparing the fit"):
            problem = self._problem(views)
            measured = problem.measure_noise()
            uneven, shared = self._noise_of_pixels(problem, views, known)
        noise = measured if options.noise is None else float(options.noise)
        if known is not None:
            known = replace(known, noise=noise, measured=measured, uneven=uneven)
            return known.with_fit(self.again(problem, known, iterations or options.iterations))
        dark = np.zeros(self.gram.grid.shape, np.float32)
        strength = options.strength or 0.0
        draft = Explanation(dark, None, noise, measured, uneven, shared, strength, ())
        if isinstance(options.penalty, Roughness):
            return self._fit_smooth(problem, draft, options.penalty)
        strength = STRENGTH if options.strength is None else float(options.strength)
        draft = replace(draft, strength=strength)
        return draft.with_fit(self.again(problem, draft, 2 * options.iterations))

    def _fit_smooth(self, problem: RangeFit, draft: Explanation, penalty: Roughness) -> Explanation:
        """Choose the strength, fit, find the dark cells, and fit again."""
        options, share = self.options, self._noise_share(draft)
        few = min(options.iterations, max(40, options.iterations // 2))
        nonnegative = penalty.nonnegative
        variance = noise_variance(draft.summed_noise)
        search = StrengthSearch(problem, variance, share, nonnegative, few)
        if penalty.whole_curve:
            search.try_all()
        chosen = search.find() if options.strength is None else float(options.strength)
        tried = tuple(search.tried[key] for key in sorted(search.tried))
        half = options.iterations // 2
        nearest = self.start.state if self.start else search.nearest(chosen)
        first = problem.solve(chosen, nonnegative, half or 1, nearest)
        draft = replace(draft, strength=chosen, tried=tried).with_fit(first)
        if not nonnegative:
            return draft
        if penalty.dark_cells:
            draft = self._with_foreground(problem, draft, first, share)
        rest = options.iterations - half
        return draft.with_fit(self.again(problem, draft, rest)) if half else draft

    def again(self, problem: RangeFit, known: Explanation, iterations: int) -> Fit:
        """Solve another problem with the options of a fit, starting from its cells."""
        penalty = self.options.penalty
        if isinstance(penalty, TotalVariation):
            # The filtered noise of a cell is the sum of the noise of its views.
            weight = known.strength * known.summed_noise * np.sqrt(self.gram.scale)
            cells = fit_total_variation(problem, weight, iterations, known.cells)
            return Fit(cells, problem.misfit(cells))
        return problem.solve(
            known.strength,
            penalty.nonnegative,
            iterations,
            known.state,
            known.foreground,
        )

    def correct(self, known: Explanation, iterations: int) -> np.ndarray:
        """Estimate the error that a fit makes for a flame like the one it found, as a correction.

        The light field of a smooth function through the cells, without noise, is fitted in the same
        way. The difference between cells and second fit is the effect of penalty and constant cells
        (Tukey's twicing, Exploratory Data Analysis, 1977, here with a finer model).

        Returns
        -------
        ndarray of float32, shape (planes, rows, columns)
            Correction to add; it makes no cell negative. It is 0 if the penalty asks for none.
        """
        if not self.options.penalty.corrects:
            return np.zeros_like(known.cells)
        seen = RangeFit(self.gram, self.smooth(known.cells), 0.0, 0)
        again = self.again(seen, known, iterations).cells
        return np.maximum(known.cells - again, -known.cells)

    def prior(self, known: Explanation, seen: np.ndarray) -> Prior | None:
        """Prior on the emission that the penalty means; None for total variation.

        Parameters
        ----------
        known : Explanation
        seen : ndarray, shape (v, u, t, s)
            Light field of its cells.
        """
        penalty = self.options.penalty
        if isinstance(penalty, TotalVariation):
            return None
        return Prior(known.strength, known.lit_noise(seen))

    def linear_errors(self, known: Explanation) -> np.ndarray:
        """Estimate the errors of the unconstrained linear fit, as `Reconstruction.sigma_linear`.

        For total variation, which is not linear, it is that of the fit without a penalty.
        """
        penalty = self.options.penalty
        if isinstance(penalty, TotalVariation):
            return standard_errors(self.gram, known.summed_noise, 0.0)
        return standard_errors(self.gram, known.summed_noise, known.strength)

    def _problem(self, views: np.ndarray) -> RangeFit:
        stack = self.operator.rmatvec(views.ravel()).reshape(self.operator.dims)
        squared = float(np.sum(np.square(views, dtype=np.float64)))
        rays = views.size if self.valid is None else int(np.count_nonzero(self.valid))
        return RangeFit(self.gram, stack, squared, rays)

    def _correlation(self, problem: RangeFit, views: np.ndarray, uneven: np.ndarray) -> float:
        """Measure how much correlation raises the noise of sums."""
        grid = self.gram.grid

        def unexplained(problem: RangeFit, data: np.ndarray) -> np.ndarray:
            seen = self.operator.matvec(problem.unpenalised().ravel())
            return grid.place(data - seen.reshape(data.shape))

        def residuals() -> tuple[np.ndarray, np.ndarray]:
            white = np.random.default_rng(0).standard_normal(views.shape, np.float32)
            white *= np.sqrt(uneven)
            return unexplained(problem, views), unexplained(self._problem(white), white)

        counted = grid.place(np.ones(views.shape[:2], bool), False)
        variance = problem.measure_noise() ** 2
        return correlation_factor(grid.place(views), counted, variance, residuals)

    def _noise_of_pixels(
        self, problem: RangeFit, views: np.ndarray, known: Explanation | None
    ) -> tuple[np.ndarray, float]:
        """Relative variance of each pixel's noise, and the factor of correlation."""
        if self.start is not None:
            return self.start.uneven, self.start.shared
        uneven = noise_by_pixel(self.operator, views, problem.unpenalised())
        return uneven, known.shared if known else self._correlation(problem, views, uneven)

    def _noise_share(self, draft: Explanation) -> np.ndarray:
        """Fraction of the noise in each cell of a plane, shape (rows, columns)."""
        by_place = draft.uneven.mean(axis=(0, 1), dtype=np.float64)
        around = np.pad(by_place, self.gram.grid.reach, mode="edge")
        return around / around.sum()

    def _with_foreground(
        self,
        problem: RangeFit,
        draft: Explanation,
        first: Fit,
        share: np.ndarray,
    ) -> Explanation:
        """Find the cells that may emit; the draw of the noise always has the same seed."""
        fitting = Fitting(draft.strength, noise_variance(draft.summed_noise), share)
        if self.start is not None and self.start.strength == draft.strength:
            brightest = self.start.brightest
        else:
            stack = draw_noise(self.operator, draft.pixel_noise, np.random.default_rng(0))
            noise_alone = RangeFit(self.gram, stack, 0.0, 0)
            brightest = brightest_noise(noise_alone, fitting) / max(draft.summed_noise, 1e-30)
        draft = replace(draft, brightest=brightest)
        level = brightest * draft.summed_noise
        foreground, fit = find_foreground(problem, level, first, fitting)
        return replace(draft, foreground=foreground).with_fit(fit)
