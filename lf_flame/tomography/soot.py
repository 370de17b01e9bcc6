"""Emission, temperature and absorption of soot at depth planes, from one colour light field."""

from typing import Any

import numpy as np

from lf_flame.lightfield import LightField
from lf_flame.tomography.colour_calibration import ColourCalibration
from lf_flame.tomography.frustum_grid import FrustumGrid
from lf_flame.tomography.reconstruction_plan import ReconstructionPlan
from lf_flame.tomography.reconstruction_result import Reconstruction
from lf_flame.tomography.soot_rounds import Soot, Steps, solve_soot, split_colours


class _PlaneSteps(Steps[Reconstruction]):
    """Fits of depth planes to each colour."""

    def __init__(
        self, lights: list[LightField], plan: ReconstructionPlan, bootstrap: int, seed: int
    ):
        self._lights, self._plan = lights, plan
        self._bootstrap, self._seed = bootstrap, seed

    def first(self, c: int) -> Reconstruction:
        return self._plan.reconstruct(self._lights[c])

    def again(self, c: int, thickness: np.ndarray, last: Any) -> Reconstruction:
        return self._plan.absorbing(thickness).reconstruct(self._lights[c], start=last)

    def finish(self, thickness: np.ndarray | None, last: Any) -> tuple[Reconstruction, ...]:
        by_colour = [None] * len(self._lights) if thickness is None else thickness
        # With one strength for all colours, the effect of the penalty cancels in their ratios.
        strength = max(
            self._plan.absorbing(one).reconstruct(light).strength
            for one, light in zip(by_colour, self._lights, strict=True)
        )
        return tuple(
            self._plan.absorbing(one, strength=strength).reconstruct(
                self._lights[c],
                bootstrap=self._bootstrap,
                rng=np.random.default_rng((self._seed, c)),
                prior_rng=np.random.default_rng(self._seed),  # all colours draw the same prior
            )
            for c, one in enumerate(by_colour)
        )

    def total(self, thickness: np.ndarray) -> float:
        return float(thickness.sum(axis=0).max())


def reconstruct_soot(
    light_field: LightField,
    grid: FrustumGrid,
    calibration: ColourCalibration,
    *,
    absorbing: bool = True,
    soot_exponent: float = 1.0,
    bootstrap: int = 0,
    seed: int = 0,
    **options: Any,
) -> Soot[Reconstruction]:
    """Find emission, temperature and absorption of soot at depth planes.

    Parameters
    ----------
    light_field : LightField
        Light field of the grid's camera with a channel for each colour, linear in light, black
        subtracted, divided by the white image with which the colours were calibrated.
    grid : FrustumGrid
        Depth planes and cells, the same for all colours.
    calibration : ColourCalibration
        Gains and spectral responses of the channels.
    absorbing : bool, optional
        Whether the soot's own absorption is found and corrected. It needs gains that turn signals
        into absolute radiance, as from pictures of a furnace with stated exposures.
    soot_exponent : float, optional
        Exponent a of soot's absorption, ``wavelength^-a``, from -1 to 5.
    bootstrap : int, optional
        Number of bootstrap draws of each colour, for errors: 0, or 2 and more.
    seed : int, optional
        Seed of the bootstrap.
    **options
        Further options of `ReconstructionPlan`, for every colour.

    Returns
    -------
    Soot
        Emission of each colour corrected for absorption, temperatures in kelvin, and optical
        thickness.

    Raises
    ------
    InputError
        If light field, grid and calibration do not match, no cell is bright enough for a
        temperature, or the flame is optically too thick.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import numpy as np
    >>> from lf_flame import PAPER_CAMERA, LightField
    >>> from lf_flame.tomography import ColourCalibration, SpectralResponses
    >>> colours = SpectralResponses.single((550, 650), ("green", "red"))
    >>> calibration = ColourCalibration(colours, np.ones(2), np.zeros(2), (1200.0, 2000.0))
    >>> from lf_flame.tomography import FrustumGrid, reconstruct_soot
    >>> grid = FrustumGrid(replace(PAPER_CAMERA, views=3, lenslets=(20, 24)), [0.0])
    >>> y, x = np.mgrid[-1:1:20j, -1:1:24j]
    >>> glow = np.exp(-8 * (x**2 + y**2))[..., None] * 0.2 * colours.soot(1800.0)  # at 1800 K
    >>> light_field = LightField(np.broadcast_to(glow, (3, 3, 20, 24, 2)))
    >>> found = reconstruct_soot(light_field, grid, calibration, absorbing=False)
    >>> round(float(found.temperatures.kelvin[0, 10, 12]), -1)
    1800.0
    """
    lights = split_colours(light_field, calibration.responses.names)
    steps = _PlaneSteps(lights, ReconstructionPlan(grid, **options), bootstrap, seed)
    return solve_soot(steps, calibration, absorbing=absorbing, soot_exponent=soot_exponent)
