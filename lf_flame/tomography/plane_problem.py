"""Least squares on depth planes with a penalty on roughness and no negative light, by frequency."""

from functools import cached_property
from typing import NamedTuple

import numpy as np
from numba import get_num_threads
from scipy import fft

from lf_flame._common import progress
from lf_flame._common.threads import parallel, without_refcounts
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
        self.squared, self.rays = squared, rays

    @cached_property
    def _spectrum(self) -> np.ndarray:
        return self.gram.transform(self.stack.astype(np.float64))

    @cached_property
    def _fitted(self) -> np.ndarray:
        return multiply(self.gram.plain_inverse, self._spectrum)

    @cached_property
    def explained(self) -> float:
        """Part of the light field's sum of squares that the unpenalised fit explains."""
        return self._explain(self._fitted)

    def unpenalised(self) -> np.ndarray:
        """Cells of the unpenalised fit, which explain as much light as any, float32."""
        return self.gram.gather(self.gram.inverse_transform(self._fitted)).astype(np.float32)

    @cached_property
    def _power(self) -> np.ndarray:
        """Squared coefficients of A'y in the gram's eigenvectors, times their multiplicity."""
        along = multiply(np.swapaxes(self.gram.decomposition[1], -1, -2), self._spectrum)
        power = self.gram.multiplicity[..., None] * (along.real**2 + along.imag**2)
        return power / np.prod(self.gram.size)

    def linear_misfit(self, strength: float) -> float:
        """Squared residual of the linear fit with a penalty, without a penalty along depth."""
        gram = self.gram
        inverse = 1 / (gram.decomposition[0] + gram.penalty(strength) + RIDGE * gram.scale)
        explained = self._power * inverse * (2 - gram.gains * inverse)
        return self.explained - float(explained.sum())

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
            start = np.ascontiguousarray(gram.inverse_transform(linear), np.float32)
        may_glow = np.ones(gram.grid.shape, bool) if foreground is None else foreground
        # There is no emission beyond the grid.
        roof = gram.spread(np.where(may_glow, np.float32(np.inf), np.float32(0)))
        state = start
        with progress.bar("fitting", iterations) as shown:
            for step, most in parts:
                # The excess over the bounds is their multipliers times the step.
                state = state + np.float32(step / before - 1) * (state - np.clip(state, 0, roof))
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
        light, apart, turned = (np.empty_like(state) for _ in range(3))

        def advance(solved: np.ndarray) -> None:
            before = (one.ravel() for one in (state, solved, roof, shift))  # views
            after = (one.ravel() for one in (light, apart, turned))
            _advance(32, *before, np.float32(RELAXATION), *after)

        for _ in range(most):
            advance(solved)
            gap = max(apart.max(), -apart.min())
            if 0 < gap <= CONVERGED * light.max():
                break
            # The proximal step on the data: the inverse of the identity plus step times G.
            spectrum = fft.rfft2(turned, workers=get_num_threads())
            product = np.empty_like(spectrum)
            _multiply_frequencies(inverse, spectrum.view(np.float32), product.view(np.float32))
            solved = fft.irfft2(product, s=gram.size, workers=get_num_threads(), overwrite_x=True)
            shown.update()
        advance(solved)

    def misfit(self, cells: np.ndarray) -> float:
        """Squared residual of cells, without the part outside the operator's range."""
        spectrum = self.gram.transform(self.gram.spread(cells).astype(np.float64))
        return self.explained - self._explain(spectrum)

    def _explain(self, spectrum: np.ndarray) -> float:
        """Find the part of the light field's sum of squares that cells explain."""
        seen = multiply(self.gram.matrices, spectrum)
        return 2 * self.gram.inner(self._spectrum, spectrum) - self.gram.inner(spectrum, seen)


@parallel(lambda matrices: len(matrices))
def _multiply_frequencies(y, matrices, spectrum, product):
    """Multiply matrices[y, p, q, x] by spectrum[q, y, 2 x]; real and imaginary parts alternate."""
    _multiply_row(y, matrices, spectrum, product)


@without_refcounts
def _multiply_row(y, matrices, spectrum, product):
    _, planes, _, columns = matrices.shape
    row = np.uintp(y)
    for p in range(np.uintp(planes)):
        for x in range(np.uintp(2 * columns)):
            product[p, row, x] = 0
        for q in range(np.uintp(planes)):
            for x in range(np.uintp(columns)):
                i = x + x
                j = i + np.uintp(1)
                product[p, row, i] += matrices[row, p, q, x] * spectrum[q, row, i]
                product[p, row, j] += matrices[row, p, q, x] * spectrum[q, row, j]


@parallel(lambda parts: parts)
def _advance(k, parts, state, solved, roof, shift, relaxation, light, apart, turned):
    """Take a step of the splitting, and prepare the next one's linear fit; arrays are flat.

    `light` is that before the step, and `apart` its difference from the linear fit.
    """
    start, end = k * len(state) // parts, (k + 1) * len(state) // parts
    _find_gap(start, end, state, solved, roof, light, apart)
    _step(start, end, state, apart, roof, shift, relaxation, turned)


# Two loops, because compilers check only a few arrays for overlap, and otherwise do not vectorise.
# Indices are unsigned, so that their signs need no check.


@without_refcounts
def _find_gap(start, end, state, solved, roof, light, apart):
    for i in range(np.uintp(start), np.uintp(end)):
        light[i] = min(max(state[i], np.float32(0)), roof[i])
        apart[i] = solved[i] - light[i]


@without_refcounts
def _step(start, end, state, apart, roof, shift, relaxation, turned):
    zero, two = np.float32(0), np.float32(2)
    for i in range(np.uintp(start), np.uintp(end)):
        after = state[i] + relaxation * apart[i]
        state[i] = after
        turned[i] = two * min(max(after, zero), roof[i]) - after + shift[i]
