"""Temperature of soot from its emission in two or more colours.

For optically thin soot, a volume's emission is its absorption coefficient times the radiance of a
black body (Planck; Modest, Radiative Heat Transfer, chapters on the equation of transfer and on
particulate media). The coefficient falls as a power of the wavelength; its other factors are the
same in all colours, so ratios of colours give the temperature. For single wavelengths,

    e1 / e2 = (l2 / l1)^(5 + a) (exp(c2 / (l2 T)) - 1) / (exp(c2 / (l1 T)) - 1)

and for broad colours both sides are integrals over their spectral responses
(`lf_flame.tomography.spectra`).

The result is the temperature of the soot, not of the gas. A temperature hides errors of emission:
at 1,800 K an error of 17 % is 137 K between 550 and 650 nm, and only 25 K for one calibrated
colour. Never show a temperature without the error of its emission. Emissions must be linear in
light.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from lf_flame.errors import InputError
from lf_flame.tomography.spectra import SpectralResponses, check_exponent

LEAST_K, MOST_K = 500.0, 5000.0
"""Range of temperatures in K of glowing soot; temperatures outside are treated as undetermined."""

GLOWING_K = 1000.0
"""Temperature in K above which a ratio of colours must distinguish temperatures. Colder soot glows
too little: its blue signal is leaked red, so that its ratio may be that of hotter soot."""

LEAST_LEVER_K = 30.0
"""Smallest derivative of the logarithm of a ratio of colours by 1 / T, in K, with which there is a
temperature: at 1,800 K an error of 1 % in the ratio is then 1,080 K."""

NEWTON_STEPS = 6
"""Number of Gauss-Newton steps; they start within 1e-4 of the solution of two colours."""

LEAST_SIGNAL = 3.0
"""Smallest emission with a temperature, in standard deviations of its noise."""

LEAST_ERROR = 1e-6
"""Smallest relative error of an emission in a weight, so that no weight is infinite."""


@dataclass(frozen=True, eq=False)
class Temperatures:
    """Temperatures of soot, NaN where they are undetermined.

    Attributes
    ----------
    kelvin : ndarray of float64
        Temperatures in K.
    sigma : ndarray of float64, or None
        Standard deviation in K due to the emissions' noise: scatter of draws, else linear estimate.
    amount : ndarray of float64, or None
        Emission over that of soot of this temperature with an optical thickness of 1 at 600 nm.
        With absolute gains it is the optical thickness, per mm or per plane as the emission is.
    misfit : ndarray of float64, or None
        Chi-squared of each cell over its degrees of freedom, the number of colours less two: near 1
        if soot of one temperature explains all colours. None for two colours or without errors.
    """

    kelvin: np.ndarray
    sigma: np.ndarray | None
    amount: np.ndarray | None = None
    misfit: np.ndarray | None = None


def soot_temperature(
    emissions: Sequence[ArrayLike],
    responses: SpectralResponses,
    *,
    sigmas: Sequence[ArrayLike] | None = None,
    draws: Sequence[ArrayLike] | None = None,
    gains: ArrayLike | None = None,
    soot_exponent: float = 1.0,
) -> Temperatures:
    """Find the temperature of soot from its emissions in two or more colours of a camera.

    Weighted least squares in the logarithm of the emissions, for temperature and amount of soot.

    Parameters
    ----------
    emissions : sequence of array_like, of one shape, one for each colour
        Emissions, all by volume or all by depth plane.
    responses : SpectralResponses
        Spectral responses of these colours.
    sigmas : sequence of array_like, optional
        Standard deviations of the emissions. Where an emission is not above three of its own
        standard deviations, the temperature is undetermined. Default: unknown; all colours have
        the same weight.
    draws : sequence of array_like, one for each colour, each of shape (n, ...), optional
        Bootstrap draws of the emissions, the same number in all colours and drawn together; with
        `sigmas` only. The standard deviation of a temperature is then the scatter of theirs, in
        which errors that the colours share cancel.
    gains : sequence of float, optional
        Signal of each colour over the integral of response and radiance, above 0, as
        `calibrate_colours` finds it. Default: 1 for all.
    soot_exponent : float, optional
        Exponent a in the absorption coefficient's ``wavelength^-a``, from -1 to 5.

    Returns
    -------
    Temperatures
        Temperatures in K with their errors; NaN where undetermined.

    Raises
    ------
    InputError
        If shapes or numbers differ, a value cannot be used, or no ratio of two colours
        distinguishes temperatures above 1,000 K.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.tomography import SpectralResponses, soot_temperature
    >>> nm = np.arange(400, 701, 10.0)
    >>> curves = [np.exp(-(((nm - middle) / 40) ** 2)) for middle in (460, 540, 610)]
    >>> camera = SpectralResponses(("blue", "green", "red"), nm, curves)
    >>> found = soot_temperature(camera.soot([1500.0, 1900.0]), camera)
    >>> found.kelvin.round(3).tolist()
    [1500.0, 1900.0]
    """
    check_exponent(soot_exponent)
    light, errors = _checked_emissions(emissions, sigmas, len(responses.names))
    gain = _checked_gains(gains, len(light)).reshape(-1, *[1] * (light.ndim - 1))
    curves = _LogCurves(responses, soot_exponent)
    known = np.all(light > (0.0 if errors is None else LEAST_SIGNAL * errors), axis=0)
    with np.errstate(all="ignore"):  # cells without a temperature
        relative = np.ones_like(light) if errors is None else errors / light
        weights = np.where(known, np.maximum(relative, LEAST_ERROR), 1.0) ** -2.0
        wanted = np.log(np.where(known, light / gain, 1.0))
        inverse, spread = curves.invert(wanted, weights)
        kelvin = 1 / inverse
        known &= (kelvin > curves.coldest) & (kelvin >= LEAST_K) & (kelvin <= MOST_K)
        kelvin, undetermined = np.where(known, kelvin, np.nan), np.where(known, 0.0, np.nan)
        apart, amount = curves.compare(wanted, np.where(known, inverse, 1e-3), weights)
        if errors is None:
            return Temperatures(kelvin, None, amount + undetermined)
        sigma = kelvin**2 * spread
        if draws is not None:
            drawn = [np.asarray(one, float) for one in draws]
            sigma = _scatter(drawn, gain, curves, weights, kelvin, sigma)
        freedom = len(light) - 2
        misfit = apart / freedom + undetermined if freedom else None
        return Temperatures(kelvin, sigma, amount + undetermined, misfit)


def two_colour_temperature(
    first: ArrayLike,
    second: ArrayLike,
    *,
    wavelengths_nm: tuple[float, float],
    sigmas: tuple[ArrayLike, ArrayLike] | None = None,
    soot_exponent: float = 1.0,
    calibration: float = 1.0,
) -> Temperatures:
    """Find the temperature of soot from its emissions at two wavelengths.

    Parameters
    ----------
    first, second : array_like of one shape
        Emissions at the two wavelengths, either both by volume or both by depth plane.
    wavelengths_nm : (float, float)
        Two different wavelengths in nm, from 100 to 100,000.
    sigmas : (array_like, array_like), optional
        Standard deviations of the emissions. Where an emission is not above three of its own
        standard deviations, the temperature is undetermined. Default: unknown; only emissions that
        are not above 0 are undetermined.
    soot_exponent : float, optional
        Exponent a in the absorption coefficient's ``wavelength^-a``, from -1 to 5.
    calibration : float, optional
        Camera's ratio of the first colour to the second for equal radiance in both, above 0.

    Returns
    -------
    Temperatures
        Temperatures in K with their errors; NaN where undetermined.

    Raises
    ------
    InputError
        If shapes differ or a value cannot be used.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.tomography import two_colour_temperature
    >>> nm, kelvin = np.array([550.0, 650.0]), 1800.0
    >>> green, red = nm**-6 / np.expm1(1.4387768775e7 / (nm * kelvin))  # Planck, soot as 1 / nm
    >>> found = two_colour_temperature(green, red, wavelengths_nm=(550.0, 650.0))
    >>> round(float(found.kelvin), 3)
    1800.0
    """
    if not (np.isfinite(calibration) and calibration > 0):
        raise InputError(f"calibration must be a finite number above 0, got {calibration}.")
    return soot_temperature(
        (first, second),
        SpectralResponses.single(wavelengths_nm),
        sigmas=sigmas,
        soot_exponent=soot_exponent,
        gains=(calibration, 1.0),
    )


def _scatter(
    drawn: list[np.ndarray], gain: np.ndarray, curves: _LogCurves, weights: np.ndarray,
    kelvin: np.ndarray, sigma: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Root-mean-square distance of the draws' temperatures, or `sigma` where most have none."""
    if {one.shape for one in drawn} != {(len(drawn[0]), *kelvin.shape)} or len(drawn) != len(gain):
        raise InputError(
            f"draws must be as many for each of the {len(gain)} colours, each of the emissions' "
            f"shape {kelvin.shape}, got {[one.shape for one in drawn]}."
        )
    squares, counts = np.zeros_like(kelvin), np.zeros(kelvin.shape, int)
    for number in range(len(drawn[0])):
        one = np.stack([colour[number] for colour in drawn])
        known = np.all(one > 0, axis=0)
        inverse, _ = curves.invert(np.log(np.where(known, one / gain, 1.0)), weights)
        squares += np.where(known, np.square(1 / inverse - kelvin), 0.0)
        counts += known
    enough = counts > len(drawn[0]) / 2
    return np.where(enough, np.sqrt(squares / np.maximum(counts, 1)), sigma)


def _checked_emissions(
    emissions: Sequence[ArrayLike], sigmas: Sequence[ArrayLike] | None, colours: int
) -> tuple[np.ndarray, np.ndarray | None]:
    light = [np.asarray(one, float) for one in emissions]
    errors = None if sigmas is None else [np.asarray(one, float) for one in sigmas]
    shapes = {one.shape for one in (*light, *(errors or []))}
    if len(shapes) > 1:
        raise InputError(f"Emissions and their errors need one shape, got {sorted(shapes)}.")
    if len(light) != colours or colours < 2 or (errors is not None and len(errors) != colours):
        raise InputError(
            f"A temperature needs emissions in two colours or more, one for each of the "
            f"{colours} spectral responses, got {len(light)}."
        )
    return np.stack(light), None if errors is None else np.stack(errors)


def _checked_gains(gains: ArrayLike | None, colours: int) -> np.ndarray:
    given = np.ones(colours) if gains is None else np.asarray(gains, float)
    if given.shape != (colours,) or not np.all((given > 0) & (given < np.inf)):
        raise InputError(
            f"gains must be {colours} finite numbers above 0, one for each colour, got "
            f"{given.tolist()}."
        )
    return given


def least_temperature(responses: SpectralResponses, soot_exponent: float = 1.0) -> float:
    """Lowest temperature in K, 500 or more, whose colours no higher temperature has."""
    return max(LEAST_K, _LogCurves(responses, soot_exponent).coldest)


class _LogCurves:
    """Logarithm of soot's light in each colour as a function of 1 / T."""

    def __init__(self, responses: SpectralResponses, exponent: float):
        inverse = np.linspace(1 / (4 * MOST_K), 2 / LEAST_K, 1025)
        logs = np.log(responses.soot(1 / inverse, exponent))
        self._curves = [CubicSpline(inverse, one) for one in logs]
        self._outer, count = _best_pair(inverse, logs, responses.names)
        self.inverse = inverse[:count]
        self._ratio = logs[self._outer[0], :count] - logs[self._outer[1], :count]
        self.coldest = 1 / self.inverse[-1]

    def invert(self, wanted: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Find 1 / T and its standard deviation, if weights are those of inverse variances."""
        low, high = self.inverse[0], self.inverse[-1]
        ratio = wanted[self._outer[0]] - wanted[self._outer[1]]
        inverse = np.interp(ratio, self._ratio[::-1], self.inverse[::-1])
        for _ in range(NEWTON_STEPS):
            rest = _centred(wanted - np.stack([one(inverse) for one in self._curves]), weights)
            slopes, curvature = self._slopes(inverse, weights)
            step = np.sum(weights * slopes * rest, axis=0) / curvature
            inverse = np.clip(inverse + step, low, high)
        return inverse, self._slopes(inverse, weights)[1] ** -0.5

    def _slopes(self, inverse: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Slopes of the curves less their weighted mean, and the sum of their weighted squares."""
        slopes = np.stack([one(inverse, 1) for one in self._curves])
        slopes = _centred(slopes, weights)
        return slopes, np.sum(weights * slopes**2, axis=0)

    def compare(
        self, wanted: np.ndarray, inverse: np.ndarray, weights: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Chi-squared of soot at 1 / T, and its amount."""
        rest = wanted - np.stack([one(inverse) for one in self._curves])
        mean = np.sum(weights * rest, axis=0) / np.sum(weights, axis=0)
        return np.sum(weights * (rest - mean) ** 2, axis=0), np.exp(mean)


def _best_pair(
    inverse: np.ndarray, logs: np.ndarray, names: Sequence[str]
) -> tuple[tuple[int, int], int]:
    """Colours whose ratio changes most with temperature, and for how many values of 1 / T."""
    levers = {
        (blue, red): -np.diff(logs[blue] - logs[red]) / np.diff(inverse)
        for blue, red in permutations(range(len(logs)), 2)
    }
    glowing = inverse[1:] <= 1 / GLOWING_K
    pair = max(levers, key=lambda one: levers[one][glowing].min())
    weak = np.flatnonzero(~(levers[pair] >= LEAST_LEVER_K))
    if weak.size and glowing[weak[0]]:
        above = f"only above {1 / inverse[weak[0]]:.0f} K" if weak[0] else "nowhere"
        raise InputError(
            f"The ratio of {names[pair[0]]} to {names[pair[1]]} must increase with the temperature "
            f"of soot above {GLOWING_K:g} K, but does so {above}: these colours see nearly the "
            f"same light, or {names[pair[0]]} lets too much red or infrared through."
        )
    return pair, int(weak[0]) + 1 if weak.size else len(inverse)


def _centred(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Subtract the weighted mean over the colours: the amount of soot drops out."""
    return values - np.sum(weights * values, axis=0) / np.sum(weights, axis=0)
