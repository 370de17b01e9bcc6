"""Temperature and absorption of an axisymmetric sooty flame, from one colour light field."""

from dataclasses import replace
from typing import Any

import numpy as np

from lf_flame.lightfield import LightField
from lf_flame.tomography.axisymmetric.absorption import AbsorbingSection
from lf_flame.tomography.axisymmetric.grid import AxisymmetricGrid
from lf_flame.tomography.axisymmetric.operator import AxisymmetricOperator
from lf_flame.tomography.axisymmetric.reconstruction import (
    AxisymmetricFlame,
    reconstruct_axisymmetric,
)
from lf_flame.tomography.colour_calibration import ColourCalibration
from lf_flame.tomography.soot import Soot, solve_soot, split_colours


class _AbsorbingFit:
    """Fits of one colour to a light field, corrected for absorption."""

    def __init__(
        self, light_field: LightField, grid: AxisymmetricGrid, options: dict[str, Any], seed: int
    ):
        self._light_field, self._grid, self._options = light_field, grid, options
        self._seed = seed
        self._operator = AxisymmetricOperator(grid)

    def __call__(
        self, absorption: np.ndarray | None, last: AxisymmetricFlame | None, bars: bool
    ) -> AxisymmetricFlame:
        options = dict(self._options)
        if not bars:
            options["bootstrap"] = 0
        if absorption is None or last is None:
            return self._fit(self._light_field, options)
        absorbing = AbsorbingSection(self._grid, absorption)
        leaves = absorbing.mean_transmission()
        emission = last.emission.ravel().astype(float)
        # What single views see differs from the mean transmission; that is taken off beforehand.
        excess = absorbing.matvec(emission) - self._operator.matvec(emission * leaves.ravel())
        views = self._light_field.views - excess.reshape(self._grid.view_shape)
        options["strength"] = last.strength
        found = self._fit(replace(self._light_field, views=views), options)
        return replace(
            found,
            emission=(found.emission / leaves).astype(np.float32),
            draws=(found.draws / leaves).astype(np.float32),
        )

    def _fit(self, light_field: LightField, options: dict) -> AxisymmetricFlame:
        return reconstruct_axisymmetric(light_field, self._grid, rng=self._seed, **options)


def reconstruct_axisymmetric_soot(
    light_field: LightField,
    grid: AxisymmetricGrid,
    calibration: ColourCalibration,
    *,
    absorbing: bool = True,
    soot_exponent: float = 1.0,
    bootstrap: int = 0,
    seed: int = 0,
    **options: Any,
) -> Soot[AxisymmetricFlame]:
    """Find emission, temperature and absorption of an axisymmetric sooty flame.

    Parameters
    ----------
    light_field : LightField
        Light field of the grid's camera with a channel for each colour, linear in light, black
        subtracted, divided by the white image with which the colours were calibrated.
    grid : AxisymmetricGrid
        Nodes of the half section, the same for all colours.
    calibration : ColourCalibration
        Gains and spectral responses of the channels.
    absorbing : bool, optional
        Whether the soot's own absorption is found and corrected; it needs absolute gains.
    soot_exponent : float, optional
        Exponent a of soot's absorption, ``wavelength^-a``, from -1 to 5.
    bootstrap : int, optional
        Number of bootstrap draws of each colour, for errors: 0, or 2 and more.
    seed : int, optional
        Seed of the draws.
    **options
        ``noise`` and ``strength`` of `reconstruct_axisymmetric`, for every colour.

    Returns
    -------
    Soot

    Raises
    ------
    InputError
        If light field, grid and calibration do not match, no cell has a temperature, or the flame
        is too thick.
    """
    fits = [
        _AbsorbingFit(one, grid, {**options, "bootstrap": bootstrap}, seed + c)
        for c, one in enumerate(split_colours(light_field, calibration))
    ]

    def fit(
        c: int, absorption: np.ndarray | None, last: AxisymmetricFlame | None, bars: bool
    ) -> AxisymmetricFlame:
        return fits[c](absorption, last, bars)

    def total(absorption: np.ndarray) -> float:
        return float(2 * absorption.sum(axis=1).max() * grid.step_mm)

    return solve_soot(fit, total, calibration, absorbing=absorbing, soot_exponent=soot_exponent)
