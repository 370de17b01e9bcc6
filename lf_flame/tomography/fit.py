"""One fit on two geometries: noise, strength of the penalty, solution, correction, and redraws.

The unknown is light at cells of depth planes, or at nodes of an axisymmetric half section; a
`Geometry` has their operators. The fit is least squares with a penalty on third differences
and no negative light. Noise is what no emission explains.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import ndimage

from lf_flame._common import progress
from lf_flame.errors import InputError
from lf_flame.tomography.geometries import Geometry, PlaneGeometry, backproject, project
from lf_flame.tomography.noise import correlation_factor, noise_by_pixel, noise_variance
from lf_flame.tomography.plane_problem import Solution
from lf_flame.tomography.strength_search import StrengthSearch

MOST = 1e30
"""Largest noise and strength: far above any use, and their products are float64 numbers."""

MOST_TURNS, FILLED = 40, 1e-3
"""Largest number of times that a fit replaces the light of unknown rays, and the largest change,
relative to the brightest ray, that ends this."""

SMOOTH, SEARCHES = 1.0, 6
"""Smallest strength with which unknown rays get their first light, and largest number of searches
for the strength, which depends on their light."""

BEYOND, PART = 1.8, 4
"""Factor, below 2, by which a change of unknown rays is exceeded, because rays that no other ray
crosses change slowly; and the part of the iterations that a repeated fit takes."""

WEAK = 1e-5
"""Strength of the penalty with which the error of straight lines between nodes is estimated."""

DARKER = (3.0, 1.5, 0.75)
"""Thresholds, as multiples of the largest value that noise alone produces; a cell below is dark.
They are tried in turn. Larger ones lose dim light of phantoms; smaller ones gain little."""

NEIGHBOURS = np.ones((1, 3, 3))
"""Neighbourhood over which cells are averaged, and by which the foreground is widened."""

TRIAL = 40
"""Number of iterations of a trial of a threshold; it starts from a fit."""


@dataclass(frozen=True)
class FitOptions:
    """Options that all fits of a reconstruction share; None is to be found."""

    noise: float | None = None
    strength: float | None = None

    def __post_init__(self) -> None:
        for name, value in (("noise", self.noise), ("strength", self.strength)):
            if value is not None and not 0 < value <= MOST:
                raise InputError(
                    f"{name} must be above 0, at most {MOST:g}, got {value}; leave it out to have "
                    f"it {'measured' if name == 'noise' else 'chosen'}."
                )


def check_bootstrap(bootstrap: int) -> None:
    """Refuse a number of bootstrap draws that gives no scatter."""
    if bootstrap < 0 or bootstrap == 1:
        raise InputError(f"bootstrap must be 0, or 2 or more, got {bootstrap}.")


@dataclass(frozen=True, eq=False)
class Explanation:
    """Light that explains a light field, with the noise and the strength by which it was found.

    cells : light that leaves each cell; `state` : that from which a similar fit starts
    foreground : cells that may emit, or None if all may; `brightest` : largest light that noise
        alone makes there, relative to `summed_noise`
    noise, measured : standard deviation of a pixel's noise, as used and as measured
    uneven : variance of each pixel's noise relative to its mean, float32, shape (v, u, t, s)
    shared : factor by which correlation raises the noise of sums of pixels
    strength : strength of the regularisation
    settled : whether the correction for absorption converged
    """

    cells: np.ndarray
    state: np.ndarray | None
    foreground: np.ndarray | None
    noise: float
    measured: float
    uneven: np.ndarray
    shared: float
    strength: float
    settled: bool = True
    brightest: float = 0.0

    def solved(self, solution: Solution) -> "Explanation":
        """Take the cells of another solution."""
        return replace(self, cells=solution.cells, state=solution.state)

    @property
    def summed_noise(self) -> float:
        """Standard deviation of a pixel with independent noise, whose sums have the same noise."""
        return self.noise * self.shared

    @property
    def pixel_noise(self) -> np.ndarray:
        """The same of each pixel, float32, shape (v, u, t, s)."""
        return np.float32(self.summed_noise) * np.sqrt(self.uneven)

    def lit_noise(self, seen: np.ndarray) -> float:
        """Find that standard deviation, weighted by the light of `seen`."""
        light = max(float(np.sum(seen, dtype=np.float64)), 1e-30)
        lit = float(np.sum(self.uneven * seen, dtype=np.float64)) / light
        return self.summed_noise * float(np.sqrt(max(lit, 0.0)))


class Fit:
    """Fits of a geometry to light fields in which light only adds; unknown rays have weight 0.

    With `start`, the fit of a similar light field, the first fit starts there, and takes its
    strength and all that it knows of noise but the level.
    """

    def __init__(
        self,
        geometry: Geometry,
        options: FitOptions,
        valid: np.ndarray | None = None,
        start: Explanation | None = None,
    ):
        self.geometry, self.operator, self.start = geometry, geometry.operator, start
        # A strength that a similar light field has found is as good as one that is stated.
        self.options = replace(options, strength=start.strength) if start else options
        self.iterations = geometry.iterations
        self.on_planes = isinstance(geometry, PlaneGeometry)
        self.few = self.iterations // (2 if self.on_planes else 4)
        self.valid = None if valid is None or valid.all() else valid

    def explain(self, views: np.ndarray, known: Explanation | None = None) -> Explanation:
        """Fit a light field; if a fit is given, with its strength and foreground, starting from it.

        Unknown rays have weight 0: they take the light that the fit gives them, and the fit is
        repeated, until they do not change (expectation maximisation: Dempster, Laird, Rubin, J. R.
        Stat. Soc. B 39, 1, 1977). The strength is searched for again, until it no longer changes.
        """
        found = self._explain(views, known)
        if self.valid is None:
            return found
        # At first smoothly, as a weak penalty would keep the stored light of unknown rays.
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
        few, valid = self.iterations // PART, self.valid is None or self.valid
        for _ in range(MOST_TURNS):
            change = np.where(valid, 0, project(self.operator, found.cells) - views)
            change = change.astype(np.float32)
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
            measured = self._measure_noise(problem)
            if self.start is not None:
                uneven, shared = self.start.uneven, self.start.shared
            else:
                seen = project(self.operator, problem.unpenalised())
                uneven = noise_by_pixel(views, seen, self.valid is None or self.valid)
                shared = known.shared if known else self._correlation(problem, views, uneven)
        noise = measured if options.noise is None else float(options.noise)
        if known is not None:
            known = replace(known, noise=noise, measured=measured, uneven=uneven)
            iterations = iterations or (self.iterations if self.on_planes else self.few)
            return known.solved(self.again(problem, known, iterations))
        dark = np.zeros(self.operator.dims, self.operator.dtype)
        draft = Explanation(dark, None, None, noise, measured, uneven, shared, 0.0)
        return self._solve(problem, draft, float(views.max()))

    def _solve(self, problem, draft: Explanation, peak: float) -> Explanation:
        """Choose the strength and fit; on planes find the dark cells, and fit again."""
        by_cell = self.geometry.noise_by_cell(draft.uneven)
        count = len(draft.cells) if self.on_planes else 1
        share = by_cell / by_cell.sum() / count
        limited = max(draft.noise, self.geometry.model_error * peak) * draft.shared
        variance = noise_variance(limited) * (1.0 if self.on_planes else float(by_cell.mean()))
        search = StrengthSearch(problem, variance, share, self.few)
        strength = self.options.strength
        if strength is None:
            strength = search.find() if self.on_planes else search.find_by_risk()
        strength = float(strength)
        first = self.iterations // 2 if self.on_planes else self.iterations
        nearest = self.start.state if self.start else search.nearest(strength)
        draft = replace(draft, strength=strength)
        draft = draft.solved(problem.solve(strength, first, nearest))
        if not self.on_planes:
            return draft
        draft = self._with_foreground(problem, draft, share, variance)
        return draft.solved(self.again(problem, draft, self.iterations - first))

    def again(self, problem, known: Explanation, iterations: int) -> Solution:
        """Solve another problem with the strength and foreground of a fit, starting from it."""
        return problem.solve(known.strength, iterations, known.state, known.foreground)

    def correct(self, known: Explanation) -> np.ndarray:
        """Estimate the error that a fit makes for a flame like the one it found, as a correction.

        The light field of a smooth flame through the cells, without noise, is fitted in the same
        way. The difference between cells and second fit is the effect of penalty and of emission
        that is constant over cells, or linear between nodes (Tukey's twicing, Exploratory Data
        Analysis, 1977, here with a finer model). The correction makes no cell negative.
        """
        back = backproject(self.operator, self.geometry.smooth_views(known.cells))
        seen: Any = self.geometry.problem(back)
        if self.on_planes:
            again = self.again(seen, known, self.few).cells
        else:
            # The draws of the prior include the penalty's effect. Little is seen of the two rows
            # next to the field's edges and the burner.
            again = known.cells.copy()
            again[2:-2] = seen.linear(WEAK)[2:-2]
        return np.maximum(known.cells - again, -known.cells)

    def redraw(
        self,
        known: Explanation,
        views: np.ndarray,
        correction: np.ndarray,
        level_error: float,
        count: int,
        rng: np.random.Generator,
        prior_rng: np.random.Generator,
    ) -> Iterator[np.ndarray]:
        """Redraw the noise of a light field and the prior that its penalty means, and fit again.

        The penalty is a prior on differences of neighbouring cells. Noise of its scale is therefore
        added to the desired values of these differences. The scatter of the fits then includes the
        effect of the penalty on a flame (Bardsley and others, SIAM J. Sci. Comput. 36, A1895,
        2014).

        On planes the light field is that of the emission that was found, and the correction of each
        draw is multiplied by any number from 0 to 2 with equal probability (JCGM 100, 4.3.7),
        because its remaining error is unknown. In a half section the light field is that which was
        measured, and draws differ from the emission as their values at the nodes do.
        `level_error` is the standard deviation of a uniform background that was subtracted;
        `prior_rng` draws the prior and the multiples of the correction.
        """
        if not count:
            return
        geometry, dtype = self.geometry, self.operator.dtype
        emission = known.cells + correction
        expected = geometry.smooth_views(emission) if self.on_planes else views
        if not self.on_planes and self.valid is not None:
            # Unknown rays have the light that the fit gave them, as they had in it.
            expected = np.where(self.valid, views, project(self.operator, known.cells))
        expected = backproject(self.operator, expected)
        prior_noise = known.lit_noise(project(self.operator, known.cells))
        sd = known.pixel_noise
        even = backproject(self.operator, np.ones_like(sd)) if level_error else 0.0
        for _ in progress.steps(range(count), "error bars", count, "draw"):
            noise = sd * rng.standard_normal(sd.shape, dtype=np.float32)
            back = expected + backproject(self.operator, noise)
            if level_error:
                back = back + dtype.type(level_error * rng.standard_normal()) * even
            drawn = geometry.gram.draw_penalty(known.strength, prior_rng)
            back = back + dtype.type(prior_noise) * drawn
            fit = known.solved(self.again(geometry.problem(back), known, self.few))
            if self.on_planes:
                yield fit.cells + dtype.type(prior_rng.uniform(0, 2)) * self.correct(fit)
            else:
                yield emission + values_at_nodes(fit.cells - known.cells)

    def _problem(self, views: np.ndarray):
        squared = float(np.sum(np.square(views, dtype=np.float64)))
        rays = views.size if self.valid is None else int(np.count_nonzero(self.valid))
        return self.geometry.problem(backproject(self.operator, views), squared, rays)

    def _measure_noise(self, problem) -> float:
        """Measure the standard deviation per pixel of the part that no emission explains.

        Too few rays can all be explained; the noise is then that which was stated.
        """
        free = problem.rays - problem.gram.modes
        if free > 0:
            return float(np.sqrt(max(problem.squared - problem.explained, 0.0) / free))
        if self.options.noise is None:
            raise InputError(
                f"Noise can be measured only if more rays are known than the "
                f"{problem.gram.modes:.0f} degrees of freedom of the emission, got {problem.rays}: "
                f"state the noise."
            )
        return float(self.options.noise)

    def _correlation(self, problem, views: np.ndarray, uneven: np.ndarray) -> float:
        """Measure how much correlation raises the noise of sums."""
        grid = self.geometry.grid

        def unexplained(problem, data: np.ndarray) -> np.ndarray:
            return grid.place(data - project(self.operator, problem.unpenalised()))

        def residuals() -> tuple[np.ndarray, np.ndarray | None]:
            if not self.on_planes:
                # A half section has far fewer nodes than there are rays: the residual is white.
                return unexplained(problem, views), None
            white = np.random.default_rng(0).standard_normal(views.shape, np.float32)
            white *= np.sqrt(uneven)
            return unexplained(problem, views), unexplained(self._problem(white), white)

        used_views = grid.place(np.ones(views.shape[:2], bool), False)
        variance = self._measure_noise(problem) ** 2
        return correlation_factor(grid.place(views), used_views, variance, residuals)

    def _with_foreground(
        self, problem, draft: Explanation, share: np.ndarray, variance: float
    ) -> Explanation:
        """Find the cells of planes that may emit light.

        A fit without negative light turns noise into faint light in dark cells, and takes that
        light from bright cells at other depths of the same point: with four depth planes at 5 % of
        noise, one per cent of the peak. Light that is little brighter than noise alone would make
        it is therefore set to 0, and the rest is fitted again. A trial is kept if it lowers the
        expected error of the noise-free light field (Mallows, Technometrics 15, 661, 1973): the
        misfit must grow by less than twice the number of degrees of freedom that are given up.
        """
        if self.start is not None and self.start.strength == draft.strength:
            brightest = self.start.brightest
        else:
            # The draw always has the same seed. Long steps are for light behind other light, which
            # noise does not contain.
            noise = np.random.default_rng(0).standard_normal(draft.uneven.shape, dtype=np.float32)
            alone: Any = self.geometry.problem(
                backproject(self.operator, draft.pixel_noise * noise)
            )
            cells = alone.solve(draft.strength, TRIAL, long=0.0).cells
            brightest = float(ndimage.uniform_filter(cells, NEIGHBOURS.shape).max())
            brightest /= max(draft.summed_noise, 1e-30)

        modes = problem.gram.count_modes(draft.strength)

        def risk(solution: Solution) -> float:
            glowing = float(np.sum((solution.cells > 0) * share))
            return solution.misfit / variance + 2 * glowing * modes

        draft = replace(draft, brightest=brightest)
        together = ndimage.uniform_filter(draft.cells, NEIGHBOURS.shape)
        before = risk(Solution(draft.cells, problem.misfit(draft.cells), draft.cells))
        for factor in DARKER:
            lit = together > factor * brightest * draft.summed_noise
            foreground = ndimage.binary_dilation(lit, NEIGHBOURS)
            trial = problem.solve(draft.strength, TRIAL, draft.state, foreground)
            if risk(trial) < before:
                return replace(draft, foreground=foreground).solved(trial)
        return draft


def values_at_nodes(fitted: np.ndarray) -> np.ndarray:
    """Correct a piecewise-linear fit of a smooth flame for its curvature, at the nodes.

    The straight lines with the least squared distance from a smooth function f miss it at the nodes
    by ``-step^2 f'' / 12`` along each axis. Along height nothing is added to the two rows next to
    the field's edges and the burner, of which little is seen.
    """
    curved = np.zeros_like(fitted)
    curved[2:-2] = np.diff(fitted[1:-1], 2, axis=0)
    beyond = np.zeros_like(fitted[:, :1])  # no emission
    mirrored = np.concatenate([fitted[:, 1:2], fitted, beyond], axis=1)
    return fitted + (curved + np.diff(mirrored, 2, axis=1)) / 12
