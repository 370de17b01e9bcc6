"""Folders of `lf-flame reconstruct`, read back: only what their record vouches for."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lf_flame._common.checksums import file_sha256
from lf_flame._common.config import load_record
from lf_flame._common.tiff_files import read_tiff
from lf_flame.errors import InputError

RECORD = "reconstruct.json"
EMISSION, SIGMA, DRAWS, CORRECTION = "emission.tif", "sigma.tif", "draws.tif", "correction.tif"


@dataclass(frozen=True)
class EmissionRecord:
    """What the record of a reconstruction says of its planes.

    Attributes
    ----------
    depths_mm, cell_mm : list of float
        Depth of each plane, and side of its cells, above 0; as many of one as of the other.
    files : dict of str, or list of str, optional
        SHA-256 of each file by its name. Older versions knew only names, or none.
    """

    depths_mm: list[float]
    cell_mm: list[float]
    files: dict[str, str] | list[str] | None = None

    def __post_init__(self):
        if not 1 <= len(self.depths_mm) == len(self.cell_mm):
            raise InputError(
                f"depths_mm and cell_mm must hold a number for each plane, got "
                f"{len(self.depths_mm)} and {len(self.cell_mm)}."
            )
        if not min(self.cell_mm) > 0:
            raise InputError(f"cell_mm must be above 0, got {min(self.cell_mm)}.")


class EmissionFolder:
    """A folder of `lf-flame reconstruct`, whose files are checked against its record.

    Parameters
    ----------
    folder : str or Path

    Attributes
    ----------
    depths_mm, cell_mm : list of float
        Depth of each plane, and side of its cells.

    Raises
    ------
    InputError
        If the folder has no such record, or one without hashes.
    """

    def __init__(self, folder: str | Path):
        self.folder = folder = Path(folder)
        record = load_record(EmissionRecord, folder / RECORD)
        if not isinstance(record.files, dict):
            raise InputError(
                f"{folder / RECORD} has no hashes of its files, as records of older versions; call "
                f"lf-flame reconstruct again."
            )
        self.depths_mm, self.cell_mm, self._hashes = record.depths_mm, record.cell_mm, record.files

    def holds(self, name: str) -> bool:
        """Whether the record names a file."""
        return name in self._hashes

    def read(self, name: str) -> np.ndarray:
        """Read planes of floats.

        Returns
        -------
        ndarray of float32, shape (n, planes, rows, columns)

        Raises
        ------
        InputError
            If the file is missing or is not the one that was written, would need too much memory,
            or holds anything but finite planes.
        """
        path = self.folder / name
        if not self.holds(name):
            raise InputError(f"{self.folder / RECORD} names no {name}.")
        if file_sha256(path) != self._hashes[name]:
            raise InputError(f"{path} is not the file that {RECORD} was written for.")
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
        """Read a file that holds what goes with the emission, cell by cell.

        Parameters
        ----------
        name : str
        planes : ndarray, shape (planes, rows, columns)
            The emission.
        most : int, optional
            Number of such stacks at most; None for any.

        Returns
        -------
        ndarray of float32, shape (n, planes, rows, columns)

        Raises
        ------
        InputError
            As `read`, and if the shape is not that of the emission.
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


Pair = tuple[np.ndarray, np.ndarray]


def read_emissions(first: Path, second: Path) -> tuple[Pair, Pair, list[float]]:
    """Read two folders of one camera and the same planes.

    Returns
    -------
    emissions, sigmas : (ndarray, ndarray), each of shape (planes, rows, columns)
    depths_mm : list of float

    Raises
    ------
    InputError
        If a folder is no such, has no error bars, or their planes differ.
    """
    one, other = folders = EmissionFolder(first), EmissionFolder(second)
    if (one.depths_mm, one.cell_mm) != (other.depths_mm, other.cell_mm):
        raise InputError(
            f"{first} and {second} must hold the same planes of one camera: their depths are "
            f"{one.depths_mm} and {other.depths_mm} mm."
        )
    for folder in folders:
        if not folder.holds(SIGMA):
            raise InputError(
                f"{folder.folder} has no {SIGMA}; call lf-flame reconstruct with --bootstrap 20."
            )
    emissions = one.emission(), other.emission()
    if emissions[0].shape != emissions[1].shape:
        raise InputError(
            f"{first} and {second} must hold the same planes of one camera: their shapes are "
            f"{emissions[0].shape} and {emissions[1].shape}."
        )
    sigmas = (
        one.read_like(SIGMA, emissions[0])[0],
        other.read_like(SIGMA, emissions[1])[0],
    )
    return emissions, sigmas, one.depths_mm
