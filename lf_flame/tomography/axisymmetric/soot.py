"""Temperature and absorption of an axisymmetric sooty flame, from one colour light field."""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from lf_flame.lightfield import LightField
from lf_flame.tomography.axisymmetric.absorption import AbsorbingSection
from lf_flame.tomography.axisymmetric.grid import AxisymmetricGrid
from lf_flame.tomography.axisymmetric.operator import AxisymmetricOperator
from lf_flame.tomography.axisymmetric.reconstruction import (
    AxisymmetricFlame,
    Looked,
    check_fit_options,
    explain_views,
    look_at,
)
from lf_flame.tomography.axisymmetric.section_fit import SectionFit
from lf_flame.tomography.colour_calibration import ColourCalibration
from lf_flame.tomography.data_checks import check_range
from lf_flame.tomography.soot_rounds import Emission, Soot, Steps, solve_soot, split_colours


class _Round(NamedTuple):
    """Emission without error bars, in a round under way."""

    emission: np.ndarray


class _AbsorbingFit:
    """Fits of one colour to a light field, corrected for absorption.

    If every ray saw a node's mean transmission, a fit in which light only adds up would explain the
    light field by emission times that mean. Single rays differ from it; that difference is
    subtracted from the views before a fit, as in `lf_flame.tomography.absorption.Absorption`.
    """

    def __init__(
        self,
        looked: Looked,
        noise: float | None,
        strength: float | None,
        seed: tuple[int, int],
    ):
        self._looked, self._noise, self._strength = looked, noise, strength
        self._rng, self._seed = np.random.default_rng(seed), seed
        self._operator = AxisymmetricOperator(looked.grid)
        self._fit = SectionFit(looked.grid, looked.views, noise, self._rng)
        self._thin = self._fit.solve(strength)

    @property
    def strength(self) -> float:
        """Strength of the penalty."""
        return self._thin.options.strength

    def use(self, strength: float) -> None:
        """Fit with a strength."""
        self._strength = strength
        self._thin = self._fit.solve(strength)

    def first(self) -> _Round:
        """Emission of a flame that does not absorb."""
        return _Round(self._thin.cells[0])

    def again(self, absorption: np.ndarray, last: _Round) -> _Round:
        """Emission with an absorption, given the emission of the round before."""
        excess, leaves = self._excess(absorption, last.emission)
        start = self._thin._replace(cells=(last.emission * leaves)[np.newaxis])
        return _Round(self._fit.solve_for(self._looked.views - excess, start)[0] / leaves)

    def finish(
        self,
        absorption: np.ndarray | None,
        last: _Round | None,
        bootstrap: int,
    ) -> AxisymmetricFlame:
        """Emission with error bars and warnings."""
        fit, leaves = self._fit, np.ones(self._looked.grid.shape)
        if absorption is not None and last is not None:
            excess, leaves = self._excess(absorption, last.emission)
            views = (self._looked.views - excess).astype(np.float32)
            fit = SectionFit(self._looked.grid, views, self._noise, self._rng)
        found = explain_views(
            self._looked,
            fit,
            self._strength,
            stated=self._noise is not None,
            bootstrap=bootstrap,
            rng=self._rng,
            of_prior=np.random.default_rng(self._seed[0]),
        )
        return replace(
            found,
            emission=(found.emission / leaves).astype(np.float32),
            draws=(found.draws / leaves).astype(np.float32),
        )

    def _excess(
        self, absorption: np.ndarray, emission: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Light of single rays beyond that with the mean transmission, and that transmission."""
        absorbing = AbsorbingSection(self._looked.grid, absorption)
        leaves = absorbing.mean_transmission()
        leaving = self._operator.matvec((emission * leaves).ravel())
        excess = absorbing.matvec(emission.ravel()) - leaving
        return excess.reshape(self._looked.views.shape), leaves


class _SectionSteps(Steps[AxisymmetricFlame]):
    """Fits of half sections to each colour."""

    def __init__(self, fits: list[_AbsorbingFit], step_mm: float, bootstrap: int):
        self._fits, self._step_mm, self._bootstrap = fits, step_mm, bootstrap
        # With one strength for all colours, the effect of the penalty cancels in their ratios.
        strength = max(one.strength for one in fits)
        for one in fits:
            one.use(strength)

    def first(self, c: int) -> Emission:
        return self._fits[c].first()

    def again(self, c: int, thickness: np.ndarray, last: Any) -> Emission:
        return self._fits[c].again(thickness, last)

    def finish(self, thickness: np.ndarray | None, last: Any) -> tuple[AxisymmetricFlame, ...]:
        nothing = [None] * len(self._fits)
        every = (nothing, nothing) if thickness is None else (thickness, last)
        return tuple(
            one.finish(by_mm, before, self._bootstrap)
            for one, by_mm, before in zip(self._fits, *every, strict=True)
        )

    def total(self, thickness: np.ndarray) -> float:
        return float(2 * thickness.sum(axis=1).max() * self._step_mm)


def reconstruct_axisymmetric_soot(
    light_field: LightField,
    grid: AxisymmetricGrid,
    calibration: ColourCalibration,
    *,
    absorbing: bool = True,
    soot_exponent: float = 1.0,
    noise: float | None = None,
    strength: float | None = None,
    bootstrap: int = 0,
    seed: int = 0,
) -> Soot[AxisymmetricFlame]:
    """Find emission, temperature and absorption of an axisymmetric sooty flame.

    Parameters
    ----------
    light_field, calibration, absorbing, soot_exponent, bootstrap, seed
        As for `reconstruct_soot`.
    grid : AxisymmetricGrid
        Nodes of the half section, the same for all colours.
    noise, strength : float, optional
        As for `reconstruct_axisymmetric`, for every colour.

    Returns
    -------
    Soot
        Emission of each colour without absorption, temperatures, and optical thickness.

    Raises
    ------
    InputError
        If light field, grid and calibration do not match, no cell has a temperature, or the flame
        is too thick.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import numpy as np
    >>> from lf_flame import PAPER_CAMERA, LightField
    >>> from lf_flame.tomography import ColourCalibration, SpectralResponses
    >>> colours = SpectralResponses.single((550, 650), ("green", "red"))
    >>> calibration = ColourCalibration(colours, np.ones(2), np.zeros(2), (1200.0, 2000.0))
    >>> from lf_flame.tomography import AxisymmetricGrid, AxisymmetricOperator
    >>> camera = replace(PAPER_CAMERA, views=3, lenslets=(24, 40))
    >>> grid = AxisymmetricGrid(camera, axis_mm=0.0, depth_mm=0.0, radius_mm=1.5)
    >>> soot = 0.02 * np.outer(np.ones(grid.shape[0]), np.exp(-4 * grid.radii_mm**2))
    >>> glow = soot.ravel() * colours.soot(1800.0)[:, None]
    >>> operator = AxisymmetricOperator(grid)
    >>> views = [np.reshape(operator @ one, operator.dimsd) for one in glow]
    >>> from lf_flame.tomography import reconstruct_axisymmetric_soot
    >>> light_field = LightField(np.stack(views, axis=-1))
    >>> found = reconstruct_axisymmetric_soot(light_field, grid, calibration, absorbing=False)
    >>> round(float(found.temperatures.kelvin[12, 0]), -1)
    1800.0
    """
    check_fit_options(noise, strength, bootstrap)
    fits = []
    for c, one in enumerate(split_colours(light_field, calibration.responses.names)):
        looked = look_at(one, grid)
        check_range(looked.views, noise)
        fits.append(_AbsorbingFit(looked, noise, strength, (seed, c)))
    steps = _SectionSteps(fits, grid.step_mm, bootstrap)
    return solve_soot(steps, calibration, absorbing=absorbing, soot_exponent=soot_exponent)
