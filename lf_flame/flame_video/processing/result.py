"""Zarr group of a processed video: its arrays, their states, and checks before it is read.

Arrays have the axis ``time`` first, and one chunk a frame; series of numbers have one chunk for the
frames of a task. ``state`` says of each frame what became of it; a frame that is not whole is NaN.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import zarr
from zarr.codecs import Crc32cCodec, ZstdCodec

from lf_flame._common.input_files import readable
from lf_flame._common.memory import check_memory
from lf_flame._common.zarr_files import (
    ZARR_ERRORS,
    array_names,
    open_array,
    read_array_shape,
    read_attributes,
)
from lf_flame.errors import InputError
from lf_flame.flame_video.processing.steps import Values

METADATA = "zarr.json"

KIND = "processed video of light fields"
"""Value of the attribute ``kind``, by which such a group is known."""

STATES = ("to_do", "whole", "missing", "unreadable", "other_exposure", "refused")
"""Meanings of the numbers in ``state``: a missing frame has no file; an unreadable one is damaged,
or of another size; of a refused one, a step could not find its result."""

MAY_BE_EMPTY = ("contour", "temperature", "temperature_sigma")
"""Names of arrays that may be NaN in a whole frame: without a flame there is none of these."""

FINGERPRINT = "fingerprint"
"""Name of the array of checksums, see `steps.fingerprint`; NaN in a frame that was not read."""

TO_DO, WHOLE, MISSING, UNREADABLE, OTHER_EXPOSURE, REFUSED = range(len(STATES))


@dataclass(frozen=True)
class Progress:
    """Number of frames in each state, by its name in `STATES`, and of those that are repeated.

    Attributes
    ----------
    counts : dict of str to int
        Number of frames in each state.
    repeated : int
        Number of frames whose central view is that of the frame before in every pixel, as when a
        frame grabber lost a frame and wrote the last one again.
    """

    counts: dict[str, int]
    repeated: int = 0

    @property
    def frames(self) -> int:
        """Number of all frames."""
        return sum(self.counts.values())

    def describe(self) -> str:
        """Describe the counts in a sentence."""
        some = [f"{n} {name.replace('_', ' ')}" for name, n in self.counts.items() if n]
        told = f"{self.frames} frames: {', '.join(some)}"
        if self.repeated:
            told += (
                f"; {self.repeated} repeat the frame before in every pixel, so that others are "
                f"probably lost and times wrong"
            )
        return told


def create_array(
    group: zarr.Group, name: str, frames: int, values: Values, together: int
) -> zarr.Array:
    """Create an empty array for a step's values of all frames."""
    one = np.asarray(values.values)
    return group.create_array(
        name,
        shape=(frames, *one.shape),
        chunks=(1 if one.ndim else together, *one.shape),
        dtype=one.dtype,
        fill_value=np.nan if one.dtype.kind == "f" else 0,
        compressors=[ZstdCodec(level=3), Crc32cCodec()],
        dimension_names=("time", *values.axes),
        attributes={name: x for name, x in values.attributes.items() if x is not None},
    )


def create_coordinate(group: zarr.Group, name: str, values: Values) -> None:
    """Write a coordinate."""
    along = np.asarray(values.values, np.float64)
    array = group.create_array(
        name, shape=along.shape, chunks=along.shape, dtype="float64", fill_value=np.nan,
        compressors=[ZstdCodec(level=3), Crc32cCodec()], dimension_names=(name,),
        attributes=values.attributes,
    )  # fmt: skip
    array[:] = along


def open_video(path: Path) -> zarr.Group:
    """Open the group of a processed video, finished or not, after checks of its metadata.

    Raises
    ------
    InputError
        If it is something else, or damaged.
    """
    if read_attributes(path).get("kind") != KIND:
        raise InputError(f"{path} is no {KIND}.")
    with readable(path / METADATA, ZARR_ERRORS):
        group = zarr.open_group(path, mode="r")
    for name in array_names(path):
        shape = read_array_shape(path / name)
        if len(shape) == 1:
            check_memory(8 * shape[0], path / name)
    return group


def find_video(path: Path) -> Path:
    """Find a processed video, or the one that is being made under the name NAME.part.

    Raises
    ------
    InputError
        If there is neither.
    """
    for place in (path, path.with_name(path.name + ".part")):
        if (place / METADATA).exists():
            return place
    raise InputError(f"There is no {KIND} at {path}, and none that was begun.")


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Name the folder if Zarr raises an error."""
    with readable(path / METADATA, ZARR_ERRORS, "a frame is"):
        yield


def read_states(group: zarr.Group, path: Path) -> np.ndarray:
    """Read the state of each frame, see `STATES`."""
    with reading(path):
        states = np.asarray(open_array(group, "state")[:])
    if states.size and states.max() >= len(STATES):
        raise InputError(f"{path} is damaged: a state is {states.max()}.")
    return states


def count_frames(group: zarr.Group, path: Path) -> Progress:
    """Count the frames in each state, and those that repeat the frame before.

    Raises
    ------
    InputError
        If the file of a whole frame is missing, which Zarr would read as NaN.
    """
    states = read_states(group, path)
    _refuse_lost_frames(group, states, path)
    counts = np.bincount(states, minlength=len(STATES))
    named = {name: int(n) for name, n in zip(STATES, counts, strict=True)}
    return Progress(named, _count_repeated(group, path))


def _refuse_lost_frames(group: zarr.Group, states: np.ndarray, path: Path) -> None:
    for name in array_names(path):
        array = open_array(group, name)
        if array.ndim == 1 or name in MAY_BE_EMPTY:
            continue
        chunks, rest = path / name / "c", ["0"] * (array.ndim - 1)
        whole = np.flatnonzero(states == WHOLE)
        lost = [row for row in whole if not chunks.joinpath(str(row), *rest).is_file()]
        if lost:
            raise InputError(f"{path} is damaged: {name} of frame {lost[0]} is lost.")


def _count_repeated(group: zarr.Group, path: Path) -> int:
    if FINGERPRINT not in group:  # groups of older versions
        return 0
    with reading(path):
        sums = np.asarray(open_array(group, FINGERPRINT)[:])
    return int(np.count_nonzero(sums[1:] == sums[:-1]))


def look_at(path: str | Path) -> Progress:
    """Count the frames of a processed video that are done, missing, damaged and to do.

    Parameters
    ----------
    path : str or Path
        Folder of the group; while it is made, its name is NAME.part.

    Raises
    ------
    InputError
        If there is none, or it is damaged.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.flame_video import find_steps, look_at, process_frames
    >>> from pathlib import Path
    >>> np.save("0.npy", np.random.default_rng(1).uniform(size=(3, 3, 20, 30)))
    >>> made = process_frames([Path("0.npy")], "out.zarr", find_steps("height"), times_s=[0.0])
    >>> look_at("out.zarr").counts["whole"]
    1
    """
    place = find_video(Path(path))
    return count_frames(open_video(place), place)
