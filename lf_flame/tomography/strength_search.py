"""Strength of the regularisation: as strong as the noise allows, by the discrepancy principle."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lf_flame.errors import InputError
from lf_flame.tomography.penalised_fit import Fit

STRENGTHS = tuple(10.0 ** (k / 2) for k in range(-12, 7))
"""Strengths of the regularisation that are tried, from no visible effect to strong smoothing."""

FIRST = 13
"""Index of the strength that is tried first: a strong one, as weaker fits need a start nearby."""


MOST = 1e30
"""Largest noise and strength: far above any use, and their products are float64 numbers."""


def check_noise_and_strength(noise: float | None, strength: float | None) -> None:
    """Refuse a noise or a strength of the penalty that cannot be used; None is to be found.

    Raises
    ------
    InputError
        If one is negative, not finite, or above `MOST`.
    """
    for name, value in (("noise", noise), ("strength", strength)):
        if value is not None and not 0 <= value <= MOST:
            raise InputError(f"{name} must be a finite number from 0 to {MOST:g}, got {value}.")


@dataclass(frozen=True)
class TriedStrength:
    """A strength of the regularisation and its result.

    Attributes
    ----------
    strength : float
        Strength of the regularisation.
    misfit : float
        Squared residual in the operator's range, in units of the noise's part there: a perfect
        solution has 1.
    expected : float
        Misfit that noise leaves for a solution with as many degrees of freedom.
    roughness : float
        Root-mean-square third difference of the emission, relative to its peak.
    """

    strength: float
    misfit: float
    expected: float
    roughness: float


class Problem(Protocol):
    """Problem to fit, for example `lf_flame.tomography.penalised_fit.RangeFit`."""

    @property
    def modes(self) -> float:
        """Degrees of freedom of the fit without a penalty."""

    def solve(
        self,
        strength: float,
        nonnegative: bool,
        iterations: int,
        start: np.ndarray | None = None,
    ) -> Fit:
        """Fit with one strength of the regularisation."""

    def count_modes(self, strength: float) -> float:
        """Count the degrees of freedom of a linear fit."""


class StrengthSearch:
    """Tries strengths of the regularisation, and stores the results.

    Parameters
    ----------
    problem : Problem
    variance : float
        Variance of a pixel's noise, above 0.
    noise_share : ndarray, shape (rows, columns)
        Fraction of the noise in each cell of a plane; the sum is 1.
    nonnegative : bool
        Whether emission is kept at 0 or above.
    iterations : int
        Number of iterations for each strength, starting from the nearest one's solution.
    """

    def __init__(
        self,
        problem: Problem,
        variance: float,
        noise_share: np.ndarray,
        nonnegative: bool,
        iterations: int,
    ):
        self.tried: dict[float, TriedStrength] = {}
        self._starts: dict[float, np.ndarray] = {}
        self._problem, self._noise_share = problem, noise_share
        self._variance = variance
        self._options = (nonnegative, iterations)

    def find(self) -> float:
        """Find the strongest with a residual within the noise, or else the least excess."""
        here = FIRST
        # First in steps of a decade.
        while self._excess(here) <= 0 and self._excess(here + 2) <= 0:
            here += 2
        while self._excess(here) > 0 and self._excess(here - 2) < self._excess(here):
            here -= 2
        if self._excess(here) <= 0:
            return STRENGTHS[here + 1 if self._excess(here + 1) <= 0 else here]
        near = [here - 1, here, here + 1]
        enough = [index for index in near if self._excess(index) <= 0]
        return STRENGTHS[max(enough) if enough else min(near, key=self._excess)]

    def find_by_risk(self) -> float:
        """Find the strength with the least expected error of the noise-free light field.

        The error is estimated from the misfit and the degrees of freedom (Mallows, Technometrics
        15, 661, 1973; Stein, Ann. Statist. 9, 1135, 1981). Where the model itself cannot follow the
        data, as at an edge, this does not choose weaker strengths that would not help.
        """
        here = FIRST
        while self._risk(here - 1) < self._risk(here):
            here -= 1
        while self._risk(here + 1) < self._risk(here):
            here += 1
        return STRENGTHS[here]

    def try_all(self) -> None:
        """Try every strength, strongest first."""
        for strength in reversed(STRENGTHS):
            self.attempt(strength)

    def nearest(self, strength: float) -> np.ndarray | None:
        """State, or cells, of the nearest fit that was tried, to start from."""
        if not self._starts:
            return None
        least = STRENGTHS[0]
        key = min(self._starts, key=lambda tried: abs(math.log(tried / max(strength, least))))
        return self._starts[key]

    def attempt(self, strength: float) -> TriedStrength:
        """Fit with a strength, unless this was done before."""
        if strength not in self.tried:
            nonnegative, iterations = self._options
            start = self.nearest(strength)
            fit = self._problem.solve(strength, nonnegative, iterations, start)
            free = self._problem.count_modes(strength) / self._problem.modes
            if nonnegative:
                free *= float(np.sum((fit.cells > 0).mean(axis=0) * self._noise_share))
            self._starts[strength] = fit.cells if fit.state is None else fit.state
            misfit = fit.misfit / (self._variance * self._problem.modes)
            self.tried[strength] = TriedStrength(strength, misfit, 1 - free, roughness(fit.cells))
        return self.tried[strength]

    def _risk(self, index: int) -> float:
        if not 0 <= index < len(STRENGTHS):
            return math.inf
        tried = self.attempt(STRENGTHS[index])
        return tried.misfit + 2 * (1 - tried.expected)

    def _excess(self, index: int) -> float:
        if not 0 <= index < len(STRENGTHS):
            return math.inf
        tried = self.attempt(STRENGTHS[index])
        return tried.misfit - tried.expected


def roughness(cells: np.ndarray) -> float:
    """Root-mean-square third difference along rows and columns, relative to the peak."""
    peak = max(float(cells.max()), float(np.finfo(np.float32).tiny))
    squares = [np.mean(np.square(np.diff(cells, 3, axis) / peak)) for axis in (1, 2)]
    return float(np.sqrt(sum(squares)))
