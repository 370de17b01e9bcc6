"""Strength of the regularisation: by the discrepancy principle, or of least expected error."""

import bisect
import math
from typing import NamedTuple

import numpy as np

STRENGTHS = tuple(10.0 ** (k / 2) for k in range(-12, 7))
"""Strengths of the regularisation that are tried, from no visible effect to strong smoothing."""


class TriedStrength(NamedTuple):
    """Misfit of a strength, that which is expected, and the state from which a similar fit starts.

    The misfit is the squared residual in the operator's range, in units of the noise's part there;
    the expected one is the misfit that noise leaves for a solution with as many degrees of freedom.
    """

    misfit: float
    expected: float
    state: np.ndarray | None = None


class StrengthSearch:
    """Tries strengths of the regularisation, and stores the results.

    `variance` is that of a pixel's noise, `noise_share` the fraction of the noise in each cell, and
    `iterations` the number for each strength, starting from the nearest one's solution.
    """

    def __init__(self, problem, variance: float, noise_share: np.ndarray, iterations: int):
        self._tried: dict[int, TriedStrength] = {}
        self._problem, self._noise_share = problem, noise_share
        self._variance, self._iterations = variance, iterations

    def find(self) -> float:
        """Find the strongest smoothing within the noise, or the one nearest to it.

        A fit that may be negative needs no iterations; it is within the noise up to about the same
        strength. The search starts one step above that, as weaker fits need a start nearby.
        """
        # The excess of linear fits increases with the strength.
        here = bisect.bisect(range(len(STRENGTHS)), 0.0, key=self._linear_excess)
        while self._excess(here) <= 0:
            here += 1
        while self._excess(here) > 0 and self._excess(here - 1) < self._excess(here):
            here -= 1
        # Where none is within the noise, the stronger ones may not have converged.
        while self._excess(here) > 0 and self._excess(here + 1, here) < self._excess(here):
            here += 1
        return STRENGTHS[here]

    def find_by_risk(self) -> float:
        """Find the strength with the least expected error of the noise-free light field.

        The error is estimated from the misfit and the degrees of freedom (Mallows, Technometrics
        15, 661, 1973; Stein, Ann. Statist. 9, 1135, 1981). Where the model itself cannot follow the
        data, as at an edge, this does not choose weaker strengths that would not help.
        """
        here = 13  # a strong one, as weaker fits need a start nearby
        while self._risk(here - 1) < self._risk(here):
            here -= 1
        while self._risk(here + 1) < self._risk(here):
            here += 1
        return STRENGTHS[here]

    def nearest(self, strength: float) -> np.ndarray | None:
        """State of the nearest fit that was tried, to start from."""
        if not self._tried:
            return None
        near = min(self._tried, key=lambda index: abs(math.log(STRENGTHS[index] / strength)))
        return self._tried[near].state

    def _try(self, index: int, start: int | None = None) -> TriedStrength:
        """Fit with a strength, unless this was done before; anew from that of `start`."""
        if not 0 <= index < len(STRENGTHS):
            return TriedStrength(math.inf, 0.0)
        if index not in self._tried or start is not None:
            problem, strength = self._problem, STRENGTHS[index]
            state = self.nearest(strength) if start is None else self._tried[start].state
            fit = problem.solve(strength, self._iterations, state)
            free = problem.gram.count_modes(strength) / problem.gram.modes
            free *= float(np.sum((fit.cells > 0) * self._noise_share))
            misfit = fit.misfit / (self._variance * problem.gram.modes)
            self._tried[index] = TriedStrength(misfit, 1 - free, fit.state)
        return self._tried[index]

    def _risk(self, index: int) -> float:
        tried = self._try(index)
        return tried.misfit + 2 * (1 - tried.expected)

    def _excess(self, index: int, start: int | None = None) -> float:
        tried = self._try(index, start)
        return tried.misfit - tried.expected

    def _linear_excess(self, index: int) -> float:
        """Excess of a fit that may be negative."""
        problem, gram, strength = self._problem, self._problem.gram, STRENGTHS[index]
        misfit = problem.linear_misfit(strength) / (self._variance * gram.modes)
        return misfit - 1 + gram.count_modes(strength) / gram.modes
