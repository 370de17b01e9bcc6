"""Folders of emission: one writer, one reader."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tifffile
from pydantic import Field

from lf_flame._common.atomic_files import OutputFolder, atomic_write, output_folder
from lf_flame._common.config import build, to_json
from lf_flame._common.images import read_pixels
from lf_flame._common.input_files import printable, read_record
from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.tomography.axisymmetric_grid import AxisymmetricGrid
from lf_flame.tomography.emission import Emission, Place
from lf_flame.tomography.frustum_grid import FrustumGrid

Length = Annotated[float, Field(ge=1e-12, le=1e12)]
Position = Annotated[float, Field(ge=-1e12, le=1e12)]

RECORD = "emission.json"
CELLS = (
    "geometry", "depths_mm", "cell_mm", "axis_mm", "axis_depth_mm", "radius_mm", "step_mm",
    "burner_mm",
)  # fmt: skip
EMISSION, SIGMA, DRAWS, CORRECTION = "emission.tif", "sigma.tif", "draws.tif", "correction.tif"

UNITS = {
    "planes": "radiance that each plane adds along the line of sight, as of the light field",
    "section": "radiance per mm of the line of sight, as of the light field",
}


def write_emission(
    found: Emission,
    light_field: LightField,
    folder: OutputFolder | str | Path,
    *,
    overwrite: bool = False,
) -> None:
    """Write emission into a folder that `EmissionFolder` opens.

    ``emission.tif`` has a page for each depth plane, or one with the half section, in the unit of
    the light field; ``correction.tif`` is the part that corrects the fit's bias, ``sigma.tif`` and
    ``draws.tif`` come with bootstrap draws. Tables and figures show light against depth, or all
    heights and radii, and how far the result can be trusted.

    Parameters
    ----------
    found : Emission
    light_field : LightField
        Light field that was reconstructed.
    folder : str, Path or OutputFolder
        Folder to make, for `lf-flame temperature` and `lf-flame profiles` to read.
    overwrite : bool, optional
        Whether to replace a folder of an earlier run, if it contains nothing else.

    Raises
    ------
    InputError
        If the folder exists and may not be replaced, or another process writes there.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import numpy as np
    >>> from lf_flame import LightField, PAPER_CAMERA
    >>> from lf_flame.tomography import EmissionFolder, FrustumGrid, reconstruct, write_emission
    >>> grid = FrustumGrid(replace(PAPER_CAMERA, views=3, lenslets=(20, 24)), [4.0, -4.0])
    >>> y, x = np.mgrid[-1:1:20j, -1:1:24j]
    >>> light_field = LightField(np.broadcast_to(np.exp(-8 * (x**2 + y**2)), (3, 3, 20, 24)))
    >>> write_emission(reconstruct(light_field, grid), light_field, "emission")
    >>> EmissionFolder("emission").depths_mm
    [4.0, -4.0]
    """
    from lf_flame.tomography.figures import draw_emission

    if not isinstance(folder, OutputFolder):
        with output_folder(folder, RECORD, overwrite=overwrite) as opened:
            write_emission(found, light_field, opened)
        return
    stacks = {EMISSION: found.emission, CORRECTION: found.correction}
    if found.sigma is not None:
        stacks |= {SIGMA: found.sigma, DRAWS: found.draws}
    for name, stack in stacks.items():
        stack = stack.astype(np.float32)
        tifffile.imwrite(folder.path(name), stack, photometric="minisblack")
    write = _write_planes if found.on_planes else _write_section
    folder.facts |= write(found, found.grid, folder)
    draw_emission(found, light_field, folder)
    folder.facts |= {
        "camera": to_json(found.grid.camera),
        "block": found.grid.block,
        "unit": UNITS[folder.facts["geometry"]],
        "noise": found.noise,
        "background": found.background,
        "background_sigma": found.background_sigma,
        "strength": found.strength,
        "checks": [[check.name, float(check.number), float(check.limit)] for check in found.checks],
        "warnings": list(found.warnings),
    }


def _write_planes(found: Emission, grid: FrustumGrid, folder: OutputFolder) -> dict[str, Any]:
    """Write depth.csv, and give the facts on the planes."""
    light, error = found.light
    errors = [""] * len(light) if error is None else error
    names = ["depth_mm", "slope", "light_radiance_mm2", "standard_deviation"]
    rows = zip(grid.depths_mm, grid.slopes, light, errors, strict=True)
    write_table(folder.path("depth.csv"), names, rows)
    sides = [grid.cell_mm(depth) for depth in grid.depths_mm]
    return {"geometry": "planes", "depths_mm": list(grid.depths_mm), "cell_mm": sides}


def _write_section(found: Emission, grid: AxisymmetricGrid, folder: OutputFolder) -> dict[str, Any]:
    """Write radial.csv and axial.csv, and give the facts on the section."""
    values, columns = found.emission, ["emission_per_mm", "standard_deviation", "low_95", "high_95"]
    nodes = [values, *[np.full(values.shape, "")] * 3]
    if found.sigma is not None:
        nodes[1:] = found.sigma, np.clip(values - found.bar, 0, None), values + found.bar
    lines = [
        (height, radius, *(one[row, column] for one in nodes))
        for row, height in enumerate(grid.heights_mm)
        for column, radius in enumerate(grid.radii_mm)
    ]
    write_table(folder.path("radial.csv"), ["height_mm", "radius_mm", *columns], lines)
    axis = ((height, *node) for height, _, *node in lines[:: len(grid.radii_mm)])
    write_table(folder.path("axial.csv"), ["height_mm", *columns], axis)
    return {
        "geometry": "section",
        "axis_mm": grid.axis_mm,
        "axis_depth_mm": grid.depth_mm,
        "radius_mm": grid.radius_mm,
        "burner_mm": grid.burner_mm,
        "views": grid.which,
        "step_mm": grid.step_mm,
        "top_mm": float(grid.heights_mm[0]),
    }


def write_table(path: Path, names: Sequence[str], rows: Iterable[Iterable]) -> None:
    """Write a CSV file with a header row."""
    with atomic_write(path) as aside, aside.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        writer.writerows(rows)


@dataclass(frozen=True)
class _Record:
    """Content of the record of an emission that other commands need."""

    geometry: Literal["planes", "section"]
    depths_mm: list[Position] = field(default_factory=list)
    cell_mm: list[Length] = field(default_factory=list)
    axis_mm: Position | None = None
    axis_depth_mm: Position | None = None
    radius_mm: Length | None = None
    burner_mm: Position | None = None
    step_mm: Length | None = None
    top_mm: Position | None = None
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    call: str | None = None
    colour: str | None = None
    absorbing: bool = False
    soot_exponent: float | None = None
    gains: list[float] | None = None

    def __post_init__(self):
        of_section = [self.axis_mm, self.axis_depth_mm, self.radius_mm, self.step_mm]
        on_planes, count = self.geometry == "planes", len(self.depths_mm)
        if len(self.cell_mm) != count or on_planes != (count > 0):
            raise InputError(f"planes need depths_mm with a number in cell_mm for each of {count}.")
        if not on_planes and None in of_section:
            raise InputError("a section needs axis_mm, axis_depth_mm, radius_mm and step_mm.")


class EmissionFolder:
    """A folder of `lf-flame reconstruct` or `lf-flame abel`; the numbers it reads are checked.

    A half section is one plane.

    Parameters
    ----------
    folder : str or Path

    Attributes
    ----------
    depths_mm, cell_mm : list of float
        Depth of each plane, and side of its cells, in mm.
    is_section : bool
        Whether it is the half section of an axisymmetric flame.
    emission : ndarray of float32, shape (planes, rows, columns)
    sigma : ndarray of float32, shape of `emission`, or None
    draws : ndarray of float32, shape (draws, planes, rows, columns)
        Bootstrap draws, perhaps none.

    Raises
    ------
    InputError
        If the folder has no such record, a file is missing or damaged, would need too much memory,
        or has another shape than the emission, or a number that is not finite.
    """

    def __init__(self, folder: str | Path):
        self.folder = folder = Path(folder)
        if not (folder / RECORD).exists():
            colours = sorted(printable(path.parent.name) for path in folder.glob(f"*/{RECORD}"))
            it = f"one only in {', '.join(colours[:5])}; give one of these" if colours else "none"
            raise InputError(
                f"{folder} is not a folder of `lf-flame reconstruct` or `lf-flame abel`, which "
                f"contains {RECORD}: there is {it}."
            )
        self.record = record = build(_Record, read_record(folder / RECORD), folder / RECORD)
        self.is_section = record.geometry == "section"
        self.depths_mm: list[Any] = record.depths_mm
        self.cell_mm: list[Any] = record.cell_mm
        if self.is_section:
            self.depths_mm, self.cell_mm = [record.axis_depth_mm], [record.step_mm]
        self.emission = self._read(EMISSION)[0]
        sigma, self.draws = (self._read(name, self.emission) for name in (SIGMA, DRAWS))
        self.sigma = sigma[0] if len(sigma) else None

    def _read(self, name: str, like: np.ndarray | None = None) -> np.ndarray:
        """Read a stack, float32, shape (n, planes, rows, columns), with the shape of another."""
        path, planes = self.folder / name, len(self.depths_mm)
        if like is not None and not path.is_file():
            return np.empty((0, *like.shape), np.float32)
        stack = read_pixels(path)
        shape = stack.shape if stack.ndim > 2 else (1, *stack.shape)
        whole = stack.ndim >= 2 and stack.size and int(np.prod(shape[:-2])) % planes == 0
        if not whole or stack.dtype != np.float32:
            raise InputError(
                f"{path} must contain {planes} planes of float32, got shape {stack.shape} of "
                f"{stack.dtype}."
            )
        stack = stack.reshape(-1, planes, *shape[-2:])
        most = None if name == DRAWS else 1
        wanted = stack.shape[1:] if like is None else like.shape
        if stack.shape[1:] != wanted or (most and len(stack) > most):
            raise InputError(
                f"{path} must contain planes as {EMISSION} does, {wanted}, got {stack.shape}."
            )
        if not np.isfinite(stack).all():
            raise InputError(f"{path} must contain finite numbers, but contains NaN or infinity.")
        return stack

    @property
    def places(self) -> list[Place]:
        """Frame of each plane, about the optical axis, or of the section through the axis.

        Heights are from the section's lower edge if its top is unknown.
        """
        rows, columns = self.emission.shape[1:]
        if self.is_section:
            step, record = self.cell_mm[0], self.record
            side = (columns - 0.5) * step
            high = rows * step if record.top_mm is None else record.top_mm + step / 2
            extent = (-side, side, high - rows * step, high)
            return [Place("section", extent, self.depths_mm[0], "from the axis (mm)", True)]
        found = []
        for depth, side in zip(self.depths_mm, self.cell_mm, strict=True):
            up, across = rows * side / 2, columns * side / 2
            found.append(Place(f"at {depth:+g} mm", (-across, across, -up, up), depth))
        return found


def read_colours_of(*paths: Path) -> list[EmissionFolder]:
    """Read folders of one flame, one for each colour, which must have the same cells and bars."""
    folders = [EmissionFolder(path) for path in paths]
    first = folders[0]
    known = first.record
    for one in folders:
        other = [name for name in CELLS if getattr(one.record, name) != getattr(known, name)]
        if one.emission.shape != first.emission.shape:
            other.append("the shape of their pictures")
        if other:
            advice = ""
            if first.is_section and one.is_section:
                advice = "; run lf-flame abel for the second colour with --axis-mm "
                advice += f"{known.axis_mm!r} --axis-depth {known.axis_depth_mm!r} --radius "
                advice += f"{known.radius_mm!r}"
                advice += "" if known.burner_mm is None else f" --burner {known.burner_mm!r}"
            raise InputError(
                f"{first.folder} and {one.folder} must have the same planes, or the same section, "
                f"of one camera, but differ in {', '.join(other)}{advice}."
            )
    for one in folders:
        if one.sigma is None:
            raise InputError(f"{one.folder} has no {SIGMA}; make it with --bootstrap 20.")
    return folders
