"""Output files of an axisymmetric flame's emission."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import tifffile

from lf_flame._common import figures
from lf_flame._common.config import to_json
from lf_flame._common.output_folders import OutputFolder, output_folder
from lf_flame.tomography.axisymmetric.axis import FlameAxis
from lf_flame.tomography.axisymmetric.figure import section_figure
from lf_flame.tomography.output import write_table

if TYPE_CHECKING:
    from lf_flame.tomography.axisymmetric.reconstruction import AxisymmetricFlame

RECORD = "abel.json"


def write_flame(
    found: "AxisymmetricFlame",
    axis: FlameAxis,
    folder: OutputFolder | str | Path,
    *,
    overwrite: bool = False,
) -> None:
    """Write the half section as tables and images.

    ``radial.csv`` has all heights and radii, ``axial.csv`` the axis, ``section.tif`` the half
    section, heights by radii; ``sigma.tif`` its standard deviation and ``draws.tif`` the draws, if
    there are any.

    Parameters
    ----------
    found : AxisymmetricFlame
        Flame to write.
    axis : FlameAxis
        Axis as found in the light field.
    folder : str, Path or OutputFolder
        Folder to make, as `lf-flame abel` does, for `lf-flame temperature` to read.
    overwrite : bool, optional
        Whether to replace a folder of an earlier call, if it holds nothing else.

    Raises
    ------
    InputError
        If the folder exists and may not be replaced, or another process writes there.
    """
    if not isinstance(folder, OutputFolder):
        with output_folder(folder, RECORD, overwrite=overwrite) as opened:
            write_flame(found, axis, opened)
        return
    grid, sigma, bar = found.grid, found.sigma, found.bar
    write_table(
        folder.path("radial.csv"),
        ["height_mm", "radius_mm", "emission_per_mm", "standard_deviation", "low_95", "high_95"],
        (
            (height, radius, found.emission[i, j], *_bar(found.emission, sigma, bar, i, j))
            for i, height in enumerate(grid.heights_mm)
            for j, radius in enumerate(grid.radii_mm)
        ),
    )
    write_table(
        folder.path("axial.csv"),
        ["height_mm", "emission_per_mm", "standard_deviation", "low_95", "high_95"],
        (
            (height, found.emission[i, 0], *_bar(found.emission, sigma, bar, i, 0))
            for i, height in enumerate(grid.heights_mm)
        ),
    )
    tifffile.imwrite(folder.path("section.tif"), found.emission)
    if sigma is not None:
        tifffile.imwrite(folder.path("sigma.tif"), sigma.astype(np.float32))
        tifffile.imwrite(folder.path("draws.tif"), found.draws, photometric="minisblack")
    figures.save(section_figure(found), folder.path("section.png"))
    folder.facts |= {
        "camera": to_json(grid.camera),
        "axis_mm": grid.axis_mm,
        "axis_depth_mm": grid.depth_mm,
        "radius_mm": grid.radius_mm,
        "burner_mm": grid.burner_mm,
        "block": grid.block,
        "views": grid.which,
        "step_mm": grid.step_mm,
        "top_mm": float(grid.heights_mm[0]),
        "axis_found": to_json(axis),
        "unit": "radiance per mm of the line of sight, as of the light field",
        "noise": found.noise,
        "strength": found.strength,
    }


def _bar(emission, sigma, bar, height: int, radius: int) -> tuple:
    """Give the standard deviation of a node, and the ends of its 95 % error bar, 0 or above."""
    if sigma is None:
        return "", "", ""
    value, half = emission[height, radius], bar[height, radius]
    return sigma[height, radius], max(value - half, 0), value + half
