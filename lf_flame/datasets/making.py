"""Making data sets: one shard per task, in this process, in others, or on other machines.

Every sample is drawn from the seed and its index, and every shard is written by one task as a
whole. Therefore no two tasks write one file, a run that was interrupted continues with the
incomplete shards, and the bytes do not depend on the workers. A data set is built as ``NAME.part``
and renamed when it is complete.
"""

import json
import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from zarr.codecs import Crc32cCodec, ZstdCodec

from lf_flame._common import provenance
from lf_flame._common.atomic_files import atomic_folder, remove_leftovers
from lf_flame._common.input_files import readable
from lf_flame._common.locks import exclusive
from lf_flame._common.workers import carry_out
from lf_flame._common.zarr_files import ZARR_ERRORS, open_array
from lf_flame.datasets.config import DatasetConfig, config_from_json, config_to_json
from lf_flame.datasets.metadata import METADATA, SIMULATED, check_array_files, read_attributes
from lf_flame.datasets.sampling import count_rays, search_slopes, simulate_sample
from lf_flame.errors import InputError
from lf_flame.refocus import SlopeSearch
from lf_flame.simulation.planning.effects import EFFECTS
from lf_flame.simulation.planning.plan import EffectPlan

LEAST_TOGETHER, MOST_SHARDS = 16, 1000
"""Smallest number of samples in a shard, and largest number of shards in an array: a million
samples then take fewer than ten thousand files."""


def shard_size(samples: int) -> int:
    """Count the samples in a shard."""
    return max(LEAST_TOGETHER, math.ceil(samples / MOST_SHARDS))


@dataclass(frozen=True)
class Task:
    """Everything needed to make some samples, on any machine.

    Attributes
    ----------
    config : str
        Configuration as JSON.
    slopes : tuple of float
        Slopes of the targets.
    rays : int or None
        Number of rays per pixel along each axis, see `lf_flame.datasets.sampling.count_rays`.
    folder : str
        Folder of the group that is being built.
    samples : range
        Indices of the samples, a whole shard.
    """

    config: str
    slopes: tuple[float, ...]
    rays: int | None
    folder: str
    samples: range

    def __call__(self) -> range:
        """Simulate the samples, and write them all at once."""
        config, group = _open(self.config, self.folder)
        made = [
            simulate_sample(config, list(self.slopes), index, self.rays) for index in self.samples
        ]
        _store(group, slice(self.samples.start, self.samples.stop), made)
        return self.samples


@lru_cache(maxsize=4)
def _open(config: str, folder: str) -> tuple[DatasetConfig, zarr.Group]:
    return config_from_json(json.loads(config), folder), zarr.open_group(folder, mode="r+")


def make_dataset(
    config: DatasetConfig,
    samples: int,
    path: str | Path,
    workers: int = 1,
    progress: Callable[[Iterable, int, int], Iterable] | None = None,
    executor: Executor | None = None,
) -> None:
    """Make a data set, or finish one that was interrupted.

    Parameters
    ----------
    config : DatasetConfig
        Configuration, from `read_config`.
    samples : int
        Number of samples.
    path : str or Path
        Folder of the Zarr group, which must not exist yet.
    workers : int, optional
        Number of processes; 1 uses the calling one.
    progress : callable, optional
        Function ``progress(finished, done, total)`` that wraps the iterable of finished samples.
    executor : concurrent.futures.Executor, optional
        Executor to use instead of `workers`, perhaps on other machines; all of them must see the
        folder under the same name.

    Raises
    ------
    InputError
        If `path` exists, the folder in which it is built holds something else, or another process
        builds it.
    OSError
        If a file cannot be written; finished samples are kept.

    Examples
    --------
    >>> from lf_flame.datasets import Dataset, make_dataset, read_config
    >>> make_dataset(read_config("dataset.toml"), 3, "shapes.zarr")
    >>> Dataset("shapes.zarr").targets.shape
    (3, 4, 24, 48)
    """
    path = Path(path)
    part = path.with_name(path.name + ".part")
    with exclusive(path):
        if path.exists() or path.is_symlink():  # a folder cannot replace a link
            raise InputError(f"{path} exists; remove it or choose another folder.")
        started = time.perf_counter()
        slopes, rays = _begin(part, config, samples)
        asked, group = json.dumps(config_to_json(config)), zarr.open_group(part, mode="r+")
        tasks = [
            Task(asked, slopes, rays, str(part.resolve()), range(first, last))
            for first, last in _open_shards(part, group)
        ]
        missing = sum(len(task.samples) for task in tasks)
        finished = carry_out(tasks, workers, executor)
        for _ in finished if progress is None else progress(finished, samples - missing, samples):
            pass
        made = {
            "workers": type(executor).__name__ if executor else workers,
            "wall_s": round(time.perf_counter() - started, 2),
            "samples_this_run": missing,
        }
        _finish(part, group, made)
        part.rename(path)


def _begin(part: Path, config: DatasetConfig, samples: int) -> tuple[tuple[float, ...], int | None]:
    """Create a data set's arrays, unless they exist; returns the targets' slopes and the rays."""
    if not part.exists():
        # First, because this also shows that the scene can be rendered.
        rays = count_rays(config)
        searches = search_slopes(config, rays, whole_range=config.route == "rays")
        remove_leftovers(part)
        with atomic_folder(part) as aside:  # so that NAME.part is always a data set
            group = zarr.open_group(aside, mode="w", zarr_format=3)
            _lay_out(group, config, samples, searches, rays)
        return tuple(search.slope for search in searches), rays
    begun = read_attributes(part) if (part / METADATA).exists() else None
    if begun is None:
        raise InputError(
            f"{part} is in the way: a data set is built under that name, but this is none; move "
            f"it or choose another folder."
        )
    if begun.config != config_to_json(config) or check_array_files(part, config) != samples:
        raise InputError(
            f"{part} was begun with another configuration or number of samples; remove it or "
            f"choose another folder."
        )
    return tuple(begun.slopes), begun.rays


def _lay_out(
    group: zarr.Group,
    config: DatasetConfig,
    samples: int,
    searches: Sequence[SlopeSearch],
    rays: int | None,
) -> None:
    """Make empty arrays, and the attributes."""
    _, parameters = config.draw(None)
    together = shard_size(samples)

    def add(name: str, shape: tuple[int, ...], dtype: str, fill: float, sharded: bool) -> None:
        group.create_array(
            name,
            shape=(samples, *shape),
            chunks=(1 if sharded else together, *shape),
            shards=(together, *shape) if sharded else None,
            dtype=dtype,
            fill_value=fill,
            compressors=[ZstdCodec(level=3), Crc32cCodec()],
        )

    add("input", config.input.shape(config.image), "float32", np.nan, sharded=True)
    add("target", (len(searches), *config.image), "float32", np.nan, sharded=True)
    for name, values in parameters.items():
        add(f"parameters/{name}", values.shape, "float64", np.nan, sharded=False)
    if config.planned_by_sample:
        add(SIMULATED, (len(EFFECTS) + 1,), "uint8", 0, sharded=False)
    add("complete", (), "uint8", 0, sharded=False)
    attributes = {
        "slopes": [search.slope for search in searches],
        "slopes_geometry": [config.camera.depth_to_slope(z) for z in config.depths_mm],
        "depths_mm": config.depths_mm,
        "objects": [o.name for o in config.template.objects],
        "plan": config.plan.to_json(),
        "rays": rays,
        "config": config_to_json(config),
    }
    group.update_attributes(attributes)  # in one write; `group.attrs.update` makes one for each


def _open_shards(part: Path, group: zarr.Group) -> Iterator[tuple[int, int]]:
    """First sample of each incomplete shard, and one past the last."""
    with readable(part / METADATA, ZARR_ERRORS, "a sample is"):
        complete = open_array(group, "complete")
        done, count = np.asarray(complete[:]) == 1, complete.chunks[0]
    for first in range(0, done.size, count):
        if not done[first : first + count].all():
            yield first, min(first + count, done.size)


def _store(group: zarr.Group, place: slice, samples: Sequence[dict[str, Any]]) -> None:
    """Write some samples, a whole shard."""

    def write(name: str, values: Sequence[Any]) -> None:
        open_array(group, name)[place] = np.stack(values)

    write("input", [sample["input"] for sample in samples])
    write("target", [sample["target"] for sample in samples])
    for name in samples[0]["parameters"]:
        write(f"parameters/{name}", [sample["parameters"][name] for sample in samples])
    if SIMULATED in group:
        write(SIMULATED, [_simulated(sample["plan"]) for sample in samples])
    write("complete", [np.uint8(1)] * len(samples))  # last, so that a partial shard is made again


def _simulated(plan: EffectPlan) -> np.ndarray:
    """Whether a plan traces rays, and which effects it keeps, in the order of `EFFECTS`."""
    kept = [name in plan.kept for name in EFFECTS]
    return np.array([plan.integrator == "rays", *kept], np.uint8)


def _count_simulated(group: zarr.Group) -> dict[str, Any]:
    """Count the samples with traced rays, and those with each effect."""
    found = np.asarray(open_array(group, SIMULATED)[:])
    counts = [int(count) for count in found.sum(axis=0)]
    return {
        "samples": len(found),
        "by_rays": counts[0],
        "with": dict(zip(EFFECTS, counts[1:], strict=True)),
    }


def _finish(part: Path, group: zarr.Group, made: dict[str, Any]) -> None:
    """Record the program and machine that made the data set."""
    for left in part.rglob("*.partial"):  # of a write of Zarr's store that was interrupted
        left.unlink(missing_ok=True)
    attributes: dict[str, Any] = {"provenance": {**provenance.environment(), **made}}
    if SIMULATED in group:
        with readable(part / METADATA, ZARR_ERRORS, "a sample is"):
            attributes[SIMULATED] = _count_simulated(group)
    group.update_attributes(attributes)
