"""Least-squares fit of a half section, with regularisation (roughness) and no negative light."""

from functools import cached_property
from typing import NamedTuple

import numpy as np
from pyproximal import Box, ProxOperator
from pyproximal.optimization.primal import ADMM
from scipy import linalg, sparse
from scipy.linalg.blas import dsbmv

from lf_flame.tomography.axisymmetric.grid import AxisymmetricGrid
from lf_flame.tomography.axisymmetric.operator import gram_bands
from lf_flame.tomography.frequency_gram import RIDGE
from lf_flame.tomography.penalised_fit import Fit
from lf_flame.tomography.penalties import ROUGHNESS_ORDER

STEP = 10.0
"""Step of the splitting (ADMM), for a Gram matrix with its diagonal scaled to 1."""

PROBES = 32
"""Number of random vectors that estimate traces (Hutchinson 1990): 1 % error for 1,000."""


class SolveOptions(NamedTuple):
    """Options of one fit.

    Attributes
    ----------
    strength : float
        Strength of the penalty.
    nonnegative : bool
        Whether emission is kept at 0 or above; if not, the fit is linear, and takes one step.
    iterations : int
        Number of iterations of the splitting.
    """

    strength: float
    nonnegative: bool
    iterations: int


class BandedGram:
    """Gram matrix of a half section, scaled to a diagonal of 1, and the penalty.

    Nodes near the axis are seen little; with the scaling, all nodes take steps of similar size.

    Parameters
    ----------
    grid : AxisymmetricGrid

    Attributes
    ----------
    grid : AxisymmetricGrid
    unit : ndarray of float64, shape (nodes,)
        Emission of a node for a scaled value of 1.
    bands : ndarray of float64, shape (band, nodes)
        Lower diagonals of the scaled matrix.
    """

    def __init__(self, grid: AxisymmetricGrid):
        self.grid = grid
        bands = gram_bands(grid)
        diagonal = np.maximum(bands[0], 1e-9 * bands[0].max())
        self.unit = 1 / np.sqrt(diagonal)
        self.typical = float(np.mean(diagonal))
        self.bands = _scale(bands, self.unit)

    def multiply(self, scaled: np.ndarray) -> np.ndarray:
        """Multiply by the scaled matrix."""
        return dsbmv(len(self.bands) - 1, 1.0, self.bands, scaled, lower=1)

    @cached_property
    def _unit_penalty(self) -> np.ndarray:
        """Lower diagonals of the scaled penalty of strength 1, shape (band, nodes)."""
        rough = roughness_matrix(self.grid.shape)
        lower = sparse.tril(rough).tocoo()
        bands = np.zeros((int((lower.row - lower.col).max()) + 1, rough.shape[0]))
        bands[lower.row - lower.col, lower.col] = lower.data
        return _scale(self.typical * bands, self.unit)

    def draw_penalty(self, strength: float, rng: np.random.Generator) -> np.ndarray:
        """Draw a random vector with the scaled penalty as covariance; float64, shape (nodes,)."""
        differences = roughness_differences(self.grid.shape)
        drawn = differences.T @ rng.standard_normal(differences.shape[0])
        return np.sqrt(strength * self.typical) * drawn * self.unit

    def factor(self, add: float, strength: float | None = None) -> np.ndarray:
        """Factor the scaled matrix plus penalty, if any, plus `add` times the identity.

        The form is that of `scipy.linalg.cho_solve_banded`; the step of the splitting is 1 / `add`.
        """
        penalty = self.bands[:0] if strength is None else strength * self._unit_penalty
        total = np.zeros((max(len(self.bands), len(penalty)), self.bands.shape[1]))
        total[: len(self.bands)] += self.bands
        total[: len(penalty)] += penalty
        total[0] += add
        return linalg.cholesky_banded(total, lower=True, check_finite=False)


def roughness_matrix(shape: tuple[int, int]) -> sparse.csr_array:
    """Matrix of squared differences along height and radius; the section is mirrored at its axis.

    Beyond the last radius there is no light.

    Returns
    -------
    scipy.sparse.csr_array of float64, shape (nodes, nodes)
    """
    differences = roughness_differences(shape)
    return (differences.T @ differences).tocsr()


def roughness_differences(shape: tuple[int, int]) -> sparse.csr_array:
    """Differences for `roughness_matrix`: along height first, then along radius.

    Returns
    -------
    scipy.sparse.csr_array of float64, shape (differences, nodes)
    """
    heights, radii = shape
    along = np.diff(np.eye(heights), ROUGHNESS_ORDER, axis=0)
    mirrored = np.zeros((2 * radii - 1 + ROUGHNESS_ORDER, radii))
    place = np.arange(2 * radii - 1)
    mirrored[place, np.abs(place - (radii - 1))] = 1
    across = np.diff(mirrored, ROUGHNESS_ORDER, axis=0) / np.sqrt(
        2
    )  # each side of the axis counts half
    down = sparse.kron(sparse.csr_array(along), sparse.eye_array(radii))
    return sparse.vstack([down, sparse.kron(sparse.eye_array(heights), across)], format="csr")


def _scale(bands: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """Multiply lower diagonals from both sides by a diagonal matrix."""
    out = np.zeros_like(bands)
    for below in range(len(bands)):
        end = len(unit) - below
        out[below, :end] = bands[below, :end] * unit[below:] * unit[:end]
    return out


class _Quadratic(ProxOperator):
    """The quadratic ``x'Hx / 2 - b'x`` and its proximal operator."""

    def __init__(self, factor: np.ndarray, linear: np.ndarray):
        super().__init__(None, False)
        self._factor, self._linear = factor, linear

    def __call__(self, x: np.ndarray) -> float:
        return 0.0  # not used: the number of iterations is fixed

    def prox(self, x: np.ndarray, tau: float) -> np.ndarray:
        return linalg.cho_solve_banded(
            (self._factor, True), self._linear + x / tau, check_finite=False
        )


class AxisymmetricFit:
    """Fits of a half section to one light field, which enters only through A'y.

    It has the methods that `lf_flame.tomography.strength_search.StrengthSearch` needs.

    Parameters
    ----------
    gram : BandedGram
    backprojection : ndarray of float64, shape (heights, radii)
        Backprojected light field, A'y.
    squared : float
        Sum of the squares of y.
    pixels : int
        Number of pixels of y.
    rng : numpy.random.Generator
        Generator of the vectors that estimate traces.
    """

    def __init__(
        self,
        gram: BandedGram,
        backprojection: np.ndarray,
        squared: float,
        pixels: int,
        rng: np.random.Generator,
    ):
        self.gram = gram
        self._linear = backprojection.ravel() * gram.unit
        self._probes = rng.choice([-1.0, 1.0], (len(gram.unit), PROBES))
        self._seen_probes = np.stack([gram.multiply(one) for one in self._probes.T], axis=1)
        plain = self._factor = gram.factor(RIDGE)
        self._plain = linalg.cho_solve_banded((plain, True), self._linear)
        explained = self._plain @ (2 * self._linear - gram.multiply(self._plain))
        self._outside = max(squared - float(explained), 0.0)
        self.modes = self._trace(plain)
        self._noise_modes = pixels - self.modes

    def measure_noise(self) -> float:
        """Measure the standard deviation per pixel of the part that no half section explains."""
        return float(np.sqrt(self._outside / self._noise_modes))

    def unpenalised(self) -> np.ndarray:
        """Emission of the unpenalised fit, which explains as much light as any half section."""
        return (self._plain * self.gram.unit).reshape(self.gram.grid.shape)

    def draw(
        self,
        back: np.ndarray,
        sd: float,
        options: SolveOptions,
        start: np.ndarray,
        rng: np.random.Generator,
    ) -> np.ndarray:
        """Draw emission from the posterior, given the light field and the penalty.

        Noise is added to the light field and, because the penalty is a prior, to the desired values
        of its differences. Without negative light, such solutions are draws of the posterior, so
        that their scatter includes the effect of the penalty on the flame (Wahba, J. R. Stat. Soc.
        B 45, 133, 1983; Bardsley and others, SIAM J. Sci. Comput. 36, A1895, 2014).

        Parameters
        ----------
        back : ndarray of float64, shape (heights, radii)
            Backprojected noise of the light field.
        sd : float
            Standard deviation of a pixel's noise inside the flame.
        options : SolveOptions
        start : ndarray, shape (1, heights, radii)
            Emission from which to start.
        rng : numpy.random.Generator

        Returns
        -------
        ndarray of float64, shape (heights, radii)
        """
        noise = back.ravel() * self.gram.unit
        noise += sd * self.gram.draw_penalty(options.strength, rng)
        return self._solve(self._linear + noise, options, start)[0]

    def solve_for(self, back: np.ndarray, options: SolveOptions, start: np.ndarray) -> np.ndarray:
        """Fit another backprojected light field, (heights, radii); starts from known emission."""
        return self._solve(back.ravel() * self.gram.unit, options, start)

    def explain(self, back: np.ndarray) -> np.ndarray:
        """Emission of the unpenalised fit to another backprojected light field."""
        scaled = linalg.cho_solve_banded((self._factor, True), back.ravel() * self.gram.unit)
        return (scaled * self.gram.unit).reshape(self.gram.grid.shape)

    def count_modes(self, strength: float) -> float:
        """Degrees of freedom of a linear fit: the trace of the map from data to fitted data."""
        return self._trace(self.gram.factor(RIDGE, strength))

    def _trace(self, factor: np.ndarray) -> float:
        solved = linalg.cho_solve_banded((factor, True), self._seen_probes)
        return float(np.sum(self._probes * solved)) / PROBES

    def solve(
        self,
        strength: float,
        nonnegative: bool,
        iterations: int,
        start: np.ndarray | None = None,
    ) -> Fit:
        """Fit with one strength of the regularisation.

        Parameters
        ----------
        strength, nonnegative, iterations
            As for `SolveOptions`.
        start : ndarray, shape (1, heights, radii), optional
            Emission from which to start.

        Returns
        -------
        Fit
            Fit with cells of shape (1, heights, radii).
        """
        options = SolveOptions(strength, nonnegative, iterations)
        cells = self._solve(self._linear, options, start)
        apart = cells.ravel() / self.gram.unit - self._plain
        misfit = float(apart @ self.gram.multiply(apart))
        return Fit(cells, misfit)

    def _solve(
        self, linear: np.ndarray, options: SolveOptions, start: np.ndarray | None
    ) -> np.ndarray:
        strength, nonnegative, iterations = options
        gram = self.gram
        if nonnegative:
            quadratic = _Quadratic(gram.factor(1 / STEP, strength), linear)
            first = np.zeros_like(gram.unit) if start is None else start.ravel() / gram.unit
            box = Box(0.0, np.inf)
            _, scaled = ADMM(quadratic, box, first, STEP, niter=iterations)
        else:
            scaled = linalg.cho_solve_banded((gram.factor(RIDGE, strength), True), linear)
        return (scaled * gram.unit).reshape(1, *gram.grid.shape)
