"""Which cells glow at all.

A fit without negative light turns noise into faint light in cells that are dark, and takes that
light from bright cells at other depths of the same place: with four planes at 5 % of noise, one per
cent of the peak. So light that is hardly more than what noise alone makes is taken for none, and
the rest is fitted again, unless the light field speaks against it.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from lf_flame.tomography.penalised_fit import RangeFit

FACTORS = (3.0, 1.5, 0.75)
"""Of the brightest that noise alone makes anywhere, up to which light is taken for none; tried one
after the other. Larger ones lose dim light of phantoms; smaller ones gain little."""

NEIGHBOURS = np.ones((1, 3, 3))
"""Cells that are judged together, and that may glow around a bright one."""

TRIAL = 40
"""Iterations of a trial; it starts from a fit."""


@dataclass(frozen=True)
class Fitting:
    """How a fit is made and judged.

    Attributes
    ----------
    strength : float
        Of the penalty.
    order : int
        Of the differences that are penalised.
    variance : float
        Of a pixel's noise, above 0.
    noise_share : ndarray, shape (rows, columns)
        Share of the noise that each cell of a plane sees; their sum is 1.
    """

    strength: float
    order: int
    variance: float
    noise_share: np.ndarray


def find_foreground(
    problem: RangeFit, noise_alone: RangeFit, cells: np.ndarray, fitting: Fitting
) -> tuple[np.ndarray | None, np.ndarray]:
    """Find the cells that may glow.

    A trial is kept if the expected error of what a light field without noise would show is less
    than before (Mallows, Technometrics 15, 661, 1973): the misfit grows by less than twice the
    degrees of freedom that are given up.

    Parameters
    ----------
    problem : RangeFit
        The light field.
    noise_alone : RangeFit
        A draw of its noise, without light.
    cells : ndarray of float32, shape (planes, rows, columns)
        A fit to the light field in which all cells may glow.
    fitting : Fitting

    Returns
    -------
    foreground : ndarray of bool, shape (planes, rows, columns), or None
        None if all may glow.
    cells : ndarray of float32
        To go on from: the trial that was kept, or those that were given.
    """
    options = (fitting.strength, fitting.order, True, TRIAL)
    level = float(ndimage.uniform_filter(noise_alone.solve(*options).cells, (1, 3, 3)).max())
    together = ndimage.uniform_filter(cells, (1, 3, 3))
    before = _risk(problem, cells, fitting)
    for factor in FACTORS:
        foreground = ndimage.binary_dilation(together > factor * level, NEIGHBOURS)
        trial = problem.solve(*options, cells, foreground).cells
        if _risk(problem, trial, fitting) < before:
            return foreground, trial
    return None, cells


def _risk(problem: RangeFit, cells: np.ndarray, fitting: Fitting) -> float:
    """Misfit in units of the noise's variance, and twice the freedom that was taken up."""
    glowing = float(np.sum((cells > 0).mean(axis=0) * fitting.noise_share))
    free = glowing * problem.count_modes(fitting.strength, fitting.order)
    return problem.misfit(cells) / fitting.variance + 2 * free
