"""Emission by depth, as a reconstruction finds it."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from lf_flame.errors import InputError
from lf_flame.tomography.error_bars import scatter
from lf_flame.tomography.explanation import Explanation
from lf_flame.tomography.frustum_grid import FrustumGrid
from lf_flame.tomography.strength_search import TriedStrength


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Emission by depth, with its error bars and warnings.

    Attributes
    ----------
    grid : FrustumGrid
        Depth planes and cells.
    emission : ndarray of float32, shape (planes, rows, columns)
        Radiance that each depth plane adds along the line of sight, in the unit of the light field;
        rows and columns are the pixels of the central view. `per_mm` is emission by volume. With
        an optical thickness, it is the radiance that each plane would add without absorption.
    correction : ndarray of float32, shape of `emission`
        Part of the emission that was added to the fit to correct the effect of penalty and constant
        cells; zeros without correction.
    draws : ndarray of float32, shape (draws, planes, rows, columns)
        Bootstrap draws of the emission: refits with redrawn noise and redrawn prior of the penalty,
        each with a random multiple, between 0 and 2, of the correction. Their scatter does not
        include all of the uncertainty in depth.
    sigma_linear : ndarray of float64, shape (planes,)
        Standard deviation of the unconstrained linear fit, one number for each plane. Compared with
        `sigma`, it shows how much the constraint of no negative light contributes.
    noise : float
        Standard deviation of a pixel's noise, stated or measured, in the unit of the light field.
    strength : float
        Strength of the regularisation that was used; 0 for a method that stops early.
    tried : tuple of TriedStrength
        Strengths that were tried (the L-curve), weakest first.
    chi_squared : ndarray of float64, shape (v, u)
        Mean squared residual of each view, in units of the noise's variance; NaN of views that are
        not fitted.
    warnings : tuple of str
        Sentences on disagreements of data and model.
    background, background_sigma : float
        Uniform background that was fitted and subtracted, and its standard deviation; 0 without.
    iterations : int or None
        Number of iterations after which a method stopped; None for the penalised fit.
    fit : Explanation
        Fit of the light that leaves the cells, from which the next frame of a video starts.
    """

    grid: FrustumGrid
    emission: np.ndarray
    correction: np.ndarray
    draws: np.ndarray
    sigma_linear: np.ndarray
    noise: float
    strength: float
    tried: tuple[TriedStrength, ...]
    chi_squared: np.ndarray
    warnings: tuple[str, ...]
    fit: Explanation = field(repr=False)
    background: float = 0.0
    background_sigma: float = 0.0
    iterations: int | None = None

    @cached_property
    def sigma(self) -> np.ndarray | None:
        """Standard error of each cell due to noise, penalty and cells; None without draws.

        float32, shape of `emission`. It does not include all of the uncertainty in depth: for a
        flame that is thick in depth, the truth is outside many error bars.
        """
        return scatter(self.draws, self.emission) if len(self.draws) else None

    @property
    def light_sigma(self) -> np.ndarray | None:
        """Standard error of the sum over each plane's cells, float64, shape (planes,), or None."""
        if not len(self.draws):
            return None
        sums = (one.sum(axis=(-2, -1), dtype=np.float64) for one in (self.draws, self.emission))
        return scatter(*sums)

    @property
    def per_mm(self) -> np.ndarray:
        """Emission per length of the line of sight: a plane's emission over the planes' distance.

        It is in radiance per mm, shape of `emission`; times 4 pi it is power per volume, if the
        light field is in radiance.

        Raises
        ------
        InputError
            If the planes are not evenly spaced.
        """
        steps = np.abs(np.diff(self.grid.depths_mm))
        if not steps.size or np.ptp(steps) > 1e-6 * steps[0]:
            raise InputError(
                f"Emission by volume needs two or more evenly spaced planes, got the depths "
                f"{list(self.grid.depths_mm)}."
            )
        return self.emission / np.float32(steps[0])
