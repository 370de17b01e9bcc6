"""Reading folders of `lf-flame abel`: half sections of a flame in two colours."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lf_flame._common.checksums import file_sha256
from lf_flame._common.config import load_record
from lf_flame._common.tiff_files import read_tiff
from lf_flame.errors import InputError
from lf_flame.tomography.emission_folder import Pair

RECORD = "abel.json"
SECTION, SIGMA = "section.tif", "sigma.tif"


@dataclass(frozen=True)
class SectionRecord:
    """Content of the record of `lf-flame abel` on its half section.

    Attributes
    ----------
    axis_mm, axis_depth_mm, radius_mm : float
        Position and depth of the axis, and radius that contains all emission, in mm.
    step_mm : float
        Distance of nodes in mm.
    files : dict of str
        SHA-256 of each file by its name.
    burner_mm : float, optional
        Height of the burner in mm.
    """

    axis_mm: float
    axis_depth_mm: float
    radius_mm: float
    step_mm: float
    files: dict[str, str]
    burner_mm: float | None = None

    @property
    def place(self) -> tuple[float | None, ...]:
        """Numbers that are equal for two sections with the same nodes."""
        return self.axis_mm, self.axis_depth_mm, self.radius_mm, self.step_mm, self.burner_mm


def is_section(folder: Path) -> bool:
    """Whether `lf-flame abel` made a folder."""
    return (folder / RECORD).is_file()


def read_sections(first: Path, second: Path) -> tuple[Pair, Pair, list[float]]:
    """Read the half sections of one flame in two colours.

    Returns
    -------
    emissions, sigmas : (ndarray, ndarray), each of float32, shape (1, heights, radii)
        Emission and standard deviation in both colours.
    depths_mm : list of float
        Depth of the axis, one number.

    Raises
    ------
    InputError
        If a folder is not one of `lf-flame abel` or has no error bars, or axis, radius or nodes
        differ.
    """
    for folder in (first, second):
        if not is_section(folder):
            raise InputError(
                f"{first} and {second} must both be of lf-flame abel or both of lf-flame "
                f"reconstruct, and {folder} has no {RECORD}."
            )
    records = [load_record(SectionRecord, folder / RECORD) for folder in (first, second)]
    if records[0].place != records[1].place:
        told = records[0]
        place = f"--axis-mm {told.axis_mm!r} --axis-depth {told.axis_depth_mm!r}"
        place += f" --radius {told.radius_mm!r}"
        place += "" if told.burner_mm is None else f" --burner {told.burner_mm!r}"
        raise InputError(
            f"{first} and {second} must have the same axis, radius, burner and cells; call "
            f"lf-flame abel for the second colour with the first one's numbers, {place}."
        )
    pairs = []
    for name in (SECTION, SIGMA):
        one, other = (
            _read(folder, name, record)
            for folder, record in zip((first, second), records, strict=True)
        )
        pairs.append((one, other))
    shapes = {stack.shape for pair in pairs for stack in pair}
    if len(shapes) > 1:
        raise InputError(
            f"The sections of {first} and {second} must be of one shape, got {sorted(shapes)}."
        )
    return pairs[0], pairs[1], [records[0].axis_depth_mm]


def _read(folder: Path, name: str, record: SectionRecord) -> np.ndarray:
    path = folder / name
    if name not in record.files:
        raise InputError(f"{folder} has no {name}; call lf-flame abel with --bootstrap 20.")
    if file_sha256(path) != record.files[name]:
        raise InputError(f"{path} is not the file that {RECORD} was written for.")
    stack = read_tiff(path)
    if stack.ndim != 2 or stack.dtype != np.float32 or not np.isfinite(stack).all():
        raise InputError(
            f"{path} must hold a half section of finite float32, got shape {stack.shape} of "
            f"{stack.dtype}."
        )
    return stack[np.newaxis]
