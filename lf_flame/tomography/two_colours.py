"""Temperature of soot from its emissions at two single wavelengths.

`lf_flame.tomography.pyrometry` has the formula, and the fit for the broad colours of a camera.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lf_flame.errors import InputError
from lf_flame.tomography.pyrometry import Temperatures, soot_temperature
from lf_flame.tomography.spectra import LEAST_NM, MOST_NM, SpectralResponses, other_unit

SINGLE_WAVELENGTHS = (
    "Each colour is taken for light of a single wavelength. Through broad filters, as of a colour "
    "camera (Bayer), temperatures are off by tens to hundreds of kelvin: give their spectral "
    "responses."
)


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
    responses = two_wavelengths(wavelengths_nm)
    if not (np.isfinite(calibration) and calibration > 0):
        raise InputError(f"calibration must be a finite number above 0, got {calibration}.")
    return soot_temperature(
        (first, second),
        responses,
        sigmas=sigmas,
        soot_exponent=soot_exponent,
        gains=(calibration, 1.0),
    )


def two_wavelengths(wavelengths_nm: tuple[float, float]) -> SpectralResponses:
    """Responses to two single wavelengths in nm, which must differ by a thousandth at least."""
    lengths = np.asarray(wavelengths_nm, float)
    if lengths.shape != (2,) or not np.all((lengths >= LEAST_NM) & (lengths <= MOST_NM)):
        unit = other_unit(lengths) if lengths.shape == (2,) else ""
        raise InputError(
            f"wavelengths_nm must be two in nm, from {LEAST_NM:g} to {MOST_NM:g}, got "
            f"{wavelengths_nm}{unit}."
        )
    if abs(lengths[0] - lengths[1]) < 1e-3 * lengths.max():
        raise InputError(
            f"wavelengths_nm must differ by a thousandth at least, got {wavelengths_nm}: the ratio "
            f"of a colour to itself has no temperature."
        )
    return SpectralResponses.single(lengths.tolist())
