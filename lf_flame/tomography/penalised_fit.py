"""Least squares with regularisation (roughness) and no negative light, by frequency."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import get_num_threads
from pyproximal import Box, ProxOperator
from pyproximal.optimization.primal import DouglasRachfordSplitting
from scipy import fft

from lf_flame._common import progress
from lf_flame._common.threads import pieces, shared
from lf_flame.tomography.frequency_gram import RIDGE, FrequencyGram, multiply

STEP = 60.0
"""Step of the splitting, in units of 1 / `FrequencyGram.scale`. With it the fit of the four flames
converges in about 50 iterations; steps 10 times shorter or longer take about 300."""

RELAXATION = 1.8
"""Relaxation of the splitting, between 1 and 2 (Eckstein and Bertsekas, Math. Program. 55, 293,
1992); with it, flames behind each other take half the iterations."""


class FrequencyFit(ProxOperator):
    """Quadratic form ``x'Gx / 2 - b'x`` with G known by frequency, and its proximal operator.

    Parameters
    ----------
    gram : FrequencyGram
    focal_stack : ndarray, shape (planes, rows, columns)
        Linear term b, on the torus.
    penalty : ndarray of float64, shape (fy, fx, 1)
        Values added to the eigenvalues of G.
    """

    def __init__(self, gram: FrequencyGram, focal_stack: np.ndarray, penalty: np.ndarray):
        super().__init__(None, False)
        self._shape = focal_stack.shape
        self._focal_stack = focal_stack.astype(np.float32)
        self._gram = gram
        self._step = STEP / gram.scale
        self._values = gram.decomposition[0] + penalty
        # In float64: G alone is singular where depths cannot be distinguished.
        inverse = gram.compose(1 / (1 + self._step * self._values))
        self._inverse = np.ascontiguousarray(np.moveaxis(inverse, 1, -1), np.float32)

    def __call__(self, x: np.ndarray) -> float:
        """Value of the quadratic form."""
        torus = x.reshape(self._shape).astype(np.float64)
        spectrum = self._gram.transform(torus)
        seen = multiply(self._gram.compose(self._values), spectrum)
        linear = float(np.vdot(self._focal_stack.astype(np.float64), torus))
        return self._gram.inner(spectrum, seen) / 2 - linear

    def prox(self, x: np.ndarray, tau: float) -> np.ndarray:
        """Minimise the quadratic form plus ``|z - x|^2 / (2 tau)`` over z."""
        if abs(tau / self._step - 1) > 1e-6:  # solvers of float32 round it
            raise ValueError(f"The matrices are inverted for the step {self._step}, not {tau}.")
        torus = x.reshape(self._shape).astype(np.float32, copy=False)
        torus = torus + np.float32(tau) * self._focal_stack
        spectrum = fft.rfft2(torus, workers=get_num_threads())
        solved = np.empty_like(spectrum)
        _multiply_frequencies(self._inverse, spectrum.view(np.float32), solved.view(np.float32))
        return fft.irfft2(solved, s=self._shape[1:], workers=get_num_threads()).ravel()


@dataclass(frozen=True)
class Fit:
    """Result of a fit.

    Attributes
    ----------
    cells : ndarray of float32, shape (planes, rows, columns)
        Cells of the grid.
    misfit : float
        Squared residual of the light field, without the part outside the operator's range.
    """

    cells: np.ndarray
    misfit: float


class RangeFit:
    """Fits to one light field, which enters only through its filtered focal stack.

    Parameters
    ----------
    gram : FrequencyGram
    focal_stack : ndarray, shape (planes, rows, columns)
        Filtered focal stack A'y on the grid.
    squared : float
        Sum of the squares of y.
    pixels : int
        Number of pixels of y.

    Attributes
    ----------
    gram : FrequencyGram
    stack : ndarray
        Filtered focal stack on the torus.
    """

    def __init__(self, gram: FrequencyGram, focal_stack: np.ndarray, squared: float, pixels: int):
        self.gram = gram
        self.stack = gram.spread(focal_stack)
        self._squared, self._pixels = squared, pixels

    @cached_property
    def _spectrum(self) -> np.ndarray:
        return self.gram.transform(self.stack.astype(np.float64))

    @cached_property
    def _fitted(self) -> np.ndarray:
        return multiply(self.gram.plain_inverse, self._spectrum)

    @cached_property
    def _explained(self) -> float:
        """Part of the light field's sum of squares that the unpenalised fit explains."""
        return self._explain(self._fitted)

    @property
    def outside(self) -> float:
        """Sum of the squares of the part that no cells explain."""
        return max(self._squared - self._explained, 0.0)

    @cached_property
    def modes(self) -> float:
        """Degrees of freedom of the fit without a penalty."""
        gram = self.gram
        return self._count(np.einsum("yxpq,yxqp->yx", gram.plain_inverse, gram.matrices))

    def measure_noise(self) -> float:
        """Measure the standard deviation per pixel of the part that no emission explains."""
        return float(np.sqrt(self.outside / (self._pixels - self.modes)))

    def unpenalised(self) -> np.ndarray:
        """Cells of the unpenalised fit, which explain as much light as any, float32."""
        spectrum = np.moveaxis(self._fitted, -1, 0)
        torus = fft.irfft2(spectrum, s=self.gram.size, workers=get_num_threads())
        return self.gram.gather(torus).astype(np.float32)

    def count_modes(self, strength: float, order: int) -> float:
        """Degrees of freedom of a linear fit: the trace of the map from data to fitted data.

        Only the recorded pixels count, a part of the torus.
        """
        gram = self.gram
        values, _ = gram.decomposition
        kept = gram.gains / (values + gram.penalty(strength, order) + RIDGE * gram.scale)
        return self._count(kept.sum(axis=-1))

    def _count(self, traces: np.ndarray) -> float:
        """Add traces over the frequencies; only the recorded part of the torus counts."""
        share = np.prod(self.gram.grid.pixels) / np.prod(self.gram.size)
        return float(np.sum(self.gram.multiplicity * traces) * share)

    def _solve_linear(self, inverse: np.ndarray) -> np.ndarray:
        """Coefficients of the cells, from the eigenvalues of the inverse matrices."""
        return multiply(self.gram.compose(inverse), self._spectrum)

    def solve(
        self,
        strength: float,
        order: int,
        nonnegative: bool,
        iterations: int,
        start: np.ndarray | None = None,
        foreground: np.ndarray | None = None,
    ) -> Fit:
        """Fit with one strength of the regularisation.

        Parameters
        ----------
        strength : float
            Strength, as for `FrequencyGram.penalty`.
        order : int
            Order of the differences that are penalised.
        nonnegative : bool
            Whether cells are kept at 0 or above; if not, the fit is linear, and takes one step.
        iterations : int
            Number of iterations of the splitting.
        start : ndarray, shape (planes, rows, columns), optional
            Cells from which to start.
        foreground : ndarray of bool, shape (planes, rows, columns), optional
            Cells that may emit; others are 0. Default: all.
        """
        gram = self.gram
        penalty = gram.penalty(strength, order)
        if nonnegative:
            torus = self._split(penalty, iterations, start, foreground)
        else:
            values, _ = gram.decomposition
            spectrum = self._solve_linear(1 / (values + penalty + RIDGE * gram.scale))
            torus = fft.irfft2(np.moveaxis(spectrum, -1, 0), s=gram.size, workers=get_num_threads())
        cells = gram.gather(torus).astype(np.float32)
        return Fit(cells, self.misfit(cells))

    def _split(
        self,
        penalty: np.ndarray,
        iterations: int,
        start: np.ndarray | None,
        foreground: np.ndarray | None,
    ) -> np.ndarray:
        gram = self.gram
        fit = FrequencyFit(gram, self.stack, penalty)
        may_glow = np.ones(gram.grid.shape, bool) if foreground is None else foreground
        # There is no emission beyond the grid.
        roof = gram.spread(np.where(may_glow, np.float32(np.inf), np.float32(0))).ravel()
        box = Box(np.zeros_like(roof), roof)
        first = np.zeros(gram.grid.shape, np.float32) if start is None else start
        with progress.bar("fitting", iterations) as shown:
            glow, _ = DouglasRachfordSplitting(
                fit,
                box,
                gram.spread(first).ravel(),
                STEP / gram.scale,
                eta=RELAXATION,
                niter=iterations,
                callback=lambda _: shown.update(),
            )
        return glow.reshape(self.stack.shape)

    def misfit(self, cells: np.ndarray) -> float:
        """Squared residual of cells, without the part outside the operator's range."""
        spectrum = self.gram.transform(self.gram.spread(cells).astype(np.float64))
        return self._explained - self._explain(spectrum)

    def _explain(self, spectrum: np.ndarray) -> float:
        """Find the part of the light field's sum of squares that cells explain."""
        seen = multiply(self.gram.matrices, spectrum)
        return 2 * self.gram.inner(self._spectrum, spectrum) - self.gram.inner(spectrum, seen)


@shared
def _multiply_frequencies(queue, matrices, spectrum, product):
    """Multiply matrices[y, p, q, x] by spectrum[q, y, 2 x]; real and imaginary parts alternate."""
    rows, planes, _, columns = matrices.shape
    for y in pieces(queue, rows):
        for p in range(planes):
            line = product[p, y]
            line[:] = 0
            for q in range(planes):
                factors, values = matrices[y, p, q], spectrum[q, y]
                for x in range(columns):
                    line[2 * x] += factors[x] * values[2 * x]
                    line[2 * x + 1] += factors[x] * values[2 * x + 1]
