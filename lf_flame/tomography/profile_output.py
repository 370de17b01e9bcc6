"""Output files of emission profiles."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lf_flame._common import figures
from lf_flame._common.output_folders import OutputFolder
from lf_flame.tomography.emission_folder import DRAWS, EmissionFolder
from lf_flame.tomography.figures import profiles_figure
from lf_flame.tomography.output import write_table
from lf_flame.tomography.profiles import Profile, axial, radial

RECORD = "profiles.json"


@dataclass(frozen=True, eq=False)
class Emission:
    """Content of a folder of `lf-flame reconstruct`.

    Attributes
    ----------
    planes : ndarray of float32, shape (planes, rows, columns)
        Emission.
    draws : ndarray of float32, shape (draws, planes, rows, columns)
        Bootstrap draws of the emission, perhaps none.
    depths_mm, cell_mm : list of float
        Depth and cell size of each plane.
    """

    planes: np.ndarray
    draws: np.ndarray
    depths_mm: list[float]
    cell_mm: list[float]


def read_emission(folder: Path) -> Emission:
    """Read a folder of `lf-flame reconstruct`, with its bootstrap draws if it has some.

    Raises
    ------
    InputError
        If the folder is not such a folder, or a file in it is damaged.
    """
    found = EmissionFolder(folder)
    planes = found.emission()
    draws = np.empty((0, *planes.shape), np.float32)
    if found.holds(DRAWS):
        draws = found.read_like(DRAWS, planes, most=None)
    return Emission(planes, draws, found.depths_mm, found.cell_mm)


@dataclass(frozen=True)
class Strips:
    """Positions and widths of the strips of profiles in mm; None: at the centre of the light."""

    across: float | None = None
    width: float = 0.0
    height: float | None = None
    thickness: float = 0.0


def take_profiles(emission: Emission, strips: Strips) -> dict[str, list[Profile]]:
    """Take profiles up and across every depth plane: lists "axial" and "radial"."""
    found: dict[str, list[Profile]] = {"axial": [], "radial": []}
    for k, plane in enumerate(emission.planes):
        one = plane, emission.draws[:, k], emission.cell_mm[k]
        found["axial"].append(axial(*one, strips.across, strips.width))
        found["radial"].append(radial(*one, strips.height, strips.thickness))
    return found


def write_profiles(
    found: dict[str, list[Profile]], depths_mm: list[float], folder: OutputFolder
) -> None:
    """Write ``axial.csv``, ``radial.csv`` and ``profiles.png``."""
    for name, place in (("axial", "height_mm"), ("radial", "across_mm")):
        columns = ["depth_mm", place, "emission", "standard_deviation", "low_95", "high_95"]
        both = zip(depths_mm, found[name], strict=True)
        rows = ([depth, *row] for depth, profile in both for row in _rows(profile))
        write_table(folder.path(f"{name}.csv"), columns, rows)
    figures.save(profiles_figure(found, depths_mm), folder.path("profiles.png"))
    folder.facts["depths_mm"] = depths_mm


def _rows(profile: Profile):
    missing = np.full(len(profile.values), "")
    sigma = missing if profile.sigma is None else profile.sigma
    low, high = (
        missing if profile.band is None else profile.values + sign * profile.band
        for sign in (-1, 1)
    )
    return zip(profile.places_mm, profile.values, sigma, low, high, strict=True)
