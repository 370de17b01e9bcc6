"""Temperature and absorption of a sooty flame together, from one colour light field.

Soot absorbs as it emits (Kirchhoff): in each colour, a cell's emission is its optical thickness
times the signal of a black body of its temperature. So with absolute gains of the colours, the
emission that was found tells the absorption, and the absorption corrects the emission. Both are
found in turn: emission in each colour, from it temperature and optical thickness, from that the
attenuation of each ray, and emission again, until the thickness stands still.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from lf_flame._common import progress
from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.tomography.absorption import MOST_THICKNESS
from lf_flame.tomography.axisymmetric.reconstruction import AxisymmetricFlame
from lf_flame.tomography.colour_calibration import ColourCalibration
from lf_flame.tomography.pyrometry import Temperatures, soot_temperature
from lf_flame.tomography.reconstruction_result import Reconstruction

MOST_ROUNDS = 20
"""Largest number of rounds; at a total thickness of 1, each leaves two fifths of the change."""

SETTLED = 2e-3
"""Largest change of the total optical thickness, in one round, at which the rounds end."""

CLIPPED = 1.25
"""Total thickness in rounds under way, relative to `MOST_THICKNESS`."""

UNSETTLED = (
    "Emission and absorption have not settled: the flame is too thick for this light field, or its "
    "colours contradict each other."
)


class Emission(Protocol):
    """Emission in one colour, as a round under way finds it."""

    @property
    def emission(self) -> np.ndarray:
        """Emission without absorption."""
        ...


Found = TypeVar("Found", bound=Reconstruction | AxisymmetricFlame)
"""Emission in one colour with error bars."""


@dataclass(frozen=True, eq=False)
class Soot(Generic[Found]):
    """Emission, temperature and absorption of a sooty flame.

    Attributes
    ----------
    colours : tuple of AxisymmetricFlame or Reconstruction
        Emission in each colour, without absorption.
    temperatures : Temperatures
        Temperatures of the soot; `Temperatures.amount` is the optical thickness at 600 nm.
    optical_thickness : ndarray of float64, shape (colours, ...)
        Absorption in each colour, by plane or by mm, as the emission.
    total_thickness : ndarray of float64, shape (colours,)
        Largest total along a ray through the flame in each colour.
    warnings : tuple of str
    """

    colours: tuple[Found, ...]
    temperatures: Temperatures
    optical_thickness: np.ndarray
    total_thickness: np.ndarray
    warnings: tuple[str, ...]


class Steps(ABC, Generic[Found]):
    """Fits and sums of one geometry that the rounds call; colours are counted from 0."""

    @abstractmethod
    def first(self, c: int) -> Emission:
        """Emission of a colour, of a flame that does not absorb."""

    @abstractmethod
    def again(self, c: int, thickness: np.ndarray, last: Any) -> Emission:
        """Emission of a colour with an optical thickness, given that of the last round."""

    @abstractmethod
    def finish(self, thickness: np.ndarray | None, last: Any) -> tuple[Found, ...]:
        """Emission of all colours, with error bars and warnings.

        The thickness is None for a flame that does not absorb.
        """

    @abstractmethod
    def total(self, thickness: np.ndarray) -> float:
        """Largest total of an optical thickness along a ray."""


def solve_soot(
    steps: Steps[Found],
    calibration: ColourCalibration,
    *,
    absorbing: bool = True,
    soot_exponent: float = 1.0,
) -> Soot[Found]:
    """Find emission, temperature and absorption of a sooty flame in turn.

    Parameters
    ----------
    steps : Steps
        Fits of one colour with a given optical thickness.
    calibration : ColourCalibration
        Absolute gains and spectral responses of the colours.
    absorbing : bool, optional
        Whether absorption is found, or emission and temperature of thin soot alone.
    soot_exponent : float, optional
        Exponent a of soot's absorption, ``wavelength^-a``, from -1 to 5.

    Returns
    -------
    Soot

    Raises
    ------
    InputError
        If no cell has a temperature, or the flame is too thick.
    """
    count = len(calibration.gains)
    if not absorbing:
        thin = steps.finish(None, None)
        known = temperatures_of(thin, calibration, soot_exponent)
        nothing = np.zeros((count, *thin[0].emission.shape))
        return Soot(thin, known, nothing, np.zeros(count), ())
    found = [steps.first(c) for c in range(count)]
    thickness = np.zeros((count, *found[0].emission.shape))
    settled = False
    for number in progress.steps(range(MOST_ROUNDS), "absorption", MOST_ROUNDS, "round"):
        if number:
            found = [steps.again(c, thickness[c], found[c]) for c in range(count)]
        fresh = _thickness(found, calibration, soot_exponent)
        highest = max(steps.total(one) for one in fresh)
        fresh *= min(1.0, CLIPPED * MOST_THICKNESS / highest)
        change = max(steps.total(one) for one in np.abs(fresh - thickness))
        thickness = fresh
        if change < SETTLED:
            settled = True
            break
    totals = np.array([steps.total(one) for one in thickness])
    if totals.max() > MOST_THICKNESS:
        name = calibration.responses.names[int(np.argmax(totals))]
        raise InputError(
            f"The flame's optical thickness must be at most {MOST_THICKNESS:g} in each colour, and "
            f"comes out at {totals.max():.2g} or more in {name}: hardly any light leaves from "
            f"behind; or the flame was exposed longer than the furnace (--exposure of "
            f"calibrate-colours), or the colours are in another order than the channels."
        )
    colours = steps.finish(thickness, found)
    temperatures = temperatures_of(colours, calibration, soot_exponent)
    return Soot(colours, temperatures, thickness, totals, () if settled else (UNSETTLED,))


def split_colours(light_field: LightField, names: Sequence[str]) -> list[LightField]:
    """Give each colour of a light field as a grey one.

    Raises
    ------
    InputError
        If the light field has another number of channels than there are names, or fewer than two.
    """
    if light_field.channels != len(names) or len(names) < 2:
        raise InputError(
            f"The light field must have a channel for each of the calibration's {len(names)} "
            f"colours ({', '.join(names)}), two or more, got {light_field.channels}."
        )
    return [
        replace(light_field, views=np.ascontiguousarray(light_field.views[..., c]))
        for c in range(len(names))
    ]


def temperatures_of(
    colours: Sequence[Found], calibration: ColourCalibration, soot_exponent: float = 1.0
) -> Temperatures:
    """Find the temperature of soot from its emission in the colours of a calibration."""
    sigmas = [one.sigma for one in colours]
    return soot_temperature(
        [one.emission for one in colours],
        calibration.responses,
        sigmas=None if any(one is None for one in sigmas) else sigmas,  # type: ignore[arg-type]
        draws=[one.draws for one in colours] if all(len(one.draws) for one in colours) else None,
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
            "See whether the calibration's colours are in another order than the channels."
        )
    # Faint cells hold little soot; they count as being as hot as the flame's bright part.
    typical = float(np.median(kelvin[known]))
    faint = ~np.isfinite(kelvin) | (bright < bright.max() / 20)
    kelvin = np.where(faint, typical, kelvin)
    shape = (-1, *[1] * kelvin.ndim)
    black = calibration.gains.reshape(shape) * calibration.responses.black_body(kelvin)
    return np.maximum(light, 0) / black
