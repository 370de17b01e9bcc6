"""Work of a process or a machine on the frames of a video: read, apply all steps, write."""

import pickle
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import zarr

from lf_flame.errors import InputError
from lf_flame.flame_video.processing import result
from lf_flame.flame_video.processing.steps import Frame, Step, Values, fingerprint
from lf_flame.formats.exposure import read_exposure
from lf_flame.lightfield import LightField

SAME_EXPOSURE = 0.01
"""Largest relative difference of equal exposures; cameras round theirs."""


class Done(NamedTuple):
    """Outcome of a frame: its number, its state, and sentences on it."""

    frame: int
    state: int
    said: tuple[str, ...]


@dataclass
class Job:
    """Everything needed to process a frame, on any machine; what it learns is kept.

    Attributes
    ----------
    steps : tuple of Step
    read : callable
        Reader of a frame.
    model : Path
        Frame whose shape and exposure the others must have.
    """

    steps: tuple[Step, ...]
    read: Callable[[Path], LightField]
    model: Path

    def __post_init__(self):
        self.shape: tuple[int, ...] | None = None
        self.before: dict[str, Any] = {}
        self.exposure = read_exposure(self.model)

    def __call__(self, path: Path | None) -> tuple[int, dict[str, Values], tuple[str, ...]]:
        """Process a frame: its state, the values that were found, and sentences."""
        if path is None:
            return result.MISSING, {}, ()
        if not path.exists():
            return result.MISSING, {}, (f"{path} is gone",)
        try:
            exposure = read_exposure(path)
            light_field = self.read(path)
        except (InputError, OSError) as error:
            return result.UNREADABLE, {}, (str(error),)
        if light_field.shape != self._shape():
            said = f"{path} has the shape {light_field.shape}, the first frame {self._shape()}"
            return result.UNREADABLE, {}, (said,)
        if exposure and self.exposure and abs(exposure / self.exposure - 1) > SAME_EXPOSURE:
            said = f"{path} was exposed for {exposure:g} s, the first frame for {self.exposure:g} s"
            return result.OTHER_EXPOSURE, {}, (said,)
        return self.apply(Frame(light_field, before=self.before), path)

    def apply(self, frame: Frame, path: Path) -> tuple[int, dict[str, Values], tuple[str, ...]]:
        """Apply the steps to a frame; one that is refused leaves the others."""
        values = fingerprint(frame.image)
        state = result.WHOLE
        for step in self.steps:
            try:
                values |= step(frame)
            except InputError as error:
                state = result.REFUSED
                frame.warnings.append(str(error))
        return state, values, tuple(f"{path.name}: {said}" for said in frame.warnings)

    def _shape(self) -> tuple[int, ...]:
        if self.shape is None:
            self.shape = self.read(self.model).shape
        return self.shape


@lru_cache(maxsize=2)
def _load(job: bytes) -> Job:
    """Unpack a job once in each process: plans and compiled programs stay for all its tasks."""
    return pickle.loads(job)


@dataclass(frozen=True)
class Task:
    """Some frames of a job, whole chunks of all arrays.

    Attributes
    ----------
    job : bytes
        The job, pickled.
    folder : str
        Folder of the group.
    first : int
        Number of the first frame.
    paths : tuple of Path or None
        Paths of the frames; None for a missing one.
    """

    job: bytes
    folder: str
    first: int
    paths: tuple[Path | None, ...]

    def __call__(self) -> list[Done]:
        """Process the frames, one at a time in memory, and write them."""
        job, group = _load(self.job), zarr.open_group(self.folder, mode="r+")
        arrays = {name: array for name, array in group.arrays() if "time" in _axes(array)}
        last = self.first + len(self.paths)
        series = {
            name: np.full(len(self.paths), array.fill_value, array.dtype)
            for name, array in arrays.items()
            if array.ndim == 1 and name != "time"
        }
        job.before.clear()  # the same bytes, whatever a worker has done before
        done = []
        for frame, path in enumerate(self.paths, self.first):
            state, values, said = job(path)
            for name, array in arrays.items():
                if name in series and name in values:
                    series[name][frame - self.first] = values[name].values
                elif array.ndim > 1:
                    # NaN too, which removes what an earlier run may have written.
                    array[frame] = values[name].values if name in values else np.nan
            series["state"][frame - self.first] = state
            done.append(Done(frame, state, said))
        whole = series.pop("state")
        for name, numbers in series.items():
            arrays[name][self.first : last] = numbers
        arrays["state"][self.first : last] = whole  # last: a chunk without it is made again
        return done


def _axes(array: zarr.Array) -> tuple:
    return array.metadata.dimension_names or ()  # type: ignore[union-attr]
