"""Fit of one half section to views: their noise, the strength of the penalty, solution, draws."""

from typing import NamedTuple

import numpy as np

from lf_flame.tomography.axisymmetric.fit import AxisymmetricFit, BandedGram, SolveOptions
from lf_flame.tomography.axisymmetric.grid import AxisymmetricGrid
from lf_flame.tomography.axisymmetric.operator import AxisymmetricOperator
from lf_flame.tomography.axisymmetric.roundness import DepthRatio
from lf_flame.tomography.error_bars import noise_by_pixel, noise_variance
from lf_flame.tomography.noise_correlation import correlation_factor
from lf_flame.tomography.strength_search import StrengthSearch

MODEL_ERROR = 1e-3
"""Noise relative to the brightest pixel below which not the noise but the grid limits a fit."""

ITERATIONS = 200
"""Number of iterations of the splitting (ADMM) for the solution; a quarter of it for each strength
that is tried and for each draw."""


class Section(NamedTuple):
    """Half section that explains views.

    Attributes
    ----------
    cells : ndarray of float64, shape (1, heights, radii)
        Emission of the nodes.
    options : SolveOptions
        Options with which it was found, with the strength of the penalty.
    residual : ndarray, shape (v, u, t, s)
        Views minus those of the section.
    """

    cells: np.ndarray
    options: SolveOptions
    residual: np.ndarray


class SectionFit:
    """Fits half sections of a grid to its views.

    Parameters
    ----------
    grid : AxisymmetricGrid
    views : ndarray of float32, shape (v, u, t, s)
        Views that the grid uses, in its pixels.
    noise : float or None
        Standard deviation of a pixel's noise; None to measure it.
    rng : numpy.random.Generator
        Generator of the vectors that estimate degrees of freedom.

    Attributes
    ----------
    noise, measured : float
        Standard deviation of a pixel's noise: as used, and as measured.
    pixel_noise : ndarray, shape of `views`
        Standard deviation of each pixel's noise.
    correlation : float
        Factor by which correlation raises the noise of sums of pixels.
    """

    def __init__(
        self,
        grid: AxisymmetricGrid,
        views: np.ndarray,
        noise: float | None,
        rng: np.random.Generator,
    ):
        self.views = views
        self._operator = AxisymmetricOperator(grid)
        squared = float(np.sum(np.square(views, dtype=np.float64)))
        back = self._backproject(views.astype(float))
        self._problem = AxisymmetricFit(BandedGram(grid), back, squared, views.size, rng)
        self.measured = self._problem.measure_noise()
        self.noise = self.measured if noise is None else float(noise)
        plain = self._problem.unpenalised()
        uneven = noise_by_pixel(self._operator, views, plain)
        counted = grid.place(np.ones(views.shape[:2], bool), False)

        # A half section has far fewer nodes than there are rays, so what is left of noise is white.
        def residuals() -> tuple[np.ndarray, None]:
            return grid.place(views - self._project(plain)), None

        self.correlation = correlation_factor(
            grid.place(views), counted, self.measured**2, residuals
        )
        self.pixel_noise = self.noise * np.sqrt(uneven)
        # With photon noise, bright nodes see more noise than the mean pixel.
        seen = self._backproject(np.broadcast_to(uneven, views.shape))
        self._noise_by_node = seen / np.maximum(self._backproject(np.ones(views.shape)), 1e-300)

    def solve(self, strength: float | None) -> Section:
        """Find the half section, with the stated strength or that of least expected error."""
        by_node = self._noise_by_node
        limited = max(self.noise, MODEL_ERROR * float(self.views.max()))
        variance = noise_variance(self.correlation * limited) * float(by_node.mean())
        share = by_node / by_node.sum()
        search = StrengthSearch(self._problem, variance, share, True, ITERATIONS // 4)
        chosen = search.find_by_risk() if strength is None else float(strength)
        options = SolveOptions(chosen, True, ITERATIONS)
        cells = self._problem.solve(*options, search.nearest(chosen)).cells
        return Section(cells, options, self.views - self._project(cells))

    def solve_for(self, views: np.ndarray, section: Section) -> np.ndarray:
        """Fit other views with the strength of a known section, from which it starts.

        Returns
        -------
        ndarray of float64, shape (1, heights, radii)
        """
        options = section.options._replace(iterations=ITERATIONS // 4)
        return self._problem.solve_for(self._backproject(views), options, section.cells)

    def draw(
        self,
        section: Section,
        count: int,
        rng: np.random.Generator,
        of_prior: np.random.Generator | None = None,
    ) -> np.ndarray:
        """Draw sections that views and penalty allow, float32, shape (count, heights, radii).

        The penalty's effect is alike in all colours of a flame: their fits draw it, `of_prior`,
        from generators of one seed. Default: from `rng`.
        """
        options = section.options._replace(iterations=ITERATIONS // 4)
        prior_noise = self._prior_noise(section)
        of_prior = rng if of_prior is None else of_prior
        draws = []
        for _ in range(count):
            noise = self.correlation * self.pixel_noise * rng.standard_normal(self.views.shape)
            back = self._backproject(noise)
            draws.append(self._problem.draw(back, prior_noise, options, section.cells, of_prior))
        return np.array(draws, np.float32).reshape(-1, *self._operator.grid.shape)

    def _prior_noise(self, section: Section) -> float:
        """Noise of the prior: that inside the flame, for which the strength was chosen."""
        light = max(float(np.sum(section.cells)), 1e-300)
        lit = float(np.sum(self._noise_by_node * section.cells[0])) / light
        return self.correlation * self.noise * float(np.sqrt(lit))

    def depth_ratio(self, section: Section) -> DepthRatio:
        """Extent in depth relative to that across, from what no section explains."""
        rest = self.views - self._project(self._problem.unpenalised())
        noise = self.correlation * self.pixel_noise
        return DepthRatio(self._operator, self._problem, section.cells[0], rest, noise)

    def _project(self, cells: np.ndarray) -> np.ndarray:
        return self._operator.matvec(cells.ravel()).reshape(self.views.shape)

    def _backproject(self, views: np.ndarray) -> np.ndarray:
        return self._operator.rmatvec(views.ravel()).reshape(self._operator.grid.shape)
