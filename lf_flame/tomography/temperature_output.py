"""Output files of soot temperatures, and notes on them."""

from collections.abc import Iterable, Sequence

import numpy as np
import tifffile

from lf_flame._common import figures
from lf_flame._common.output_folders import OutputFolder
from lf_flame.formats.coding import CODED
from lf_flame.tomography.colour_calibration import ColourCalibration
from lf_flame.tomography.emission import Place
from lf_flame.tomography.emission_folder import RECORD as SOURCE
from lf_flame.tomography.emission_folder import EmissionFolder
from lf_flame.tomography.figures import temperature_figure
from lf_flame.tomography.pyrometry import (
    LEAST_K,
    LEAST_SIGNAL,
    MOST_K,
    SINGLE_WAVELENGTHS,
    Temperatures,
    soot_temperature,
)

RECORD = "temperature.json"
SIGMA_FILE = "temperature_sigma.tif"

UNSURE_EXPONENT = 0.3
"""Error of the exponent of soot's absorption whose effect is told; measured exponents of flames
spread by more."""

BELIEVABLE_K = 1000.0, 3000.0
"""Range of temperatures in K of soot in flames; a calibration may extend it. Flames hotter than the
furnace are ordinary, so the calibration's range alone would warn of sound results."""

MOST_MISFIT = 4.0
"""Largest chi-squared of the median cell without a note."""


def temperature_warnings(found: Temperatures, calibration: ColourCalibration) -> list[str]:
    """Say that most temperatures are none of a flame, and what may have made them."""
    known = found.kelvin[np.isfinite(found.kelvin)]
    low, high = BELIEVABLE_K
    if not calibration.responses.single_wavelengths:
        low = min(low, calibration.temperature_range_K[0])
        high = max(high, calibration.temperature_range_K[1])
    outside = int(np.sum((known < low) | (known > high)))
    if outside <= known.size / 2:
        return []
    return [
        f"{outside} of {known.size} temperatures are none of soot in a flame, {low:g} to {high:g} "
        f"K, so do not trust the others either: see whether a black level was left in, the values "
        f"are not linear in light (gamma), or the colours are in another order."
    ]


def temperature_notes(
    found: Temperatures,
    folders: Iterable[EmissionFolder],
    calibration: ColourCalibration,
    soot_exponent: float,
) -> list[str]:
    """List the assumptions behind the temperatures, one or two sentences each."""
    notes = []
    if calibration.responses.single_wavelengths:
        notes.append(SINGLE_WAVELENGTHS)
    for folder in folders:
        record = folder.record
        if any(CODED in note for note in record.notes):
            notes.append(
                f"{folder.folder} was made of files that are not made for measuring. {CODED}"
            )
        if record.warnings:
            notes.append(
                f"The fit of {folder.folder} has {len(record.warnings)} warnings, see its "
                f"{SOURCE}: what they say of emission holds for its temperature."
            )
    known = np.isfinite(found.kelvin)
    if not known.any():
        notes.append(
            f"No cell has a temperature: either no emission exceeds its noise by "
            f"{LEAST_SIGNAL:g} standard deviations in all colours, or no ratio of them is that of "
            f"soot between {LEAST_K:g} and {MOST_K:g} K; see whether the colours are in the "
            f"order of the folders, and their calibration."
        )
        return notes
    low, high = calibration.temperature_range_K
    outside = int(np.sum(known & ((found.kelvin < low) | (found.kelvin > high))))
    if outside:
        notes.append(
            f"{outside} of {int(known.sum())} temperatures are outside the calibration's, {low:g} "
            f"to {high:g} K: there they rest on the spectral responses alone."
        )
    if found.misfit is not None and np.nanmedian(found.misfit) > MOST_MISFIT:
        notes.append(
            f"Soot of one temperature does not explain all colours: chi-squared is "
            f"{np.nanmedian(found.misfit):.2g} in the median cell, and should be near 1. See the "
            f"spectral responses, the gains, --soot-exponent, and whether a colour is saturated or "
            f"holds light of another source, such as a blue flame."
        )
    return [*notes, *_uncertainties(found, calibration, soot_exponent)]


def _uncertainties(
    found: Temperatures, calibration: ColourCalibration, soot_exponent: float
) -> list[str]:
    """Say what the exponent and the gains' errors do to thin soot of the median temperature."""
    other, median = soot_exponent + UNSURE_EXPONENT, float(np.nanmedian(found.kelvin))
    light = calibration.gains * calibration.responses.soot(median, soot_exponent)
    errors = np.clip(calibration.relative_errors, 1e-9, 0.3) * light
    changed, alike = (
        soot_temperature(
            list(light),
            calibration.responses,
            sigmas=list(errors),
            gains=calibration.gains,
            soot_exponent=exponent,
        )
        for exponent in (other, soot_exponent)
    )
    change, error = float(changed.kelvin) - median, float(np.asarray(alike.sigma))
    # Near the end of the range, the other exponent has no temperature.
    differ = f"differ by about {change:+.0f} K" if np.isfinite(change) else "be out of range"
    notes = [
        f"Soot is taken to absorb as wavelength^-{soot_exponent:g}. With {other:g} instead "
        f"(--soot-exponent), temperatures would {differ}; {SIGMA_FILE} does not hold this."
    ]
    if error > 1:
        notes.append(
            f"The errors of the calibration's gains add a standard deviation of {error:.0f} K, the "
            f"same in all cells, which {SIGMA_FILE} does not hold."
        )
    return notes


def write_temperature(
    found: Temperatures,
    emission: np.ndarray,
    places: Sequence[Place],
    folder: OutputFolder,
    *,
    absolute: bool = False,
) -> None:
    """Write ``temperature.tif``, ``temperature_sigma.tif`` (NaN: undetermined) and a figure.

    With `absolute` gains, ``optical_thickness.tif`` is the soot's at 600 nm, by plane or by mm as
    the emission, of which the figure shows one colour.
    """
    stacks = {"temperature.tif": found.kelvin, SIGMA_FILE: found.sigma}
    if absolute:
        stacks["optical_thickness.tif"] = found.amount
    for name, planes in stacks.items():
        tifffile.imwrite(folder.path(name), np.asarray(planes, np.float32))
    maps = (found.kelvin, np.asarray(found.sigma), emission)
    kelvin, sigma, light = (places[0].whole(one) for one in maps)
    figure = temperature_figure(kelvin, sigma, light, places)
    figures.save(figure, folder.path("temperature.png"), dpi=300)
    folder.facts["depths_mm"] = [place.depth_mm for place in places]
