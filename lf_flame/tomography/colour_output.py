"""Output files of a calibration of colours: ``colours.toml`` and a picture."""

from collections.abc import Sequence

import numpy as np
from tabulate import tabulate

from lf_flame._common import figures
from lf_flame._common.atomic_files import write_text
from lf_flame._common.figures import subplots
from lf_flame._common.output_folders import OutputFolder
from lf_flame.tomography.colour_calibration import ColourFit

RECORD = "calibrate-colours.json"
COLOURS, PICTURE = "colours.toml", "colours.png"


def write_colours(fit: ColourFit, kelvin: Sequence[float], folder: OutputFolder) -> None:
    """Write the gains with their responses, and the deviation of each picture."""
    head = (
        "# Measured by lf-flame calibrate-colours. The signal of a black body is\n"
        "# gain * integral of response * radiance, in W / (m^2 sr) for responses without unit.\n"
    )
    calibration = fit.calibration
    write_text(folder.path(COLOURS), head + calibration.to_toml())
    figures.save(_colours_figure(fit, kelvin), folder.path(PICTURE))
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
    figure, (left, right) = subplots(1, 2, figsize=(10, 3.6), layout="constrained")
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
