"""Output files of emission by depth."""

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import tifffile

from lf_flame._common import figures
from lf_flame._common.atomic_files import atomic_write
from lf_flame._common.config import to_json
from lf_flame._common.output_folders import OutputFolder, output_folder
from lf_flame.formats import write_focal_stack
from lf_flame.lightfield import LightField
from lf_flame.refocus import shift_and_sum
from lf_flame.tomography.emission_folder import CORRECTION, DRAWS, EMISSION, RECORD, SIGMA
from lf_flame.tomography.figures import (
    depth_figure,
    slices_figure,
    trust_figure,
)

if TYPE_CHECKING:
    from lf_flame.tomography.reconstruction_result import Reconstruction


def write_reconstruction(
    found: "Reconstruction",
    light_field: LightField,
    folder: OutputFolder | str | Path,
    *,
    overwrite: bool = False,
) -> None:
    """Write a reconstruction into a folder that `EmissionFolder` opens.

    ``emission.tif`` has a page for each depth plane, in the unit of the light field. Other files
    are ``correction.tif`` (the part of the emission that corrects the penalty's bias);
    ``sigma.tif`` and ``draws.tif``, if there are bootstrap draws; ``depth.csv`` and ``depth.png``
    (light against depth); ``slices.png`` (depth planes beside refocused images) and ``trust.png``
    (residual of each view, misfit against the strength of the regularisation).

    Parameters
    ----------
    found : Reconstruction
        Reconstruction to write.
    light_field : LightField
        Light field that was reconstructed.
    folder : str, Path or OutputFolder
        Folder to make, as `lf-flame reconstruct` does, for `lf-flame temperature` and `lf-flame
        profiles` to read.
    overwrite : bool, optional
        Whether to replace a folder of an earlier call, if it holds nothing else.

    Raises
    ------
    InputError
        If the folder exists and may not be replaced, or another process writes there.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import numpy as np
    >>> from lf_flame import LightField, PAPER_CAMERA
    >>> from lf_flame.tomography import EmissionFolder, FrustumGrid
    >>> from lf_flame.tomography import reconstruct, write_reconstruction
    >>> grid = FrustumGrid(replace(PAPER_CAMERA, views=3, lenslets=(20, 24)), [4.0, -4.0])
    >>> y, x = np.mgrid[-1:1:20j, -1:1:24j]
    >>> light_field = LightField(np.broadcast_to(np.exp(-8 * (x**2 + y**2)), (3, 3, 20, 24)))
    >>> write_reconstruction(reconstruct(light_field, grid), light_field, "emission")
    >>> EmissionFolder("emission").depths_mm
    [4.0, -4.0]
    """
    if not isinstance(folder, OutputFolder):
        with output_folder(folder, RECORD, overwrite=overwrite) as opened:
            write_reconstruction(found, light_field, opened)
        return
    write_focal_stack(found.emission, found.grid.slopes, folder.path(EMISSION))
    tifffile.imwrite(folder.path(CORRECTION), found.correction)
    if found.sigma is not None:
        write_focal_stack(found.sigma.astype(np.float32), found.grid.slopes, folder.path(SIGMA))
        tifffile.imwrite(folder.path(DRAWS), found.draws)
    light, error = light_by_depth(found)
    errors = [""] * len(light) if error is None else error
    write_table(
        folder.path("depth.csv"),
        ["depth_mm", "slope", "light_radiance_mm2", "standard_deviation"],
        zip(found.grid.depths_mm, found.grid.slopes, light, errors, strict=True),
    )
    figures.save(depth_figure(found, light, error), folder.path("depth.png"))
    figures.save(trust_figure(found), folder.path("trust.png"))
    figures.save(slices_figure(found, _focal_stack(found, light_field)), folder.path("slices.png"))
    grid = found.grid
    folder.facts |= {
        "camera": to_json(grid.camera),
        "depths_mm": list(grid.depths_mm),
        "block": grid.block,
        "cell_mm": [grid.cell_mm(depth) for depth in grid.depths_mm],
        "unit": "radiance that each plane adds along the line of sight, as of the light field",
        "noise": found.noise,
        "background": found.background,
        "background_sigma": found.background_sigma,
        "strength": found.strength,
        "iterations": found.iterations,
        "tried": [to_json(tried) for tried in found.tried],
        "sigma_of_linear_fit": found.sigma_linear.tolist(),
        "warnings": list(found.warnings),
    }


def light_by_depth(found: "Reconstruction") -> tuple[np.ndarray, np.ndarray | None]:
    """Sum each depth plane's emission over its area, with the error of the sum.

    Returns
    -------
    light : ndarray of float64, shape (planes,)
        Light in radiance times mm^2.
    error : ndarray, shape (planes,), or None
        Standard deviation, if there are bootstrap draws.
    """
    areas = np.array([found.grid.cell_mm(depth) ** 2 for depth in found.grid.depths_mm])
    light = found.emission.sum(axis=(1, 2), dtype=np.float64) * areas
    return light, None if found.light_sigma is None else found.light_sigma * areas


def write_table(path: Path, names: Sequence[str], rows: Iterable[Iterable]) -> None:
    """Write a CSV file with a heading."""
    with atomic_write(path) as aside, aside.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        writer.writerows(rows)


def _focal_stack(found: "Reconstruction", light_field: LightField) -> np.ndarray:
    stack = shift_and_sum(found.grid.camera.corrected(light_field), found.grid.slopes)
    (rows, columns), block = found.grid.pixels, found.grid.block
    return stack.reshape(len(stack), rows, block, columns, block).mean(axis=(2, 4))
