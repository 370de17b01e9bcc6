"""Reading folders of `lf-flame abel`: half sections of a flame in two colours or more."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lf_flame._common.config import load_record
from lf_flame._common.images import read_tiff
from lf_flame.errors import InputError
from lf_flame.tomography.emission_folder import Colours, Place

RECORD = "abel.json"
SECTION, SIGMA, DRAWS = "section.tif", "sigma.tif", "draws.tif"


@dataclass(frozen=True)
class SectionRecord:
    """Content of the record of `lf-flame abel` on its half section.

    Attributes
    ----------
    axis_mm, axis_depth_mm, radius_mm : float
        Position and depth of the axis, and radius that contains all emission, in mm.
    step_mm : float
        Distance of nodes in mm.
    burner_mm : float, optional
        Height of the burner in mm.
    top_mm : float, optional
        Height of the first row of nodes from the optical axis in mm.
    """

    axis_mm: float
    axis_depth_mm: float
    radius_mm: float
    step_mm: float
    burner_mm: float | None = None
    top_mm: float | None = None

    @property
    def place(self) -> tuple[float | None, ...]:
        """Numbers that are equal for two sections with the same nodes."""
        return self.axis_mm, self.axis_depth_mm, self.radius_mm, self.step_mm, self.burner_mm


def is_section(folder: Path) -> bool:
    """Whether `lf-flame abel` made a folder."""
    return (folder / RECORD).is_file()


def read_sections(*folders: Path) -> tuple[Colours, Colours, list[Place]]:
    """Read the half sections of one flame, one folder for each colour.

    Returns
    -------
    emissions, sigmas : tuple of ndarray, each of float32, shape (1, heights, radii)
        Emission and standard deviation in each colour.
    places : list of Place
        Place of the section through the axis, one.

    Raises
    ------
    InputError
        If a folder is not one of `lf-flame abel` or has no error bars, or axis, radius or nodes
        differ.
    """
    for folder in folders:
        if not is_section(folder):
            raise InputError(
                f"{' and '.join(map(str, folders))} must all be of lf-flame abel or all of "
                f"lf-flame reconstruct, and {folder} has no {RECORD}."
            )
    records = [load_record(SectionRecord, folder / RECORD) for folder in folders]
    told = records[0]
    for folder, record in zip(folders[1:], records[1:], strict=True):
        if record.place != told.place:
            place = f"--axis-mm {told.axis_mm!r} --axis-depth {told.axis_depth_mm!r}"
            place += f" --radius {told.radius_mm!r}"
            place += "" if told.burner_mm is None else f" --burner {told.burner_mm!r}"
            raise InputError(
                f"{folders[0]} and {folder} must have the same axis, radius, burner and cells; "
                f"call lf-flame abel for the second colour with the first one's numbers, {place}."
            )
    emissions = tuple(_read(folder, SECTION) for folder in folders)
    sigmas = tuple(_read(folder, SIGMA) for folder in folders)
    shapes = {stack.shape for stack in (*emissions, *sigmas)}
    if len(shapes) > 1:
        raise InputError(
            f"The sections of {' and '.join(map(str, folders))} must be of one shape, got "
            f"{sorted(shapes)}."
        )
    return emissions, sigmas, [_place(told, emissions[0].shape[1:])]


def _place(record: SectionRecord, nodes: tuple[int, ...]) -> Place:
    """Place of the whole section; heights are from its lower edge if its top is unknown."""
    step, (heights, radii) = record.step_mm, nodes
    side = (radii - 0.5) * step
    high = heights * step if record.top_mm is None else record.top_mm + step / 2
    extent = (-side, side, high - heights * step, high)
    return Place("section", extent, record.axis_depth_mm, "from the axis (mm)", mirrored=True)


def read_draws(*folders: Path) -> Colours | None:
    """Read the draws of the half sections, (draws, 1, heights, radii); None if a folder has none.

    Raises
    ------
    InputError
        If a file holds anything but finite numbers.
    """
    if not all((folder / DRAWS).is_file() for folder in folders):
        return None
    return tuple(_read(folder, DRAWS, axes=3)[0][:, np.newaxis] for folder in folders)


def _read(folder: Path, name: str, axes: int = 2) -> np.ndarray:
    path = folder / name
    if not path.is_file():
        raise InputError(f"{folder} has no {name}; call lf-flame abel with --bootstrap 20.")
    stack = read_tiff(path)
    if stack.ndim != axes or stack.dtype != np.float32 or not np.isfinite(stack).all():
        raise InputError(
            f"{path} must hold a half section of finite float32, got shape {stack.shape} of "
            f"{stack.dtype}."
        )
    return stack[np.newaxis]
