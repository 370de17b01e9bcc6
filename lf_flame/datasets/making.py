"""Making data sets: one shard per task, in this process, in others, or on other machines.

Every sample is drawn from the seed and its index, and every shard is written by one task as a
whole. Therefore no two tasks write one file, a run that was interrupted continues with the
incomplete shards, and the bytes do not depend on the workers. `lf_flame.datasets.places` handles
folders and object stores.
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
from lf_flame._common.workers import carry_out
from lf_flame.datasets.config import DatasetConfig, config_from_json, config_to_json
from lf_flame.datasets.hashes import (
    check_attributes,
    hash_images,
    hash_parameters,
    open_array,
    set_attributes,
)
from lf_flame.datasets.metadata import SIMULATED
from lf_flame.datasets.places import Place, find_place, open_group, writing
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
    address : str
        Address of the group that is being built, see `lf_flame.datasets.places`.
    samples : range
        Indices of the samples, a whole shard.
    """

    config: str
    slopes: tuple[float, ...]
    rays: int | None
    address: str
    samples: range

    def __call__(self) -> range:
        """Simulate the samples, and write them all at once."""
        config, group = _open(self.config, self.address)
        made = [
            simulate_sample(config, list(self.slopes), index, self.rays) for index in self.samples
        ]
        with writing(self.address):
            _store(group, slice(self.samples.start, self.samples.stop), made)
        return self.samples


@lru_cache(maxsize=4)
def _open(config: str, address: str) -> tuple[DatasetConfig, zarr.Group]:
    return config_from_json(json.loads(config), address), open_group(address)


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
        Folder of the Zarr group, which must not exist yet; or a place in an object store that
        fsspec can access, such as ``s3://BUCKET/NAME``, with the credentials of the environment.
    workers : int, optional
        Number of processes; 1 uses the calling one.
    progress : callable, optional
        Function ``progress(finished, done, total)`` that wraps the iterable of finished samples.
    executor : concurrent.futures.Executor, optional
        Executor to use instead of `workers`, perhaps on other machines; all of them must see the
        folder under the same name, or reach the object store.

    Raises
    ------
    InputError
        If `path` exists, the folder in which it is built holds something else, another process
        builds it, or the object store cannot be reached.
    OSError
        If a file cannot be written; finished samples are kept.

    Examples
    --------
    >>> from lf_flame.datasets import Dataset, make_dataset, read_config
    >>> make_dataset(read_config("dataset.toml"), 3, "shapes.zarr")
    >>> Dataset("shapes.zarr").targets.shape
    (3, 4, 24, 48)
    """
    place = find_place(path)
    with place.reserved():
        started = time.perf_counter()
        slopes, rays = _begin(place, config, samples)
        asked, group = json.dumps(config_to_json(config)), place.open()
        tasks = [
            Task(asked, slopes, rays, place.address, range(first, last))
            for first, last in _open_shards(place, group)
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
        _finish(place, group, made)
        place.finish()


def _begin(
    place: Place, config: DatasetConfig, samples: int
) -> tuple[tuple[float, ...], int | None]:
    """Create a data set's arrays, unless they exist; returns the targets' slopes and the rays."""
    begun = place.attributes()
    if begun is None:
        # First, because this also shows that the scene can be rendered.
        rays = count_rays(config)
        searches = search_slopes(config, rays, whole_range=config.route == "rays")
        with place.laid_out() as group, writing(place.address):
            _lay_out(group, config, samples, searches, rays)
        return tuple(search.slope for search in searches), rays
    _check_same(place, config, samples)
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
    set_attributes(group, attributes)


def _check_same(place: Place, config: DatasetConfig, samples: int) -> None:
    group = place.open()
    same = group.attrs.get("config") == config_to_json(config)
    if not same or place.count_samples(config) != samples:
        raise InputError(
            f"{place.name} was begun with another configuration or number of samples; "
            f"remove it or choose another folder."
        )
    check_attributes(group, place.name)


def _open_shards(place: Place, group: zarr.Group) -> Iterator[tuple[int, int]]:
    """First sample of each incomplete shard, and one past the last."""
    with place.reading():
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


def _finish(place: Place, group: zarr.Group, made: dict[str, Any]) -> None:
    """Write the hashes, and the program and machine that made the data set."""
    attributes = dict(group.attrs)
    with place.reading():
        attributes |= {"sha256": hash_images(group), "parameters_sha256": hash_parameters(group)}
        if SIMULATED in group:
            attributes[SIMULATED] = _count_simulated(group)
    attributes["provenance"] = {**provenance.environment(), **made}
    with writing(place.address):
        set_attributes(group, attributes)
