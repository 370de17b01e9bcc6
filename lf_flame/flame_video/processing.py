"""Processing of the frames of a video by processes or machines, into one Zarr group.

Arrays have the axis ``time`` first. Images have one chunk for each frame; numbers and contours have
one for the frames of a task. A task takes the same frames whichever process runs it, starts anew,
and writes whole chunks of its own: the bytes do not depend on the workers, and a run that was
interrupted continues with the tasks that are missing. ``state`` says what became of each frame;
missing results are NaN.
"""

import math
import pickle
import re
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import zarr
from numpy.typing import ArrayLike
from zarr.codecs import Crc32cCodec, ZstdCodec

from lf_flame._common import progress, provenance
from lf_flame._common.atomic_files import atomic_folder, exclusive, recorded_path, remove_leftovers
from lf_flame._common.workers import carry_out
from lf_flame.errors import InputError
from lf_flame.flame_video.steps import Frame, Step, Values
from lf_flame.formats.array_files import ZarrFile
from lf_flame.formats.reading import read_light_field
from lf_flame.lightfield import LightField
from lf_flame.optics.lens import Lens

LEAST_TOGETHER, MOST_TASKS = 8, 1000
"""Smallest number of frames in a task, and largest number of tasks, and of files of a series."""

KIND = "processed video of light fields"
"""Value of the attribute ``kind``, by which such a group is known."""

STATES = ("to_do", "whole", "missing", "unusable")
"""Meanings of the numbers in ``state``: a missing frame has no file; an unusable one is damaged, of
another size, or a step could not find its result."""

TO_DO, WHOLE, MISSING, UNUSABLE = range(len(STATES))


class Progress(NamedTuple):
    """Number of frames in each state, by its name in `STATES`."""

    counts: dict[str, int]

    def describe(self) -> str:
        """Describe the counts in a sentence."""
        some = [f"{n} {name.replace('_', ' ')}" for name, n in self.counts.items() if n]
        return f"{sum(self.counts.values())} frames: {', '.join(some)}"


class FrameOutcome(NamedTuple):
    """Outcome of a frame: its number, its state, and sentences on it."""

    frame: int
    state: int
    said: tuple[str, ...]


def process_frames(
    paths: Sequence[Path | None],
    out: str | Path,
    steps: Sequence[Step],
    *,
    times_s: ArrayLike,
    time_unit: str = "s",
    read: Callable[[Path], LightField] = read_light_field,
    camera: Lens | None = None,
    workers: int = 1,
    executor: Executor | None = None,
    on_frame: Callable[[FrameOutcome], None] | None = None,
) -> Progress:
    """Process the frames of a video into a Zarr group, or finish one that was interrupted.

    A frame that is missing, damaged, or of another size than the first becomes NaN in all arrays
    (0 in those of integers), and the array ``state`` says so. The result is the same for any number
    of workers.

    Parameters
    ----------
    paths : sequence of Path or None
        Frames in the order of time; None for a missing one.
    out : str or Path
        Folder of the Zarr group; until it is finished it is called NAME.part.
    steps : sequence of Step
        Steps, as from `find_steps`.
    times_s : array_like, shape (frames,)
        Time of each frame.
    time_unit : str, optional
        Unit of those times, recorded with them.
    read : callable, optional
        Picklable function that reads a frame; an attribute ``description`` states its options.
    camera : Lens, optional
        Camera of the frames, which is checked and recorded.
    workers : int, optional
        Number of processes; 1 works in this one.
    executor : concurrent.futures.Executor or distributed.Client, optional
        Executor or Dask cluster to use instead; its machines see all folders by the same names.
    on_frame : callable, optional
        Function of `FrameOutcome` that is called for each frame.

    Returns
    -------
    Progress
        Number of frames in each state: to do, whole, missing or unusable.

    Raises
    ------
    InputError
        If the first frame cannot be processed, the folder contains something else, or was made
        of other frames, or frames in another folder, by other steps or with another camera.
    OSError
        If a file cannot be written; finished frames are kept.

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from lf_flame.flame_video import find_steps, process_frames
    >>> rng = np.random.default_rng(1)
    >>> for k in range(3):
    ...     np.save(f"{k}.npy", rng.uniform(size=(3, 3, 20, 30)))
    >>> paths = [Path("0.npy"), None, Path("2.npy")]
    >>> steps = find_steps("refocus@0.5,height")  # refocused at slope 0.5; height of the flame
    >>> process_frames(paths, "flame.zarr", steps, times_s=[0.0, 0.01, 0.02]).describe()
    '3 frames: 2 whole, 1 missing'
    """
    out, steps, times = Path(out), tuple(steps), np.asarray(times_s, np.float64)
    first = next((path for path in paths if path), None)
    if not steps or first is None:
        raise InputError(f"A frame and a step are needed, got {len(paths)} and {len(steps)}.")
    if times.shape != (len(paths),) or not (np.diff(times) > 0).all() or not np.isfinite(times[-1]):
        raise InputError(f"times_s must be an increasing time for each of the {len(paths)} frames.")
    request = {
        "steps": [repr(step) for step in steps],
        "camera": repr(camera),
        "reading": getattr(read, "description", re.sub(" at 0x[0-9a-f]+", "", repr(read))),
        "frames": [path and path.name for path in paths],
        # Another recording may have the same names.
        "folders": sorted(recorded_path(x, out) for x in {path.parent for path in paths if path}),
    }
    if not out.name:
        raise InputError(f"{out} cannot be made: name a new folder.")
    if workers < 1:
        raise InputError(f"workers must be 1 or more, got {workers}.")
    part = out.with_name(out.name + ".part")
    with exclusive(out):
        place = out if out.is_symlink() or out.exists() else part
        if not place.exists():
            when = Values(times, ("time",), {"units": time_unit})
            _begin(part, request, when, read(first), steps, camera)
        video = _open_same(place, request, times)
        if place == part:
            _run(part, video, (steps, read), paths, workers, executor, on_frame)
            _finish(part, out)
            video = open_video(out)
        return count_frames(video)


def _open_same(place: Path, request: dict, times: np.ndarray) -> ZarrFile:
    """Open the group of a request; refuse that of other frames, times, steps or options."""
    video = open_video(place)
    other = [name for name, value in request.items() if video.attributes.get(name) != value]
    if not np.array_equal(video.read_begun("time"), times):
        other.append("times")
    if other:
        moved = f", or move the frames back to {video.attributes.get('folders')}, relative to it"
        raise InputError(
            f"{place} was made with other {', '.join(other)}; remove it, or choose another folder"
            f"{moved if other == ['folders'] else ''}."
        )
    return video


def _begin(part: Path, request: dict, when: Values, light_field: LightField, steps, camera) -> None:
    """Create the group with empty arrays as the first frame fills them; it appears complete."""
    if camera is not None:
        camera.check_views(light_field.shape)
    flags = {"flag_values": list(range(len(STATES))), "flag_meanings": " ".join(STATES)}
    values = {"time": when, "state": Values(np.uint8(TO_DO), (), flags)}
    with progress.stage("Processing the first frame"):
        values |= Frame(light_field).take(steps)
    frames = len(when.values)
    remove_leftovers(part)
    with atomic_folder(part) as aside:
        group = zarr.open_group(aside, mode="w", zarr_format=3)
        for name, found in values.items():
            one, fixed = np.asarray(found.values), found.axes == (name,)
            # Numbers and contours share chunks.
            most = max(LEAST_TOGETHER, math.ceil(frames / MOST_TASKS))
            together = most if one.size <= 1024 else 1
            array = group.create_array(
                name,
                shape=one.shape if fixed else (frames, *one.shape),
                chunks=one.shape if fixed else (together, *one.shape),
                dtype=one.dtype,
                fill_value=np.nan if one.dtype.kind == "f" else 0,
                compressors=[ZstdCodec(level=3), Crc32cCodec()],
                dimension_names=found.axes if fixed else ("time", *found.axes),
                attributes={name: x for name, x in found.attributes.items() if x is not None},
            )
            if fixed:
                array[:] = one
        group.update_attributes({**request, "shape": list(light_field.shape), "kind": KIND})


def _run(part: Path, video: ZarrFile, job: tuple, paths, workers: int, executor, on_frame) -> None:
    """Carry out the tasks that are missing."""
    packed, to_do = pickle.dumps(job), video.read_begun("state") == TO_DO
    together = video.arrays["state"].chunks[0]
    runs = [slice(start, start + together) for start in range(0, len(paths), together)]
    runs = [run for run in runs if to_do[run].any()]
    tasks = [partial(_task, packed, str(part.resolve()), run.start, paths[run]) for run in runs]
    before = len(paths) - sum(len(paths[run]) for run in runs)
    connect = getattr(executor, "get_executor", lambda: executor)  # of a Dask client
    with progress.bar("processing", len(paths), "frame", stays=True, initial=before) as shown:
        for done in carry_out(tasks, workers, connect()):
            shown.update()
            if on_frame is not None:
                on_frame(done)


def _finish(part: Path, out: Path) -> None:
    """Record what became of the frames, and give the group its final name."""
    for left in part.rglob("*.partial"):  # of a write of Zarr's that was killed
        left.unlink(missing_ok=True)
    facts = {"counts": count_frames(open_video(part)).counts}
    group = zarr.open_group(part, mode="r+")
    group.update_attributes({**facts, "provenance": provenance.environment()})
    part.rename(out)


@lru_cache(maxsize=2)
def _load(job: bytes) -> tuple[tuple[Step, ...], Callable[[Path], LightField]]:
    """Unpack a job once in each process: plans and compiled programs stay for all its tasks."""
    return pickle.loads(job)


def _task(job: bytes, folder: str, first: int, paths: Sequence[Path | None]) -> list[FrameOutcome]:
    """Process frames from number `first` on, one at a time in memory, and write whole chunks."""
    # Chunks of NaN get files as well, so that a file that is lost is noticed.
    with zarr.config.set({"array.write_empty_chunks": True}):
        group = zarr.open_group(folder, mode="r+")
        every: list[tuple[str, Any]] = list(group.arrays())
    # Coordinates, which are whole already, are named after their axis.
    arrays = {name: one for name, one in every if one.metadata.dimension_names != (name,)}
    (steps, read), count = _load(job), len(paths)
    shape = tuple(dict[str, Any](group.attrs)["shape"])
    series = {
        name: np.full((count, *array.shape[1:]), array.fill_value, array.dtype)
        for name, array in arrays.items()
        if array.chunks[0] > 1
    }
    before, done = dict[str, Any](), []  # each task anew, whatever its worker did before
    for frame, path in enumerate(paths):
        state, values, said = _process(path, steps, read, shape, before)
        for name, array in arrays.items():
            found = values[name].values if name in values else array.fill_value
            if name in series:
                series[name][frame] = found
            else:
                array[first + frame] = found
        series["state"][frame] = state
        done.append(FrameOutcome(first + frame, state, said))
    for name in sorted(series, key="state".__eq__):  # last: a chunk without it is made again
        arrays[name][first : first + count] = series[name]
    return done


def _process(path: Path | None, steps: Sequence[Step], read, shape, before: dict[str, Any]):
    """Process a frame: its state, the values that were found, and sentences."""
    if path is None:
        return MISSING, {}, ()
    if not path.exists():  # as where a network drive is gone for a moment
        raise InputError(f"{path} is no longer there; the same command resumes when it is.")
    try:
        light_field = read(path)
        if light_field.shape != shape:
            raise InputError(f"it has the shape {light_field.shape}, the first {shape}")
        frame = Frame(light_field, before)
        values = frame.take(steps)
    except (InputError, OSError) as error:
        return UNUSABLE, {}, (f"{path.name}: {error}",)
    return WHOLE, values, tuple(f"{path.name}: {said}" for said in frame.warnings)


def open_video(path: Path) -> ZarrFile:
    """Open the group of a processed video, finished or not."""
    video = ZarrFile(path)
    if video.attributes.get("kind") != KIND or not {"time", "state"} <= {*video.names}:
        raise InputError(f"{path} is not a {KIND}.")
    return video


def is_video(path: Path) -> bool:
    """Whether a folder is the group of a processed video that is finished."""
    return (path / "zarr.json").is_file() and ZarrFile(path).attributes.get("kind") == KIND


def count_frames(video: ZarrFile) -> Progress:
    """Count the frames in each state; refuse a finished group of which a file is lost."""
    states = video.read_begun("state")
    if states.all():  # finished
        for name in video.names:
            video.refuse_missing_files(name)
    counts = np.bincount(states, minlength=len(STATES))
    return Progress({name: int(n) for name, n in zip(STATES, counts, strict=True)})
