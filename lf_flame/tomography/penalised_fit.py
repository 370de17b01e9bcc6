"""Least squares with regularisation (roughness) and no negative light, by frequency."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import get_num_threads
from pyproximal import ProxOperator
from scipy import fft

from lf_flame._common import progress
from lf_flame._common.threads import parallel
from lf_flame.tomography.frequency_gram import RIDGE, FrequencyGram, multiply

STEPS, LONG = (600.0, 60.0), 0.25
"""Steps of the splitting, in units of 1 / `FrequencyGram.scale`, and the part of the iterations
that takes the first: the long one moves light between planes behind each other, the short one finds
faint light, as the parameters of alternating directions do (Wachspress, J. SIAM 10, 339, 1962)."""

CONVERGED = 1e-4
"""Largest difference of fit and light, relative to the brightest cell, at which a fit ends."""

RELAXATION = 1.8
"""Relaxation of the splitting, between 1 and 2 (Eckstein and Bertsekas, Math. Program. 55, 293,
1992); with it, flames behind each other take half the iterations."""


class FrequencyFit(ProxOperator):
    """Proximal operator of a quadratic form ``x'Gx / 2 - b'x`` with G known by frequency.

    Parameters
    ----------
    gram : FrequencyGram
    focal_stack : ndarray, shape (planes, rows, columns)
        Linear term b, on the torus.
    strength : float
        Strength of the penalty on roughness.
    step : float, optional
        Step of the proximal operator, in units of 1 / `FrequencyGram.scale`.

    Attributes
    ----------
    step : float
        Step of the proximal operator.
    shift : ndarray of float32, shape (planes, rows, columns)
        Linear term times the step.
    """

    def __init__(
        self,
        gram: FrequencyGram,
        focal_stack: np.ndarray,
        strength: float,
        step: float = STEPS[-1],
    ):
        super().__init__(None, False)
        self._size = gram.size
        self.step = step / gram.scale
        self._inverse = gram.inverse(self.step, strength)
        self.shift = np.float32(self.step) * focal_stack.astype(np.float32, copy=False)

    def __call__(self, x: np.ndarray) -> float:
        """Give 0: no solver here looks at the value."""
        return 0.0

    def prox(self, x: np.ndarray, tau: float) -> np.ndarray:
        """Minimise the quadratic form plus ``|z - x|^2 / (2 tau)`` over z."""
        if abs(tau / self.step - 1) > 1e-6:  # solvers of float32 round it
            raise ValueError(f"The matrices are inverted for the step {self.step}, not {tau}.")
        torus = x.reshape(self.shift.shape).astype(np.float32, copy=False)
        return self.solve(torus + self.shift).ravel()

    def solve(self, torus: np.ndarray) -> np.ndarray:
        """Multiply by the inverse of the unit matrix plus the step times G."""
        spectrum = fft.rfft2(torus, workers=get_num_threads())
        solved = np.empty_like(spectrum)
        _multiply_frequencies(self._inverse, spectrum.view(np.float32), solved.view(np.float32))
        return fft.irfft2(solved, s=self._size, workers=get_num_threads(), overwrite_x=True)


@dataclass(frozen=True)
class Fit:
    """Result of a fit.

    Attributes
    ----------
    cells : ndarray of float32, shape (planes, rows, columns)
        Cells of the grid.
    misfit : float
        Squared residual of the light field, without the part outside the operator's range.
    state : ndarray of float32, or None
        State of the splitting, from which a similar fit starts; None if it starts from the cells.
    """

    cells: np.ndarray
    misfit: float
    state: np.ndarray | None = None


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
        return self.gram.modes

    def measure_noise(self) -> float:
        """Measure the standard deviation per pixel of the part that no emission explains."""
        return float(np.sqrt(self.outside / (self._pixels - self.modes)))

    def unpenalised(self) -> np.ndarray:
        """Cells of the unpenalised fit, which explain as much light as any, float32."""
        return self.gram.gather(self.gram.inverse_transform(self._fitted)).astype(np.float32)

    def count_modes(self, strength: float) -> float:
        """Degrees of freedom of a linear fit: the trace of the map from data to fitted data.

        Only the recorded pixels count, a part of the torus.
        """
        return self.gram.count_modes(strength)

    def _solve_linear(self, inverse: np.ndarray) -> np.ndarray:
        """Coefficients of the cells, from the eigenvalues of the inverse matrices."""
        return multiply(self.gram.compose(inverse), self._spectrum)

    def solve(
        self,
        strength: float,
        nonnegative: bool,
        iterations: int,
        start: np.ndarray | None = None,
        foreground: np.ndarray | None = None,
        long: float = LONG,
    ) -> Fit:
        """Fit with one strength of the regularisation.

        Parameters
        ----------
        strength : float
            Strength, as for `FrequencyGram.penalty`.
        nonnegative : bool
            Whether cells are kept at 0 or above; if not, the fit is linear, and takes one step.
        iterations : int
            Largest number of iterations of the splitting.
        start : ndarray of float32, optional
            State of a similar fit. Default: the linear fit.
        foreground : ndarray of bool, shape (planes, rows, columns), optional
            Cells that may emit; others are 0. Default: all.
        long : float, optional
            Part of the iterations that takes the long step.
        """
        gram = self.gram
        first = round(long * iterations)
        parts = [part for part in zip(STEPS, (first, iterations - first), strict=True) if part[1]]
        before = STEPS[-1]
        if start is None or not nonnegative:
            before = parts[0][0]
            values, _ = gram.decomposition
            penalised = values + gram.penalty(strength) + RIDGE * gram.scale
            start = gram.inverse_transform(self._solve_linear(1 / penalised)).astype(np.float32)
        if not nonnegative:
            return Fit(gram.gather(start), self.misfit(gram.gather(start)))
        may_glow = np.ones(gram.grid.shape, bool) if foreground is None else foreground
        # There is no emission beyond the grid.
        roof = gram.spread(np.where(may_glow, np.float32(np.inf), np.float32(0)))
        state = start
        with progress.bar("fitting", iterations) as shown:
            for step, most in parts:
                state = _scaled(state, roof, step / before)
                fit, before = FrequencyFit(gram, self.stack, strength, step), step
                _split(fit, roof, state, most, shown)
        cells = gram.gather(np.clip(state, 0, roof))
        return Fit(cells, self.misfit(cells), state)

    def misfit(self, cells: np.ndarray) -> float:
        """Squared residual of cells, without the part outside the operator's range."""
        spectrum = self.gram.transform(self.gram.spread(cells).astype(np.float64))
        return self._explained - self._explain(spectrum)

    def _explain(self, spectrum: np.ndarray) -> float:
        """Find the part of the light field's sum of squares that cells explain."""
        seen = multiply(self.gram.matrices, spectrum)
        return 2 * self.gram.inner(self._spectrum, spectrum) - self.gram.inner(spectrum, seen)


def _split(fit: FrequencyFit, roof: np.ndarray, state: np.ndarray, iterations: int, shown) -> None:
    """Relaxed Douglas-Rachford splitting, until fit and cells without negative light agree."""
    solved = np.clip(state, 0, roof)
    turned, gaps = np.empty_like(state), np.empty((*state.shape[:2], 2), np.float32)
    for _ in range(iterations):
        _advance(state, solved, roof, fit.shift, np.float32(RELAXATION), turned, gaps)
        gap, peak = gaps.max(axis=(0, 1))
        if 0 < gap <= CONVERGED * peak:
            break
        solved = fit.solve(turned)
        shown.update()
    _advance(state, solved, roof, fit.shift, np.float32(RELAXATION), turned, gaps)


def _scaled(state: np.ndarray, roof: np.ndarray, ratio: float) -> np.ndarray:
    """State for a longer step: what is beyond the bounds is their multipliers times the step."""
    light = np.clip(state, 0, roof)
    return light + np.float32(ratio) * (state - light)


@parallel(lambda matrices: len(matrices))
def _multiply_frequencies(y, matrices, spectrum, product):
    """Multiply matrices[y, p, q, x] by spectrum[q, y, 2 x]; real and imaginary parts alternate."""
    rows, planes, _, columns = matrices.shape
    for p in range(planes):
        line = product[p, y]
        line[:] = 0
        for q in range(planes):
            factors, values = matrices[y, p, q], spectrum[q, y]
            for x in range(columns):
                line[2 * x] += factors[x] * values[2 * x]
                line[2 * x + 1] += factors[x] * values[2 * x + 1]


@parallel(lambda state: state.shape[0] * state.shape[1])
def _advance(k, state, solved, roof, shift, relaxation, turned, gaps):
    """Take a step of the splitting, and prepare the next one's linear fit.

    gaps[p, y]: largest difference of the linear fit and the light, and largest light, of a row.
    """
    planes, rows, columns = state.shape
    p, y = k // rows, k % rows
    line, fit, most, by = state[p, y], solved[p, y], roof[p, y], shift[p, y]
    gap, peak = np.float32(0), np.float32(0)
    for x in range(columns):
        light = min(max(line[x], np.float32(0)), most[x])
        apart = fit[x] - light
        gap, peak = max(gap, abs(apart)), max(peak, light)
        line[x] += relaxation * apart
        light = min(max(line[x], np.float32(0)), most[x])
        turned[p, y, x] = 2 * light - line[x] + by[x]
    gaps[p, y, 0], gaps[p, y, 1] = gap, peak
