"""Reading folders of `lf-flame reconstruct`."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lf_flame._common.config import load_record
from lf_flame._common.images import read_tiff
from lf_flame.errors import InputError
from lf_flame.optics.camera import LONGEST, SHORTEST

RECORD = "reconstruct.json"
EMISSION, SIGMA, DRAWS, CORRECTION = "emission.tif", "sigma.tif", "draws.tif", "correction.tif"


@dataclass(frozen=True)
class EmissionRecord:
    """Content of the record of a reconstruction on its depth planes.

    Attributes
    ----------
    depths_mm, cell_mm : list of float
        Depth of each plane, and side of its cells, from `SHORTEST` to `LONGEST`; lists of equal
        length.
    """

    depths_mm: list[float]
    cell_mm: list[float]

    def __post_init__(self):
        if not 1 <= len(self.depths_mm) == len(self.cell_mm):
            raise InputError(
                f"depths_mm and cell_mm must hold a number for each plane, got "
                f"{len(self.depths_mm)} and {len(self.cell_mm)}."
            )
        for side in self.cell_mm:
            if not SHORTEST <= side <= LONGEST:
                raise InputError(
                    f"cell_mm must hold lengths from {SHORTEST:g} to {LONGEST:g} mm, got {side}."
                )


class EmissionFolder:
    """A folder of `lf-flame reconstruct`.

    Parameters
    ----------
    folder : str or Path

    Attributes
    ----------
    depths_mm, cell_mm : list of float
        Depth of each plane, and side of its cells, in mm.

    Raises
    ------
    InputError
        If the folder has no such record.
    """

    def __init__(self, folder: str | Path):
        self.folder = folder = Path(folder)
        if not (folder / RECORD).exists():
            raise InputError(
                f"{folder} is no folder of `lf-flame reconstruct`: there is no {RECORD} in it."
            )
        record = load_record(EmissionRecord, folder / RECORD)
        self.depths_mm, self.cell_mm = record.depths_mm, record.cell_mm

    def holds(self, name: str) -> bool:
        """Whether the folder holds a file."""
        return (self.folder / name).is_file()

    def read(self, name: str) -> np.ndarray:
        """Read a stack of depth planes, float32.

        Returns
        -------
        ndarray of float32, shape (n, planes, rows, columns)

        Raises
        ------
        InputError
            If the file is missing or damaged, would need too much memory, or is anything but finite
            planes.
        """
        path = self.folder / name
        stack = read_tiff(path)
        planes = len(self.depths_mm)
        shape = stack.shape if stack.ndim > 2 else (1, *stack.shape)
        flat = int(np.prod(shape[:-2]))
        if stack.ndim < 2 or stack.dtype != np.float32 or flat == 0 or flat % planes:
            raise InputError(
                f"{path} must hold {planes} planes of float32, got shape {stack.shape} of "
                f"{stack.dtype}."
            )
        if not np.isfinite(stack).all():
            raise InputError(f"{path} must hold finite numbers, and holds NaN or infinity.")
        return stack.reshape(-1, planes, *shape[-2:])

    def read_like(self, name: str, planes: np.ndarray, most: int | None = 1) -> np.ndarray:
        """Read a stack with the shape of the emission, such as its standard deviation.

        Parameters
        ----------
        name : str
        planes : ndarray, shape (planes, rows, columns)
            Emission.
        most : int, optional
            Largest number of stacks in the file; None for any number.

        Returns
        -------
        ndarray of float32, shape (n, planes, rows, columns)

        Raises
        ------
        InputError
            As for `read`, and if the shape is not that of the emission.
        """
        stack = self.read(name)
        if stack.shape[1:] != planes.shape or (most is not None and len(stack) > most):
            raise InputError(
                f"{self.folder / name} must hold planes as {EMISSION} does, {planes.shape}, got "
                f"{stack.shape[1:] if len(stack) == 1 else stack.shape}."
            )
        return stack

    def emission(self) -> np.ndarray:
        """Read the emission, float32, shape (planes, rows, columns)."""
        stack = self.read(EMISSION)
        if len(stack) > 1:
            raise InputError(
                f"{self.folder / EMISSION} must hold {len(self.depths_mm)} planes, got "
                f"{len(stack) * len(self.depths_mm)}."
            )
        return stack[0]


Colours = tuple[np.ndarray, ...]


@dataclass(frozen=True)
class Place:
    """Place of a map of temperatures: a depth plane, or the section through a flame's axis.

    Attributes
    ----------
    title : str
        Name of the place.
    extent_mm : tuple of float
        Left, right, lower and upper edge of the map.
    depth_mm : float
        Depth of the plane, or of the axis.
    across : str
        Label of the horizontal axis.
    mirrored : bool
        Whether maps are a half section, which begins on the axis; `extent_mm` is that of the whole.
    """

    title: str
    extent_mm: tuple[float, float, float, float]
    depth_mm: float
    across: str = "across (mm)"
    mirrored: bool = False

    def whole(self, planes: np.ndarray) -> np.ndarray:
        """Give the maps of the whole place: a half section with its mirror image."""
        return np.concatenate([planes[..., :0:-1], planes], -1) if self.mirrored else planes


def read_emissions(*paths: Path) -> tuple[Colours, Colours, list[Place]]:
    """Read folders of one camera with the same depth planes, one for each colour.

    Returns
    -------
    emissions, sigmas : tuple of ndarray, each of shape (planes, rows, columns)
        Emission and standard deviation of each folder.
    places : list of Place
        Place of each plane.

    Raises
    ------
    InputError
        If a folder is not one of `lf-flame reconstruct` or has no error bars, or the planes differ.
    """
    folders = [EmissionFolder(path) for path in paths]
    first, emissions = folders[0], [folder.emission() for folder in folders]
    for folder, emission in zip(folders[1:], emissions[1:], strict=True):
        same = f"{first.folder} and {folder.folder} must hold the same planes of one camera: their"
        if (folder.depths_mm, folder.cell_mm) != (first.depths_mm, first.cell_mm):
            raise InputError(f"{same} depths are {first.depths_mm} and {folder.depths_mm} mm.")
        if emission.shape != emissions[0].shape:
            raise InputError(f"{same} shapes are {emissions[0].shape} and {emission.shape}.")
    for folder in folders:
        if not folder.holds(SIGMA):
            raise InputError(
                f"{folder.folder} has no {SIGMA}; call lf-flame reconstruct with --bootstrap 20."
            )
    sigmas = tuple(folder.read_like(SIGMA, emissions[0])[0] for folder in folders)
    return tuple(emissions), sigmas, _places(first, emissions[0].shape[1:])


def read_draws(*paths: Path) -> Colours | None:
    """Read the bootstrap draws of folders, each (draws, planes, rows, columns); None without.

    Raises
    ------
    InputError
        If a file does not hold planes as the emission.
    """
    folders = [EmissionFolder(path) for path in paths]
    if not all(folder.holds(DRAWS) for folder in folders):
        return None
    return tuple(one.read_like(DRAWS, one.emission(), most=None) for one in folders)


def _places(folder: EmissionFolder, cells: tuple[int, ...]) -> list[Place]:
    """Place of each depth plane: the field of the central view, about the optical axis."""
    places = []
    for depth, side in zip(folder.depths_mm, folder.cell_mm, strict=True):
        up, across = (count * side / 2 for count in cells)
        places.append(Place(f"at {depth:+g} mm", (-across, across, -up, up), depth))
    return places
