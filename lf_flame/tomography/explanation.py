"""Light that explains a light field, with the noise and the strength by which it was found."""

from dataclasses import dataclass, replace

import numpy as np

from lf_flame.tomography.penalised_fit import Fit
from lf_flame.tomography.strength_search import TriedStrength


@dataclass(frozen=True, eq=False)
class Explanation:
    """Cells that explain a light field.

    Attributes
    ----------
    cells : ndarray of float32, shape (planes, rows, columns)
        Light that leaves each cell.
    foreground : ndarray of bool, same shape, or None
        Cells that may emit; None if all may.
    noise, measured : float
        Standard deviation of a pixel's noise: as used, and as measured.
    uneven : ndarray of float32, shape (v, u, t, s)
        Variance of each pixel's noise relative to its mean.
    shared : float
        Factor by which correlation raises the noise of sums of pixels.
    strength : float
        Strength of the regularisation.
    tried : tuple of TriedStrength
        Strengths that were tried.
    settled : bool
        Whether the correction for absorption converged.
    state : ndarray of float32, or None
        State from which a similar fit starts.
    brightest : float
        Largest light that noise alone makes, relative to `summed_noise`.
    """

    cells: np.ndarray
    foreground: np.ndarray | None
    noise: float
    measured: float
    uneven: np.ndarray
    shared: float
    strength: float
    tried: tuple[TriedStrength, ...]
    settled: bool = True
    state: np.ndarray | None = None
    brightest: float = 0.0

    def with_fit(self, fit: Fit) -> "Explanation":
        """Take the cells of another fit."""
        return replace(self, cells=fit.cells, state=fit.state)

    @property
    def summed_noise(self) -> float:
        """Standard deviation of a pixel with independent noise, whose sums have the same noise."""
        return self.noise * self.shared

    @property
    def pixel_noise(self) -> np.ndarray:
        """The same of each pixel, float32, shape (v, u, t, s)."""
        return np.float32(self.summed_noise) * np.sqrt(self.uneven)

    def lit_noise(self, seen: np.ndarray) -> float:
        """Find that standard deviation, weighted by the light of `seen`."""
        light = max(float(np.sum(seen, dtype=np.float64)), 1e-30)
        lit = float(np.sum(self.uneven * seen, dtype=np.float64)) / light
        return self.summed_noise * float(np.sqrt(max(lit, 0.0)))
