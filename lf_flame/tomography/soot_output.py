"""Output files of calibrations of colours and of soot temperatures, and notes on these."""

from collections.abc import Iterable, Sequence

import numpy as np
import tifffile
from tabulate import tabulate

from lf_flame._common import figures
from lf_flame._common.atomic_files import OutputFolder, write_text
from lf_flame.formats.images import CODED
from lf_flame.tomography.colour_calibration import ColourCalibration, ColourFit
from lf_flame.tomography.emission import Place
from lf_flame.tomography.emission_folder import RECORD as SOURCE
from lf_flame.tomography.emission_folder import EmissionFolder
from lf_flame.tomography.figures import temperature_figure
from lf_flame.tomography.pyrometry import (
    LEAST_K,
    LEAST_SIGNAL,
    MOST_K,
    Temperatures,
    soot_temperature,
)
from lf_flame.tomography.spectra import MOST_EXPONENT

COLOURS_RECORD, TEMPERATURE_RECORD = "calibrate-colours.json", "temperature.json"
SIGMA_FILE = "temperature_sigma.tif"

UNSURE_EXPONENT = 0.3
"""Error of the exponent of soot's absorption whose effect is reported; measured exponents of flames
spread by more."""

BELIEVABLE_K = 1000.0, 3000.0
"""Range of temperatures in K of soot in flames; a calibration may extend it. Flames hotter than the
furnace are ordinary, so the calibration's range alone would warn of sound results."""

MOST_MISFIT = 4.0
"""Largest chi-squared of the median cell without a note."""


def write_colours(fit: ColourFit, kelvin: Sequence[float], folder: OutputFolder) -> None:
    """Write the gains with their responses, and the deviation of each picture."""
    head = (
        "# Measured by lf-flame calibrate-colours. The signal of a black body is\n"
        "# gain * integral of response * radiance, in W / (m^2 sr) for responses without unit.\n"
    )
    calibration = fit.calibration
    write_text(folder.path("colours.toml"), head + calibration.to_toml())
    figures.save(_colours_figure(fit, kelvin), folder.path("colours.png"))
    folder.facts |= {
        "kelvin": list(kelvin),
        "colours": list(calibration.responses.names),
        "gains": calibration.gains.tolist(),
        "relative_errors": calibration.relative_errors.tolist(),
        "residuals": fit.residuals.tolist(),
    }


def colours_table(fit: ColourFit, kelvin: Sequence[float]) -> str:
    """Deviation of each picture from the fit, and the gains, as a table for the terminal."""
    names = fit.calibration.responses.names
    rows = [
        [f"{temperature:g}", *(f"{100 * one:+.2f}" for one in line)]
        for temperature, line in zip(kelvin, fit.residuals, strict=True)
    ]
    rows.append(["gain", *(f"{gain:.4g}" for gain in fit.calibration.gains)])
    rows.append(["error (%)", *(f"{100 * one:.2g}" for one in fit.calibration.relative_errors)])
    heads = ["source (K)", *(f"{name} (%)" for name in names)]
    return tabulate(rows, heads, disable_numparse=True, colalign=["right"] * len(heads))


def _colours_figure(fit: ColourFit, kelvin: Sequence[float]):
    """Draw the responses, and the deviations by temperature."""
    figure, (left, right) = figures.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
    responses = fit.calibration.responses
    for number, name in enumerate(responses.names):
        curve = responses.values[number]
        style = {"color": f"C{number}", "label": name}
        left.plot(responses.wavelengths_nm, curve / curve.max(), **style)
        order = np.argsort(kelvin)
        right.plot(
            np.asarray(kelvin)[order], 100 * fit.residuals[order, number], marker="o", **style
        )
    left.set(xlabel="wavelength (nm)", ylabel="response, relative to its maximum")
    right.set(xlabel="temperature of the source (K)", ylabel="deviation from the fit (%)")
    right.axhline(0, color="0.6", linewidth=0.8)
    left.legend()
    return figure


def temperature_warnings(found: Temperatures, calibration: ColourCalibration) -> list[str]:
    """Warn if most temperatures are impossible for a flame, with possible causes."""
    known = found.kelvin[np.isfinite(found.kelvin)]
    low, high = BELIEVABLE_K
    if not calibration.responses.single_wavelengths:
        low = min(low, calibration.temperature_range_K[0])
        high = max(high, calibration.temperature_range_K[1])
    outside = int(np.sum((known < low) | (known > high)))
    if outside <= known.size / 2:
        return []
    return [
        f"{outside} of {known.size} temperatures are not those of soot in flames, {low:g} to "
        f"{high:g} K, so do not trust the others either: check whether a black level was left in, "
        f"the values are not linear in light (gamma), or the colours are in another order."
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
        notes.append(
            "Each colour is treated as a single wavelength. Through broad filters, such as those "
            "of a colour camera (Bayer), temperatures are off by tens to hundreds of kelvin: give "
            "their spectral responses."
        )
    for folder in folders:
        record = folder.record
        if any(CODED in note for note in record.notes):
            notes.append(
                f"{folder.folder} was made from files that are not meant for measuring. {CODED}"
            )
        if record.warnings:
            notes.append(
                f"The fit of {folder.folder} has {len(record.warnings)} warnings, see its "
                f"{SOURCE}: they apply to its temperature, too."
            )
    known = np.isfinite(found.kelvin)
    if not known.any():
        notes.append(
            f"No cell has a temperature: either no emission exceeds its noise by "
            f"{LEAST_SIGNAL:g} standard deviations in all colours, or no ratio of them is that of "
            f"soot between {LEAST_K:g} and {MOST_K:g} K; check whether the colours are in the "
            f"order of the folders, and their calibration."
        )
        return notes
    if found.misfit is not None and np.nanmedian(found.misfit) > MOST_MISFIT:
        notes.append(
            f"Soot of one temperature does not explain all colours: chi-squared is "
            f"{np.nanmedian(found.misfit):.2g} in the median cell, but should be near 1. Check the "
            f"spectral responses, the gains, --soot-exponent, and whether a colour is saturated or "
            f"contains light of another source, such as a blue flame."
        )
    return [*notes, *_uncertainties(found, calibration, soot_exponent)]


def _uncertainties(
    found: Temperatures, calibration: ColourCalibration, soot_exponent: float
) -> list[str]:
    """Report what the exponent and the gains' errors do to thin soot of the median temperature."""
    other, median = soot_exponent + UNSURE_EXPONENT, float(np.nanmedian(found.kelvin))
    if other > MOST_EXPONENT:
        other = soot_exponent - UNSURE_EXPONENT
    light = calibration.gains * calibration.responses.soot(median, soot_exponent)
    # Small changes: near the end of the range a whole error has no temperature.
    moved = light[:, None] * (1 + 1e-3 * np.eye(len(light)))
    changed, apart = (
        soot_temperature(
            list(seen), calibration.responses, gains=calibration.gains, soot_exponent=exponent
        ).kelvin
        - median
        for seen, exponent in ((light, other), (moved, soot_exponent))
    )
    change, error = float(changed), 1e3 * float(np.linalg.norm(apart * calibration.relative_errors))
    # Near the end of the range, the other exponent has no temperature.
    differ = f"differ by about {change:+.0f} K" if np.isfinite(change) else "be out of range"
    notes = [
        f"Soot is assumed to absorb as wavelength^-{soot_exponent:g}. With {other:g} instead "
        f"(--soot-exponent), temperatures would {differ}; {SIGMA_FILE} does not include this."
    ]
    if error > 1:
        notes.append(
            f"The errors of the calibration's gains add a standard deviation of {error:.0f} K, the "
            f"same in all cells, which {SIGMA_FILE} does not include."
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
    for name, stack in stacks.items():
        tifffile.imwrite(folder.path(name), np.asarray(stack, np.float32), photometric="minisblack")
    maps = (found.kelvin, np.asarray(found.sigma), emission)
    kelvin, sigma, light = (places[0].whole(one) for one in maps)
    figure = temperature_figure(kelvin, sigma, light, places)
    figures.save(figure, folder.path("temperature.png"), dpi=300)
    folder.facts["depths_mm"] = [place.depth_mm for place in places]
