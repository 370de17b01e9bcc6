"""Processing of the frames of a video by processes or machines, into one Zarr group.

Every task takes the same frames whoever carries it out, begins anew, and writes whole chunks of its
own. Therefore the bytes do not depend on the workers, and a run that was interrupted continues with
the tasks that are missing.
"""

import math
import pickle
import re
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from lf_flame._common import progress as bars
from lf_flame._common import provenance
from lf_flame._common.atomic_files import atomic_folder, remove_leftovers
from lf_flame._common.locks import exclusive
from lf_flame._common.workers import carry_out
from lf_flame._common.zarr_files import open_array
from lf_flame.errors import InputError
from lf_flame.flame_video.processing import result
from lf_flame.flame_video.processing.jobs import Done, Job, Task
from lf_flame.flame_video.processing.result import KIND, Progress
from lf_flame.flame_video.processing.steps import Frame, Step, Values, fingerprint
from lf_flame.formats.reading import read_light_field
from lf_flame.lightfield import LightField
from lf_flame.optics.lens import Lens

LEAST_TOGETHER, MOST_TASKS = 8, 1000
"""Smallest number of frames in a task, and largest number of tasks, and of files of a series."""

TRIED = 8
"""Number of frames from the start among which one must be sound."""


def process_frames(
    paths: Sequence[Path | None],
    out: str | Path,
    steps: Sequence[Step],
    *,
    times_s: Sequence[float],
    time_unit: str = "s",
    read: Callable[[Path], LightField] = read_light_field,
    camera: Lens | None = None,
    workers: int = 1,
    executor: Executor | None = None,
    progress: Callable[[Iterable, int, int], Iterable] | None = None,
    tell: Callable[[Done], None] | None = None,
) -> Progress:
    """Process the frames of a video into a Zarr group, or finish one that was interrupted.

    A frame that is missing, damaged, or of another size or exposure than the first valid one
    becomes NaN in all arrays, and the array ``state`` says so. Images have one chunk for each
    frame. The result is the same for any number of workers.

    Parameters
    ----------
    paths : sequence of Path or None
        Frames in the order of time; None for a missing one.
    out : str or Path
        Folder of the Zarr group; until it is finished it is called NAME.part.
    steps : sequence of Step
        Steps, as from `find_steps`.
    times_s : sequence of float
        Time of each frame.
    time_unit : str, optional
        Unit of those times, recorded with them.
    read : callable, optional
        Picklable function that reads a frame; an attribute ``description`` states its options.
    camera : Lens, optional
        Camera of the frames, which is checked and recorded.
    workers : int, optional
        Number of processes; 1 works in this one.
    executor : concurrent.futures.Executor, optional
        Executor to use instead, perhaps on other machines, which see all folders by the same names.
    progress : callable, optional
        Function ``progress(finished, done, total)`` that wraps the iterable of finished frames.
    tell : callable, optional
        Function of `Done` that is called for each frame.

    Returns
    -------
    Progress
        Number of frames in each state, such as whole, missing or damaged.

    Raises
    ------
    InputError
        If none of the first frames can be processed, the folder holds something else, or was made
        of other frames, by other steps or with another camera.
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
    out, steps = Path(out), tuple(steps)
    times = _checked(paths, steps, times_s)
    together = max(LEAST_TOGETHER, math.ceil(len(paths) / MOST_TASKS))
    request = _request(paths, steps, read, camera)
    part = out.with_name(out.name + ".part")
    with exclusive(out):
        if out.is_symlink() or out.exists():
            group = result.open_video(out)
            _check_same(group, request, times, out)
            return result.count_frames(group, out)
        if not part.exists():
            with bars.stage("Processing the first frame"):
                first, values = _try_out(paths, steps, read, camera)
            when = Values(times, (), {"units": time_unit})
            _lay_out(part, request | {"model": first}, when, values, together)
        group = result.open_video(part)
        _check_same(group, request, times, part)
        number: Any = group.attrs.get("model")
        model = paths[number] if number in range(len(paths)) else None
        if model is None:
            raise InputError(f"{part} is damaged: its zarr.json names no frame; remove it.")
        job = Job(steps, read, model)
        tasks = _tasks_to_do(job, paths, result.read_states(group, part), part, together)
        missing = sum(len(task.paths) for task in tasks)
        finished = carry_out(tasks, workers, executor)
        for done in progress(finished, len(paths) - missing, len(paths)) if progress else finished:
            if tell is not None:
                tell(done)
        return _finish(part, out)


def _checked(
    paths: Sequence[Path | None], steps: tuple[Step, ...], times_s: Sequence[float]
) -> np.ndarray:
    times = np.asarray(times_s, np.float64)
    if not steps or not any(paths):
        raise InputError(f"There must be a frame and a step, got {len(paths)} and {len(steps)}.")
    if times.shape != (len(paths),) or not (np.diff(times) > 0).all() or not np.isfinite(times[-1]):
        raise InputError(f"times_s must hold a rising time for each of the {len(paths)} frames.")
    return times


def _request(paths: Sequence[Path | None], steps: tuple[Step, ...], read, camera) -> dict[str, Any]:
    """State what decides about the result, beside the times, in words that can be compared."""
    return {
        "kind": KIND,
        "steps": [repr(step) for step in steps],
        "camera": repr(camera),
        "reading": getattr(read, "description", re.sub(" at 0x[0-9a-f]+", "", repr(read))),
        "names": [path and path.name for path in paths],
    }


WHAT = {
    "steps": "by other steps", "camera": "with another camera", "reading": "by another reading",
    "names": "of other frames",
}  # fmt: skip
"""Words for the entries of a request that differ."""


def _check_same(group: zarr.Group, request: dict[str, Any], times: np.ndarray, place: Path) -> None:
    """Refuse a group that was made of something else."""
    other = [words for key, words in WHAT.items() if group.attrs.get(key) != request[key]]
    with result.reading(place):
        if not np.array_equal(open_array(group, "time")[:], times):
            other.append("with other times")
    if other:
        raise InputError(
            f"{place} was made {', '.join(other)}; remove it, or choose another folder."
        )


def _try_out(
    paths: Sequence[Path | None], steps: tuple[Step, ...], read, camera: Lens | None
) -> tuple[int, dict[str, Values]]:
    """Find the first sound frame, by which others are judged, and its values."""
    refusal: InputError | None = None
    some = [number for number, path in enumerate(paths) if path is not None][:TRIED]
    for number in some:
        try:
            light_field = read(paths[number])
            if camera is not None:
                camera.check_views(light_field.shape)
            frame = Frame(light_field)
            values = fingerprint(frame.image)
            for step in steps:
                values |= step(frame)
            return number, values
        except InputError as error:
            refusal = refusal or error
    raise refusal or InputError("There is no frame.")


def _lay_out(
    part: Path, facts: dict[str, Any], times: Values, values: dict[str, Values], together: int
) -> None:
    """Create the group with empty arrays; it appears as a whole."""
    frames = len(times.values)
    remove_leftovers(part)
    with atomic_folder(part) as aside:
        group = zarr.open_group(aside, mode="w", zarr_format=3)
        result.create_coordinate(group, "time", times)
        for name, found in values.items():
            if found.axes == (name,):
                result.create_coordinate(group, name, found)
            else:
                result.create_array(group, name, frames, found, together)
        numbers = list(range(len(result.STATES)))
        flags = {"flag_values": numbers, "flag_meanings": " ".join(result.STATES)}
        state = Values(np.uint8(result.TO_DO), (), flags)
        result.create_array(group, "state", frames, state, together)
        group.update_attributes(facts)


def _tasks_to_do(
    job: Job, paths: Sequence[Path | None], states: np.ndarray, part: Path, together: int
) -> list[Task]:
    """List the tasks of which a frame is not done yet."""
    packed, folder = pickle.dumps(job), str(part.resolve())
    return [
        Task(packed, folder, first, tuple(paths[first : first + together]))
        for first in range(0, len(paths), together)
        if (states[first : first + together] == result.TO_DO).any()
    ]


def _finish(part: Path, out: Path) -> Progress:
    """Record what became of the frames, and give the group its final name."""
    for left in part.rglob("*.partial"):  # of a write of Zarr's that was killed
        left.unlink(missing_ok=True)
    group = zarr.open_group(part, mode="r+")
    states = result.read_states(group, part)
    counts = result.count_frames(group, part)
    names = dict[str, Any](group.attrs)["names"]
    skipped = {
        word: [names[k] or f"frame {k}" for k in np.flatnonzero(states == state)]
        for state, word in enumerate(result.STATES)
        if state > result.WHOLE and (states == state).any()
    }
    group.update_attributes(
        {
            "counts": counts.counts,
            "skipped": skipped,
            "repeated": counts.repeated,
            "provenance": provenance.environment(),
        }
    )
    part.rename(out)
    return counts
