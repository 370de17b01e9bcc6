"""Temperature of soot from its emission in two colours.

For optically thin soot, a volume's emission is its absorption coefficient times the radiance of a
black body (Planck; Modest, Radiative Heat Transfer, chapters on the equation of transfer and on
particulate media). The coefficient falls as a power of the wavelength; its other factors cancel in
the ratio of two colours:

    e1 / e2 = (l2 / l1)^(5 + a) (exp(c2 / (l2 T)) - 1) / (exp(c2 / (l1 T)) - 1)

The result is the temperature of the soot, not of the gas. A temperature hides errors of emission:
at 1,800 K an error of 17 % is 137 K between 550 and 650 nm, and only 25 K for one calibrated
colour. Never show a temperature without the error of its emission. Emissions must be linear in
light, and of single wavelengths.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lf_flame.errors import InputError

SECOND_RADIATION_MM_K = 14.387768775
"""Second radiation constant c2 = h c / k in mm K (CODATA 2018, exact)."""

LEAST_K, MOST_K = 500.0, 5000.0
"""Range of temperatures in K of glowing soot; temperatures outside count as undetermined."""

LEAST_NM, MOST_NM = 100.0, 1e5
"""Range of wavelengths in nm; a value such as 0.55 would be in micrometres, and is refused."""

LEAST_EXPONENT, MOST_EXPONENT = -1.0, 5.0
"""Range of the exponent a of soot's absorption; measured ones are between 0.7 and 3."""

SINGLE_WAVELENGTHS = (
    "Each colour is taken for light of a single wavelength. Through broad filters, as of a colour "
    "camera (Bayer), temperatures are off by tens to hundreds of kelvin."
)

NEWTON_STEPS = 8
"""Number of Newton steps from Wien's approximation; three suffice below 5,000 K and 10
micrometres."""

LEAST_SIGNAL = 3.0
"""Smallest emission with a ratio, in standard deviations of its noise."""


@dataclass(frozen=True, eq=False)
class Temperatures:
    """Temperatures of soot, NaN where they are undetermined.

    Attributes
    ----------
    kelvin : ndarray of float64
        Temperatures in K.
    sigma : ndarray of float64, or None
        Standard deviation in K due to the emissions' noise, linearly propagated.
    relative_error : ndarray of float64, or None
        Relative standard deviation of the ratio of the emissions, which a temperature hides.
    """

    kelvin: np.ndarray
    sigma: np.ndarray | None
    relative_error: np.ndarray | None


def emission_ratio(
    kelvin: ArrayLike, wavelengths_nm: tuple[float, float], soot_exponent: float = 1.0
) -> np.ndarray:
    """Ratio of soot's emission at the first wavelength to that at the second.

    Parameters
    ----------
    kelvin : array_like
        Temperature of the soot in K, above 0.
    wavelengths_nm : (float, float)
        Two different wavelengths in nm, from 100 to 100,000.
    soot_exponent : float, optional
        Exponent a in the absorption coefficient's ``wavelength^-a``, from -1 to 5. 1 holds for
        particles much smaller than the wavelength, with a constant refractive index.

    Returns
    -------
    ndarray of float64

    Raises
    ------
    InputError
        If a wavelength or the exponent is out of range.
    """
    first, second = _checked_wavelengths(wavelengths_nm)
    _check_exponent(soot_exponent)
    inverse = 1 / np.asarray(kelvin, float)
    return np.exp(_log_ratio(inverse, first, second, soot_exponent))


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
    short, long = _checked_wavelengths(wavelengths_nm)
    _check_exponent(soot_exponent)
    emissions = [np.asarray(one, float) for one in (first, second)]
    errors = None if sigmas is None else [np.asarray(one, float) for one in sigmas]
    shapes = {one.shape for one in (*emissions, *(errors or []))}
    if len(shapes) > 1:
        raise InputError(f"Emissions and their errors must be of one shape, got {sorted(shapes)}.")
    _check_exponent(soot_exponent)
    if not (np.isfinite(calibration) and calibration > 0):
        raise InputError(f"calibration must be a finite number above 0, got {calibration}.")
    least = [0.0, 0.0] if errors is None else [LEAST_SIGNAL * error for error in errors]
    known = (emissions[0] > least[0]) & (emissions[1] > least[1])
    with np.errstate(all="ignore"):  # 0 / 0 gives no temperature, and no warning
        ratio = np.where(known, emissions[0] / emissions[1] / calibration, np.nan)
        inverse = _invert(np.log(ratio), short, long, soot_exponent)
        kelvin = 1 / inverse
        kelvin = np.where((kelvin >= LEAST_K) & (kelvin <= MOST_K), kelvin, np.nan)
        if errors is None:
            return Temperatures(kelvin, None, None)
        relative = np.hypot(errors[0] / emissions[0], errors[1] / emissions[1])
        relative = np.where(np.isfinite(kelvin), relative, np.nan)
        slope = np.abs(_slope(inverse, short, long))
        return Temperatures(kelvin, kelvin**2 * relative / slope, relative)


def _log_ratio(inverse: np.ndarray, first: float, second: float, exponent: float) -> np.ndarray:
    """Logarithm of the ratio of emissions at 1 / T; wavelengths in mm."""
    x1, x2 = (SECOND_RADIATION_MM_K / length * inverse for length in (first, second))
    constant = (5 + exponent) * np.log(second / first)
    return constant + x2 - x1 + np.log1p(-np.exp(-x2)) - np.log1p(-np.exp(-x1))


def _slope(inverse: np.ndarray, first: float, second: float) -> np.ndarray:
    """Derive the logarithm of the ratio with respect to 1 / T, in K."""
    steps = []
    for length in (first, second):
        c = SECOND_RADIATION_MM_K / length
        steps.append(c / -np.expm1(-c * inverse))
    return steps[1] - steps[0]


def _invert(log_ratio: np.ndarray, first: float, second: float, exponent: float) -> np.ndarray:
    """Solve for 1 / T with Newton's method, starting from Wien's approximation."""
    constant = (5 + exponent) * np.log(second / first)
    inverse = (constant - log_ratio) / (SECOND_RADIATION_MM_K * (1 / first - 1 / second))
    inverse = np.clip(inverse, 1 / (4 * MOST_K), 4 / LEAST_K)
    for _ in range(NEWTON_STEPS):
        gap = _log_ratio(inverse, first, second, exponent) - log_ratio
        inverse = np.clip(inverse - gap / _slope(inverse, first, second), 1e-5, 1.0)
    return inverse


def _check_exponent(soot_exponent: float) -> None:
    if not LEAST_EXPONENT <= soot_exponent <= MOST_EXPONENT:
        raise InputError(
            f"soot_exponent must be from {LEAST_EXPONENT:g} to {MOST_EXPONENT:g}, got "
            f"{soot_exponent}."
        )


def _checked_wavelengths(wavelengths_nm: tuple[float, float]) -> tuple[float, float]:
    lengths = np.asarray(wavelengths_nm, float)
    if lengths.shape != (2,) or not np.all((lengths >= LEAST_NM) & (lengths <= MOST_NM)):
        raise InputError(
            f"wavelengths_nm must be two in nm, from {LEAST_NM:g} to {MOST_NM:g}, got "
            f"{wavelengths_nm}{_other_unit(lengths)}."
        )
    if abs(lengths[0] - lengths[1]) < 1e-3 * lengths.max():
        raise InputError(
            f"wavelengths_nm must differ by a thousandth at least, got {wavelengths_nm}: the ratio "
            f"of a colour to itself has no temperature."
        )
    return float(lengths[0]) * 1e-6, float(lengths[1]) * 1e-6


def _other_unit(lengths: np.ndarray) -> str:
    """Guess the unit in which wavelengths were given."""
    for unit, scale in (("micrometres", 1e3), ("mm", 1e6), ("m", 1e9)):
        meant = lengths * scale
        if lengths.shape == (2,) and np.all((meant >= LEAST_NM) & (meant <= MOST_NM)):
            return f"; if these are {unit}, give {meant[0]:g} and {meant[1]:g}"
    return ""
