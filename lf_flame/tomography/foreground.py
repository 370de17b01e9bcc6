"""Foreground: the cells that emit light.

A fit without negative light turns noise into faint light in dark cells, and takes that light from
bright cells at other depths of the same place: with four depth planes at 5 % of noise, one per cent
of the peak. Light that is hardly brighter than noise alone would make it is therefore set to 0, and
the rest is fitted again, unless the light field contradicts this.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from lf_flame.tomography.penalised_fit import Fit, RangeFit

FACTORS = (3.0, 1.5, 0.75)
"""Thresholds, as multiples of the largest value that noise alone produces; a cell below is dark.
They are tried in turn. Larger ones lose dim light of phantoms; smaller ones gain little."""

NEIGHBOURS = np.ones((1, 3, 3))
"""Neighbourhood over which cells are averaged, and by which the foreground is widened."""

TRIAL = 40
"""Number of iterations of a trial; it starts from a fit."""


@dataclass(frozen=True)
class Fitting:
    """Options of a fit, and the noise that judges it.

    Attributes
    ----------
    strength : float
        Strength of the penalty.
    variance : float
        Variance of a pixel's noise, above 0.
    noise_share : ndarray, shape (rows, columns)
        Fraction of the noise in each cell of a plane; the sum is 1.
    """

    strength: float
    variance: float
    noise_share: np.ndarray


def find_foreground(
    problem: RangeFit, brightest: float, first: Fit, fitting: Fitting
) -> tuple[np.ndarray | None, Fit]:
    """Find the cells that may emit light.

    A trial is kept if it lowers the expected error of the noise-free light field (Mallows,
    Technometrics 15, 661, 1973): the misfit must grow by less than twice the number of degrees of
    freedom that are given up.

    Parameters
    ----------
    problem : RangeFit
        Problem of the light field.
    brightest : float
        Largest light that its noise alone makes, see `brightest_noise`.
    first : Fit
        Fit to the light field in which all cells may emit.
    fitting : Fitting
        Options of the fit.

    Returns
    -------
    foreground : ndarray of bool, shape (planes, rows, columns), or None
        Cells that may emit; None if all may.
    fit : Fit
        Start of the next fit: the trial that was kept, or the first.
    """
    options = (fitting.strength, True, TRIAL)
    together = ndimage.uniform_filter(first.cells, NEIGHBOURS.shape)
    before = _risk(problem, first, fitting)
    for factor in FACTORS:
        foreground = ndimage.binary_dilation(together > factor * brightest, NEIGHBOURS)
        trial = problem.solve(*options, first.state, foreground)
        if _risk(problem, trial, fitting) < before:
            return foreground, trial
    return None, first


def brightest_noise(noise_alone: RangeFit, fitting: Fitting) -> float:
    """Largest light, averaged over neighbours, in a fit to a draw of noise without light."""
    # Noise holds no light behind other light, for which the long steps are.
    cells = noise_alone.solve(fitting.strength, True, TRIAL, long=0.0).cells
    return float(ndimage.uniform_filter(cells, NEIGHBOURS.shape).max())


def _risk(problem: RangeFit, fit: Fit, fitting: Fitting) -> float:
    """Misfit in units of the noise's variance, plus twice the degrees of freedom used."""
    glowing = float(np.sum((fit.cells > 0).mean(axis=0) * fitting.noise_share))
    free = glowing * problem.count_modes(fitting.strength)
    return fit.misfit / fitting.variance + 2 * free
