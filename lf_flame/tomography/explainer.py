"""Model of a light field: emission, absorption, and a uniform background; and what it leaves."""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from pylops import LinearOperator

from lf_flame._common import progress
from lf_flame.errors import InputError
from lf_flame.tomography.absorption import Absorption
from lf_flame.tomography.background import Level, fit_background, measure_edge
from lf_flame.tomography.data_checks import (
    FIT_EVEN,
    UNEVEN,
    check_data,
    check_overlap,
    check_spacing,
)
from lf_flame.tomography.error_bars import Expected, noise_variance, redraw
from lf_flame.tomography.explanation import Explanation
from lf_flame.tomography.plane_fit import PlaneFit
from lf_flame.tomography.reconstruction_result import Reconstruction

BACKGROUND_FITS = 4
"""Largest number of fits, of background and emission in turn; two are usual."""

FAINT = 0.0, 0.001, 0.01
"""Emission relative to the brightest cell up to which a cell counts as dark in a background fit;
the values are tried in turn until enough pixels are dark."""

LEAST_DARK = 0.02
"""Smallest fraction of dark pixels with which a background is fitted."""

UNSETTLED = (
    "The correction for absorption has not converged: emission and optical thickness are "
    "inconsistent, or the thickness is too large."
)


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


class Fitted(NamedTuple):
    """Views without background, and their fit.

    Attributes
    ----------
    views : ndarray of float32, shape (v, u, t, s)
        Views that were fitted, averaged over blocks.
    level : Level
        Background that was subtracted.
    found : Explanation
        Light that explains the views.
    seen : ndarray of float32, shape of `views`
        Views of that light.
    valid : ndarray of bool, shape of `views`, or None
        Whether each ray is known; None if all are.
    """

    views: np.ndarray
    level: Level
    found: Explanation
    seen: np.ndarray
    valid: np.ndarray | None

    @property
    def known(self) -> np.ndarray:
        """Views, with the light of the fit for unknown rays."""
        return self.views if self.valid is None else np.where(self.valid, self.views, self.seen)

    @property
    def residual(self) -> np.ndarray:
        """Part of the views that the fit does not explain."""
        return self.known - self.seen

    @property
    def chi_squared(self) -> np.ndarray:
        """Mean squared residual of each fitted view, in units of the noise's variance."""
        power = np.square(self.residual, dtype=np.float64).sum(axis=(2, 3))
        rays = np.prod(self.views.shape[2:]) if self.valid is None else self.valid.sum(axis=(2, 3))
        with np.errstate(invalid="ignore"):  # of a view of which nothing is known
            return power / rays / noise_variance(self.found.noise)

    def disagreements(self, result: Reconstruction, *, stated: bool, even: bool) -> tuple[str, ...]:
        """Sentences on disagreements of data and model.

        stated: whether the noise was stated; even: whether an even background was fitted.
        """
        found = self.found
        return (
            *check_data(
                self.known,
                result.chi_squared,
                found.noise,
                found.measured,
                stated,
                residual=self.residual,
                correlation=found.shared,
                advice=UNEVEN if even else FIT_EVEN,
            ),
            *check_spacing(result.grid),
            *(check_overlap(result.grid, result.emission) if len(result.draws) else ()),
            *(() if found.settled else (UNSETTLED,)),
        )


def draw_again(
    fit: PlaneFit,
    fitted: Fitted,
    correction: np.ndarray,
    count: int,
    rng: np.random.Generator,
    prior_rng: np.random.Generator,
) -> Iterator[np.ndarray]:
    """Fit light fields with redrawn noise, each with a correction of its own (bootstrap)."""
    if not count:
        return
    found, few = fitted.found, max(1, fit.options.iterations // 2)
    expected = Expected(
        fit.smooth(found.cells + correction),
        found.pixel_noise,
        fitted.level.error,
        fit.prior(found, fitted.seen),
    )
    redrawn = redraw(fit.operator, fit.gram, expected, count, rng, prior_rng)
    for problem in progress.steps(redrawn, "error bars", count, "draw"):
        drawn = found.with_fit(fit.again(problem, found, few))
        if not fit.options.penalty.corrects:
            yield drawn.cells
            continue
        # The correction of each draw is multiplied by any number from 0 to 2 with equal probability
        # (JCGM 100, 4.3.7), because the remaining error of the correction is unknown.
        yield drawn.cells + prior_rng.uniform(0, 2) * fit.correct(drawn, few)
