"""Least squares on depth planes with a penalty on roughness and no negative light, by frequency."""

from functools import cached_property
from typing import NamedTuple

import numpy as np
from numba import get_num_threads
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


class Solution(NamedTuple):
    """Cells, squared residual in the operator's range, and state to start a similar fit."""

    cells: np.ndarray
    misfit: float
    state: np.ndarray


class PlaneProblem:
    """Fits of depth planes to one light field y, which enters only through its focal stack A'y.

    `squared` is the sum of the squares of y, without which the residual is undefined, and `rays`
    the number of its known pixels.
    """

    def __init__(
        self, gram: FrequencyGram, focal_stack: np.ndarray, squared: float = 0.0, rays: int = 0
    ):
        self.gram = gram
        self.stack = gram.spread(focal_stack)
        self._squared, self._rays = squared, rays

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

    @cached_property
    def modes(self) -> float:
        """Degrees of freedom of the fit without a penalty."""
        return self.gram.modes

    def measure_noise(self) -> float:
        """Measure the standard deviation per pixel of the part that no emission explains."""
        outside = max(self._squared - self._explained, 0.0)
        return float(np.sqrt(outside / (self._rays - self.modes)))

    def unpenalised(self) -> np.ndarray:
        """Cells of the unpenalised fit, which explain as much light as any, float32."""
        return self.gram.gather(self.gram.inverse_transform(self._fitted)).astype(np.float32)

    def count_modes(self, strength: float) -> float:
        """Degrees of freedom of a linear fit with a penalty."""
        return self.gram.count_modes(strength)

    def solve(
        self,
        strength: float,
        iterations: int,
        start: np.ndarray | None = None,
        foreground: np.ndarray | None = None,
        long: float = LONG,
    ) -> Solution:
        """Fit with one strength of the regularisation, by a splitting.

        It starts from the state of a similar fit, or the linear fit. Cells outside the foreground
        are 0. `long` is the part of the iterations that takes the long step.
        """
        gram = self.gram
        first = round(long * iterations)
        parts = [part for part in zip(STEPS, (first, iterations - first), strict=True) if part[1]]
        before = STEPS[-1]
        if start is None:
            before = parts[0][0]
            values = gram.decomposition[0] + gram.penalty(strength) + RIDGE * gram.scale
            linear = multiply(gram.compose(1 / values), self._spectrum)
            start = gram.inverse_transform(linear).astype(np.float32)
        may_glow = np.ones(gram.grid.shape, bool) if foreground is None else foreground
        # There is no emission beyond the grid.
        roof = gram.spread(np.where(may_glow, np.float32(np.inf), np.float32(0)))
        state = start
        with progress.bar("fitting", iterations) as shown:
            for step, most in parts:
                state = _scaled(state, roof, step / before)
                before = step
                self._split(step / gram.scale, strength, roof, state, most, shown)
        cells = gram.gather(np.clip(state, 0, roof))
        return Solution(cells, self.misfit(cells), state)

    def _split(
        self, step: float, strength: float, roof: np.ndarray, state: np.ndarray, most: int, shown
    ) -> None:
        """Relaxed Douglas-Rachford splitting, until fit and cells without negative light agree."""
        gram = self.gram
        inverse = gram.inverse(step, strength)
        shift = np.float32(step) * self.stack.astype(np.float32, copy=False)
        solved = np.clip(state, 0, roof)
        turned, gaps = np.empty_like(state), np.empty((*state.shape[:2], 2), np.float32)
        for _ in range(most):
            _advance(state, solved, roof, shift, np.float32(RELAXATION), turned, gaps)
            gap, peak = gaps.max(axis=(0, 1))
            if 0 < gap <= CONVERGED * peak:
                break
            # The proximal step on the data: the inverse of the unit matrix plus step times G.
            spectrum = fft.rfft2(turned, workers=get_num_threads())
            product = np.empty_like(spectrum)
            _multiply_frequencies(inverse, spectrum.view(np.float32), product.view(np.float32))
            solved = fft.irfft2(product, s=gram.size, workers=get_num_threads(), overwrite_x=True)
            shown.update()
        _advance(state, solved, roof, shift, np.float32(RELAXATION), turned, gaps)

    def misfit(self, cells: np.ndarray) -> float:
        """Squared residual of cells, without the part outside the operator's range."""
        spectrum = self.gram.transform(self.gram.spread(cells).astype(np.float64))
        return self._explained - self._explain(spectrum)

    def _explain(self, spectrum: np.ndarray) -> float:
        """Find the part of the light field's sum of squares that cells explain."""
        seen = multiply(self.gram.matrices, spectrum)
        return 2 * self.gram.inner(self._spectrum, spectrum) - self.gram.inner(spectrum, seen)


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
