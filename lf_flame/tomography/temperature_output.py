"""Output files of soot temperatures, and notes on them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import tifffile

from lf_flame._common import figures
from lf_flame._common.config import load_record
from lf_flame._common.output_folders import OutputFolder
from lf_flame.formats.coding import CODED
from lf_flame.tomography import emission_folder
from lf_flame.tomography.axisymmetric import section_folder
from lf_flame.tomography.figures import temperature_figure
from lf_flame.tomography.pyrometry import (
    LEAST_K,
    LEAST_SIGNAL,
    MOST_K,
    SINGLE_WAVELENGTHS,
    Temperatures,
)

RECORD = "temperature.json"


@dataclass(frozen=True)
class SourceRecord:
    """Content of the record of an emission on its light field.

    Attributes
    ----------
    notes : list of str, optional
        Notes on how it was read.
    """

    notes: list[str] = field(default_factory=list)


def temperature_notes(found: Temperatures, folders: Iterable[Path]) -> list[str]:
    """List the assumptions behind the temperatures, one or two sentences each."""
    notes = [SINGLE_WAVELENGTHS]
    for folder in folders:
        kind = section_folder if section_folder.is_section(folder) else emission_folder
        record = load_record(SourceRecord, folder / kind.RECORD)
        if any(CODED in note for note in record.notes):
            notes.append(f"{folder} was made of files that are not made for measuring. {CODED}")
    if not np.isfinite(found.kelvin).any():
        notes.append(
            f"No cell has a temperature: either no emission exceeds its noise by "
            f"{LEAST_SIGNAL:g} standard deviations in both colours, or no ratio of them is that of "
            f"soot between {LEAST_K:g} and {MOST_K:g} K; see whether the wavelengths are in the "
            f"order of the folders, and --calibration."
        )
    return notes


def write_temperature(found: Temperatures, depths: Sequence[float], folder: OutputFolder) -> None:
    """Write ``temperature.tif``, ``temperature_sigma.tif`` (NaN: undetermined) and a figure."""
    for name, planes in (("temperature", found.kelvin), ("temperature_sigma", found.sigma)):
        _write_planes(folder, f"{name}.tif", np.asarray(planes, np.float32))
    figures.save(temperature_figure(found, depths), folder.path("temperature.png"))
    folder.facts["depths_mm"] = list(depths)


def _write_planes(folder: OutputFolder, name: str, planes: np.ndarray) -> None:
    """Write a TIFF file; if the disk is full, the error names it, which NumPy's does not."""
    try:
        tifffile.imwrite(folder.path(name), planes)
    except OSError as error:
        reason = error.strerror or str(error)
        raise OSError(error.errno, reason, str(folder.folder / name)) from None
