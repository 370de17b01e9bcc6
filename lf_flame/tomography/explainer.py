"""Model of a light field: emission, absorption, and a uniform background."""

from dataclasses import replace

import numpy as np
from pylops import LinearOperator

from lf_flame.errors import InputError
from lf_flame.tomography.absorption import Absorption
from lf_flame.tomography.background import Level, fit_background, measure_edge
from lf_flame.tomography.explanation import Explanation
from lf_flame.tomography.plane_fit import PlaneFit

BACKGROUND_FITS = 4
"""Largest number of fits, of background and emission in turn; two are usual."""

FAINT = 0.0, 0.001, 0.01
"""Emission relative to the brightest cell up to which a cell counts as dark in a background fit;
the values are tried in turn until enough pixels are dark."""

LEAST_DARK = 0.02
"""Smallest fraction of dark pixels with which a background is fitted."""


class Explainer:
    """Explains light fields by emission on a grid's depth planes, with or without absorption.

    Parameters
    ----------
    fit : PlaneFit
    absorption : Absorption, optional
        Absorption by the grid's cells. Default: none.

    Attributes
    ----------
    leaves : ndarray of float32, shape (planes, 1, 1) or (planes, rows, columns)
        Fraction of each pixel's emission that leaves towards the camera.
    """

    def __init__(self, fit: PlaneFit, absorption: Absorption | None = None):
        self._fit, self._grid, self._absorption = fit, fit.gram.grid, absorption
        self.leaves = np.ones((self._grid.shape[0], 1, 1), np.float32)
        if absorption is not None:
            self.leaves = self._grid.crop(absorption.transmission)

    def __call__(self, views: np.ndarray) -> Explanation:
        """Fit, and fit again until the correction for absorption converges."""
        if self._absorption is None:
            return self._fit.explain(views)
        found, settled = self._absorption.settle(views, self._fit.explain, self._fit.start)
        return replace(found, settled=settled)

    def emission(self, cells: np.ndarray) -> np.ndarray:
        """Emission of the central view's pixels, for the light that leaves each cell."""
        return np.ascontiguousarray(self._grid.crop(cells) / self.leaves)

    @property
    def error_factor(self) -> np.ndarray:
        """Factor by which absorption raises the rms error of each plane, shape (planes,)."""
        return np.sqrt(np.mean(np.square(1 / self.leaves, dtype=np.float64), axis=(1, 2)))

    @property
    def operator(self) -> LinearOperator:
        """Linear operator from the light that leaves each cell to the views, both flat."""
        return self._fit.operator if self._absorption is None else self._absorption.operator

    def seen(self, cells: np.ndarray) -> np.ndarray:
        """Light field for the light that leaves each cell, shape (v, u, t, s)."""
        return self.operator.matvec(cells.ravel()).reshape(self._fit.operator.dimsd)

    def level(self, views: np.ndarray) -> Level:
        """Find a uniform background: first at the field's edge, then where no emission reaches.

        Raises
        ------
        InputError
            If emission reaches nearly all of the field.
        """
        edge = measure_edge(views)
        level = Level(edge.level, edge.error)
        for _ in range(BACKGROUND_FITS):
            rest = views - np.float32(level.mean)
            more = fit_background(rest, self._dark(self._fit.explain(rest).cells))
            level = Level(level.mean + more.mean, more.error)
            if abs(more.mean) <= more.error:
                break
        return level

    def _dark(self, cells: np.ndarray) -> np.ndarray:
        """Find the pixels that no emission reaches, or none but faint emission."""
        for share in FAINT:
            lit = self.seen((cells > share * cells.max()).astype(np.float32)) > 0
            if lit.mean() <= 1 - LEAST_DARK:
                return ~lit if self._fit.valid is None else ~lit & self._fit.valid
        raise InputError(
            f"background='fit' needs a part of the field that no emission reaches, and "
            f"{lit.mean():.1%} of the pixels are lit."
        )
