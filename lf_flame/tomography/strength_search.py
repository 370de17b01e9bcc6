"""How strong the penalty is to be: as strong as noise allows, by the discrepancy principle."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lf_flame.tomography.penalised_fit import Fit

STRENGTHS = tuple(10.0 ** (k / 2) for k in range(-12, 7))
"""Strengths of the penalty that are tried: from none that is felt to a smear."""

FIRST = 13
"""Index of the strength that is tried first: a strong one, as weaker fits need a start nearby."""


@dataclass(frozen=True)
class TriedStrength:
    """A strength of the penalty and what came of it.

    Attributes
    ----------
    strength : float
    misfit : float
        Squared residual in the operator's range, in units of the noise's share there: 1 is what
        noise alone would leave of a perfect solution.
    expected : float
        The misfit that noise leaves of a solution with so many degrees of freedom.
    roughness : float
        Root-mean-square third difference of the emission, relative to its peak.
    """

    strength: float
    misfit: float
    expected: float
    roughness: float


class Problem(Protocol):
    """What is fitted: see `lf_flame.tomography.penalised_fit.RangeFit`."""

    @property
    def modes(self) -> float:
        """Degrees of freedom of the fit without a penalty."""

    def solve(
        self,
        strength: float,
        order: int,
        nonnegative: bool,
        iterations: int,
        start: np.ndarray | None = None,
    ) -> Fit:
        """Fit with one strength of the penalty."""

    def count_modes(self, strength: float, order: int) -> float:
        """Count the degrees of freedom of a linear fit."""


class StrengthSearch:
    """Tries strengths, and remembers what came of them.

    Parameters
    ----------
    problem : Problem
    variance : float
        Of the noise of a pixel, above 0.
    noise_share : ndarray, shape (rows, columns)
        Share of the noise that each cell of a plane sees; their sum is 1.
    order : int
        Of the differences that are penalised.
    nonnegative : bool
    iterations : int
        For each strength, from the nearest one's solution.
    """

    def __init__(
        self,
        problem: Problem,
        variance: float,
        noise_share: np.ndarray,
        order: int,
        nonnegative: bool,
        iterations: int,
    ):
        self.tried: dict[float, TriedStrength] = {}
        self._cells: dict[float, np.ndarray] = {}
        self._problem, self._noise_share = problem, noise_share
        self._variance = variance
        self._options = (order, nonnegative, iterations)

    def find(self) -> float:
        """Find the strongest whose residual is what noise leaves, or else stands least above it."""
        here = FIRST
        # By whole decades first.
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
        """Find the strength at which what noise alone would see is foretold best.

        The expected error of the noise-free light field, from the misfit and the degrees of freedom
        (Mallows, Technometrics 15, 661, 1973; Stein, Ann. Statist. 9, 1135, 1981). Where the model
        itself cannot follow the data, as at an edge, it asks for no more than freedom can mend.
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
        """Cells of the tried fit that is nearest, to start from."""
        if not self._cells:
            return None
        least = STRENGTHS[0]
        key = min(self._cells, key=lambda tried: abs(math.log(tried / max(strength, least))))
        return self._cells[key]

    def attempt(self, strength: float) -> TriedStrength:
        """Fit with a strength, unless that is done."""
        if strength not in self.tried:
            order, nonnegative, iterations = self._options
            start = self.nearest(strength)
            fit = self._problem.solve(strength, order, nonnegative, iterations, start)
            free = self._problem.count_modes(strength, order) / self._problem.modes
            if nonnegative:
                free *= float(np.sum((fit.cells > 0).mean(axis=0) * self._noise_share))
            self._cells[strength] = fit.cells
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
