"""Temperature and absorption of a sooty flame together, from one colour light field.

Soot absorbs as it emits (Kirchhoff): in each colour, a cell's emission is its optical thickness
times the signal of a black body of its temperature. With absolute gains of the colours, emission
therefore gives the absorption, and the absorption corrects the emission. Both are found in turn:
emission in each colour, from it temperature and optical thickness, from that the attenuation of
each ray, and emission again, until the optical thickness converges.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lf_flame._common import progress
from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.tomography.absorption import MOST_THICKNESS, total_thickness
from lf_flame.tomography.axisymmetric_grid import AxisymmetricGrid
from lf_flame.tomography.colour_calibration import ColourCalibration
from lf_flame.tomography.emission import Emission
from lf_flame.tomography.frustum_grid import FrustumGrid
from lf_flame.tomography.pyrometry import Temperatures, soot_temperature
from lf_flame.tomography.reconstruction import ReconstructionPlan

MOST_ROUNDS = 30
"""Largest number of rounds; at a total thickness of 1, each leaves about half of the change."""

SETTLED = 2e-3
"""Largest change of the total optical thickness, in one round, at which the rounds end."""

UNSETTLED = (
    "Emission and absorption have not converged: the flame is too thick for this light field, or "
    "its colours contradict each other."
)


@dataclass(frozen=True, eq=False)
class Soot:
    """Emission, temperature and absorption of a sooty flame.

    Attributes
    ----------
    colours : tuple of Emission
        Emission in each colour, corrected for absorption if that was found.
    temperatures : Temperatures
        Temperatures of the soot; `Temperatures.amount` is the optical thickness at 600 nm.
    optical_thickness : ndarray of float64, shape (colours, ...)
        Absorption in each colour, by plane or by mm, as the emission.
    total_thickness : ndarray of float64, shape (colours,)
        Largest total along a ray in each colour; in a section, along a ray through the axis.
    warnings : tuple of str
    """

    colours: tuple[Emission, ...]
    temperatures: Temperatures
    optical_thickness: np.ndarray
    total_thickness: np.ndarray
    warnings: tuple[str, ...]


def reconstruct_soot(
    light_field: LightField,
    grid: FrustumGrid | AxisymmetricGrid,
    calibration: ColourCalibration,
    *,
    absorbing: bool = True,
    soot_exponent: float = 1.0,
    bootstrap: int = 0,
    seed: int = 0,
    **options: Any,
) -> Soot:
    """Find emission, temperature and absorption of soot, on planes or of an axisymmetric flame.

    Parameters
    ----------
    light_field : LightField
        Light field of the grid's camera with a channel for each colour, linear in light, black
        subtracted, divided by the white image with which the colours were calibrated.
    grid : FrustumGrid or AxisymmetricGrid
        Depth planes and cells, or nodes of the half section, the same for all colours.
    calibration : ColourCalibration
        Gains and spectral responses of the channels.
    absorbing : bool, optional
        Whether the soot's own absorption is found and corrected. It needs gains that turn signals
        into absolute radiance, as from pictures of a furnace with stated exposures.
    soot_exponent : float, optional
        Exponent a of soot's absorption, ``wavelength^-a``, from -1 to 5.
    bootstrap : int, optional
        Number of bootstrap draws of each colour, for errors: 0, or 2 or more.
    seed : int, optional
        Seed of the bootstrap.
    **options
        Further options of `ReconstructionPlan`, for every colour, but no optical thickness.

    Returns
    -------
    Soot
        Emission of each colour corrected for absorption, temperatures in kelvin, and optical
        thickness.

    Raises
    ------
    InputError
        If light field, grid and calibration do not match, no cell is bright enough for a
        temperature, the flame is optically too thick, or an optical thickness is stated.

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
    if options.get("optical_thickness") is not None:
        raise InputError("optical_thickness cannot be stated for soot, for which it is found.")
    lights = split_colours(light_field, calibration.responses.names)
    plan = ReconstructionPlan(grid, **options)
    found = [plan.reconstruct(light) for light in lights]
    for name, one in zip(calibration.responses.names, found, strict=True):
        if any(check.name == "light" and check.failed for check in one.checks):
            raise InputError(f"The light field contains no light above its noise in {name}.")
    # With one strength for all colours, the effect of the penalty cancels in their ratios.
    strength = max(one.strength for one in found)
    thickness, settled = np.zeros((len(lights), *found[0].emission.shape)), True
    if absorbing:
        thickness, settled = _settle(plan, lights, found, calibration, soot_exponent)
    colours = tuple(
        plan.absorbing(tau if absorbing else None, strength=strength).reconstruct(
            light,
            bootstrap=bootstrap,
            rng=np.random.default_rng((seed, c)),
            prior_rng=np.random.default_rng(seed),  # all colours draw the same prior
        )
        for c, (tau, light) in enumerate(zip(thickness, lights, strict=True))
    )
    temperatures = _temperatures(colours, calibration, soot_exponent)
    totals = np.array([total_thickness(grid, one) for one in thickness])
    return Soot(colours, temperatures, thickness, totals, () if settled else (UNSETTLED,))


def _settle(
    plan: ReconstructionPlan,
    lights: Sequence[LightField],
    found: Sequence[Emission],
    calibration: ColourCalibration,
    soot_exponent: float,
) -> tuple[np.ndarray, bool]:
    """Find the optical thickness in each colour, and whether it has converged."""
    thickness, grid = np.zeros((len(lights), *found[0].emission.shape)), plan.grid
    for number in progress.steps(range(MOST_ROUNDS), "absorption", MOST_ROUNDS, "round"):
        if number:
            found = [
                plan.absorbing(tau).reconstruct(light, start=last, fits=1)
                for tau, light, last in zip(thickness, lights, found, strict=True)
            ]
        fresh = _thickness(found, calibration, soot_exponent)
        totals = [total_thickness(grid, one) for one in fresh]
        # A round may exceed the limit of the fit on the way.
        fresh *= min(1.0, (1 - 1e-6) * MOST_THICKNESS / max(*totals, 1e-300))
        change = max(total_thickness(grid, one) for one in np.abs(fresh - thickness))
        thickness = fresh
        if change < SETTLED:
            break
    if max(totals) > MOST_THICKNESS:
        raise InputError(
            f"The flame's optical thickness must be at most {MOST_THICKNESS:g} in each colour, but "
            f"comes out at {max(totals):.2g} or more in "
            f"{calibration.responses.names[int(np.argmax(totals))]}: almost no light leaves from "
            f"behind; or the flame was exposed longer than the furnace (--exposure of "
            f"calibrate-colours), or the colours are in another order than the channels."
        )
    return thickness, change < SETTLED


def split_colours(light_field: LightField, names: Sequence[str]) -> list[LightField]:
    """Split a light field into grey ones, one for each name; refuse another number of colours."""
    if light_field.channels != len(names) or len(names) < 2:
        raise InputError(
            f"The light field must have a channel for each of the calibration's {len(names)} "
            f"colours ({', '.join(names)}), two or more, got {light_field.channels}."
        )
    return [
        replace(light_field, views=np.ascontiguousarray(light_field.views[..., c]))
        for c in range(len(names))
    ]


def _temperatures(
    colours: Sequence[Emission], calibration: ColourCalibration, soot_exponent: float
) -> Temperatures:
    """Temperature of soot from its emission in the colours of a calibration."""
    bars = all(len(one.draws) for one in colours)
    return soot_temperature(
        [one.emission for one in colours],
        calibration.responses,
        sigmas=[one.sigma for one in colours] if bars else None,  # type: ignore[misc]
        draws=[one.draws for one in colours] if bars else None,
        gains=calibration.gains,
        soot_exponent=soot_exponent,
    )


def _thickness(
    found: Sequence[Emission], calibration: ColourCalibration, soot_exponent: float
) -> np.ndarray:
    """Optical thickness of each cell in each colour, float64, shape (colours, ...)."""
    light = np.stack([one.emission for one in found]).astype(float)
    kelvin = soot_temperature(
        list(light), calibration.responses, gains=calibration.gains, soot_exponent=soot_exponent
    ).kelvin
    bright = light.sum(axis=0)
    known = np.isfinite(kelvin) & (bright > bright.max() / 5)
    if not known.any():
        raise InputError(
            "No bright cell has a temperature: the ratios of the colours are not those of soot. "
            "Check whether the calibration's colours are in another order than the channels."
        )
    # Faint cells have little soot; they are assumed to be as hot as the flame's bright part.
    typical = float(np.median(kelvin[known]))
    faint = ~np.isfinite(kelvin) | (bright < bright.max() / 20)
    kelvin = np.where(faint, typical, kelvin)
    # A cell that noise makes cold would otherwise have all of the flame's thickness.
    kelvin = np.clip(kelvin, kelvin[known].min(), kelvin[known].max())
    shape = (-1, *[1] * kelvin.ndim)
    black = calibration.gains.reshape(shape) * calibration.responses.black_body(kelvin)
    return np.maximum(light, 0) / black
