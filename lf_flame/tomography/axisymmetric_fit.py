"""Least squares for a half section, with a penalty on roughness and no negative light."""

import numpy as np
from pyproximal import Box, ProxOperator
from pyproximal.optimization.primal import ADMM
from scipy import linalg, sparse
from scipy.linalg.blas import dsbmv

from lf_flame.tomography.axisymmetric_grid import AxisymmetricGrid
from lf_flame.tomography.axisymmetric_operator import gram_bands
from lf_flame.tomography.frequency_gram import RIDGE
from lf_flame.tomography.penalised_fit import Fit

STEP = 10.0
"""Step of the splitting, where the Gram matrix's diagonal is scaled to 1."""

PROBES = 32
"""Random vectors by which traces are estimated (Hutchinson 1990): 1 % off for 1,000 freedoms."""


class BandedGram:
    """The Gram matrix of a half section, scaled to a diagonal of 1, and the penalty beside it.

    Near the axis a node is seen little; scaled, all take steps of one size.

    Parameters
    ----------
    grid : AxisymmetricGrid

    Attributes
    ----------
    grid : AxisymmetricGrid
    unit : ndarray of float64, shape (nodes,)
        Emission of a node for a scaled value of 1.
    bands : ndarray of float64, shape (band, nodes)
        Lower diagonals.
    """

    def __init__(self, grid: AxisymmetricGrid):
        self.grid = grid
        bands = gram_bands(grid)
        diagonal = np.maximum(bands[0], 1e-9 * bands[0].max())
        self.unit = 1 / np.sqrt(diagonal)
        self.typical = float(np.mean(diagonal))
        self.bands = _scale(bands, self.unit)

    def multiply(self, scaled: np.ndarray) -> np.ndarray:
        """Multiply with the scaled matrix."""
        return dsbmv(len(self.bands) - 1, 1.0, self.bands, scaled, lower=1)

    def penalty(self, strength: float, order: int) -> np.ndarray:
        """Give the penalty's lower diagonals, scaled; shape (band, nodes)."""
        rough = roughness_matrix(self.grid.shape, order)
        lower = sparse.tril(rough).tocoo()
        bands = np.zeros((int((lower.row - lower.col).max()) + 1, rough.shape[0]))
        bands[lower.row - lower.col, lower.col] = lower.data
        return _scale(strength * self.typical * bands, self.unit)

    def factor(self, add: float, strength: float = 0.0, order: int = 1) -> np.ndarray:
        """Factor the scaled matrix with penalty and a multiple of one, as `cho_solve_banded` takes.

        The step of the splitting is 1 / `add`.
        """
        penalty = self.penalty(strength, order)
        total = np.zeros((max(len(self.bands), len(penalty)), self.bands.shape[1]))
        total[: len(self.bands)] += self.bands
        total[: len(penalty)] += penalty
        total[0] += add
        return linalg.cholesky_banded(total, lower=True, check_finite=False)


def roughness_matrix(shape: tuple[int, int], order: int) -> sparse.csr_array:
    """Square differences along height and radius; the section goes on mirrored beyond its axis.

    Beyond the last radius there is no light.

    Returns
    -------
    scipy.sparse.csr_array of float64, shape (nodes, nodes)
    """
    heights, radii = shape
    along = np.diff(np.eye(heights), order, axis=0)
    mirrored = np.zeros((2 * radii - 1 + order, radii))
    place = np.arange(2 * radii - 1)
    mirrored[place, np.abs(place - (radii - 1))] = 1
    across = np.diff(mirrored, order, axis=0) / np.sqrt(2)  # each side of the axis counts half
    down = sparse.kron(sparse.csr_array(along.T @ along), sparse.eye_array(radii))
    return (down + sparse.kron(sparse.eye_array(heights), across.T @ across)).tocsr()


def _scale(bands: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """Multiply lower diagonals from both sides with a diagonal matrix."""
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
        return 0.0  # nobody asks: the iterations are counted

    def prox(self, x: np.ndarray, tau: float) -> np.ndarray:
        return linalg.cho_solve_banded(
            (self._factor, True), self._linear + x / tau, check_finite=False
        )


class AxisymmetricFit:
    """Fits of a half section to one light field, seen only through A'y.

    It offers what `lf_flame.tomography.strength_search.StrengthSearch` asks of a problem.

    Parameters
    ----------
    gram : BandedGram
    backprojection : ndarray of float64, shape (heights, radii)
        A'y.
    squared : float
        Sum of the squares of y.
    pixels : int
        Number of pixels of y.
    rng : numpy.random.Generator
        Of the vectors that traces are estimated by.
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
        plain = gram.factor(RIDGE)
        self._plain = linalg.cho_solve_banded((plain, True), self._linear)
        explained = self._plain @ (2 * self._linear - gram.multiply(self._plain))
        self._outside = max(squared - float(explained), 0.0)
        self.modes = self._trace(plain)
        self._noise_modes = pixels - self.modes

    def measure_noise(self) -> float:
        """Measure the standard deviation of what no half section explains, per pixel."""
        return float(np.sqrt(self._outside / self._noise_modes))

    def unpenalised(self) -> np.ndarray:
        """Emission that explains as much of the light field as any half section can."""
        return (self._plain * self.gram.unit).reshape(self.gram.grid.shape)

    def count_modes(self, strength: float, order: int) -> float:
        """Degrees of freedom of a linear fit: the trace from data to fitted data."""
        return self._trace(self.gram.factor(RIDGE, strength, order))

    def _trace(self, factor: np.ndarray) -> float:
        solved = linalg.cho_solve_banded((factor, True), self._seen_probes)
        return float(np.sum(self._probes * solved)) / PROBES

    def solve(
        self,
        strength: float,
        order: int,
        nonnegative: bool,
        iterations: int,
        start: np.ndarray | None = None,
    ) -> Fit:
        """Fit with one strength of the penalty.

        Parameters
        ----------
        strength, order
            As `BandedGram.penalty` takes them.
        nonnegative : bool
            Without, the fit is linear, and one step.
        iterations : int
        start : ndarray, shape (1, heights, radii), optional
            Emission from which to start.

        Returns
        -------
        Fit
            Its cells of shape (1, heights, radii).
        """
        gram = self.gram
        if nonnegative:
            quadratic = _Quadratic(gram.factor(1 / STEP, strength, order), self._linear)
            first = np.zeros_like(gram.unit) if start is None else start.ravel() / gram.unit
            box = Box(0.0, np.inf)
            _, scaled = ADMM(quadratic, box, first, STEP, niter=iterations)
        else:
            scaled = linalg.cho_solve_banded(
                (gram.factor(RIDGE, strength, order), True), self._linear
            )
        apart = scaled - self._plain
        misfit = float(apart @ gram.multiply(apart))
        return Fit((scaled * gram.unit).reshape(1, *gram.grid.shape), misfit)
