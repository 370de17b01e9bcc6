"""Making data sets: one shard per task, in this process, in others, or on other machines.

Every sample is drawn from the seed and its index, and every shard is written by one task as a
whole. Therefore no two tasks write one file, an interrupted run resumes with the incomplete shards,
and the bytes do not depend on the workers. A data set is built as ``NAME.part`` and renamed when it
is complete.
"""

import math
import time
from collections.abc import Sequence
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from zarr.codecs import Crc32cCodec, ZstdCodec

from lf_flame._common import progress, provenance
from lf_flame._common.atomic_files import atomic_folder, exclusive, remove_leftovers
from lf_flame._common.config import build, to_json
from lf_flame._common.workers import carry_out
from lf_flame.datasets.config import DatasetConfig
from lf_flame.datasets.sampling import count_rays, search_slopes, simulate_sample
from lf_flame.datasets.store import Attributes, check_file
from lf_flame.errors import InputError
from lf_flame.formats.array_files import ZarrFile

LEAST_TOGETHER, MOST_SHARDS = 16, 1000
"""Smallest number of samples in a shard, and largest number of shards in an array: a million
samples then take fewer than ten thousand files."""


def shard_size(samples: int) -> int:
    """Count the samples in a shard."""
    return max(LEAST_TOGETHER, math.ceil(samples / MOST_SHARDS))


def make_dataset(
    config: DatasetConfig,
    samples: int,
    path: str | Path,
    workers: int = 1,
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
    executor : concurrent.futures.Executor, optional
        Executor to use instead of `workers`, perhaps on other machines, such as that of a Dask
        client; all of them must see the folder under the same name.

    Raises
    ------
    InputError
        If `path` exists, the folder in which it is built contains something else, or another
        process builds it.
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
    if not path.name:
        raise InputError(f"{path} cannot be made: name a new folder.")
    part = path.with_name(path.name + ".part")
    with exclusive(path):
        if path.exists() or path.is_symlink():  # a folder cannot replace a link
            raise InputError(f"{path} exists; remove it or choose another folder.")
        started = time.perf_counter()
        if not part.exists():
            _begin(part, config, samples)
        begun, shards = _open_begun(part, config, samples)
        missing = sum(map(len, shards))
        make = partial(_make_shard, config, begun.slopes, begun.rays, part.resolve())
        tasks = [partial(make, indices) for indices in shards]
        done = {"initial": samples - missing, "smoothing": 0.1}
        with progress.bar("simulating", samples, "sample", stays=True, **done) as bar:
            for _ in carry_out(tasks, workers, executor):
                bar.update()
        for left in part.rglob("*.partial"):  # of a write of Zarr's store that was interrupted
            left.unlink(missing_ok=True)
        run = {
            "workers": type(executor).__name__ if executor else workers,
            "wall_s": round(time.perf_counter() - started, 2),
            "samples_this_run": missing,
        }
        group = zarr.open_group(part, mode="r+")
        group.update_attributes({"provenance": {**provenance.environment(), **run}})
        part.rename(path)


def _begin(part: Path, config: DatasetConfig, samples: int) -> None:
    """Search the targets' slopes, and make a group with empty arrays and all attributes."""
    rays = count_rays(config)
    slopes = [search.slope for search in search_slopes(config, rays, config.route == "rays")]
    expected = [config.camera.depth_to_slope(z) for z in config.depths_mm]
    for depth, own, slope in zip(config.depths_mm, expected, slopes, strict=True):
        if min(expected, key=lambda other: abs(other - slope)) != own:
            raise InputError(
                f"The object at {depth:g} mm is sharpest at the slope {slope:.2f}, that of another "
                f'in front of it or behind it; take route = "exact" or "direct".'
            )
    remove_leftovers(part)
    with atomic_folder(part) as aside:  # so that NAME.part is always a data set
        group = zarr.open_group(aside, mode="w", zarr_format=3)
        _add_arrays(group, config, samples)
        group.update_attributes({  # in one write; `group.attrs.update` makes one for each
            "slopes": slopes,
            "slopes_geometry": expected,
            "depths_mm": config.depths_mm,
            "objects": [o.name for o in config.template.objects],
            "plan": config.plan.to_json(),
            "rays": rays,
            "config": to_json(config),
        })  # fmt: skip


def _add_arrays(group: zarr.Group, config: DatasetConfig, samples: int) -> None:
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
    add("target", (len(config.depths_mm), *config.image), "float32", np.nan, sharded=True)
    for name, values in parameters.items():
        add(f"parameters/{name}", values.shape, "float64", np.nan, sharded=False)
    add("complete", (), "uint8", 0, sharded=False)


def _open_begun(part: Path, config: DatasetConfig, samples: int) -> tuple[Attributes, list[range]]:
    """Attributes of a begun data set, and samples of each incomplete shard; refuse another one."""
    if not (part / "zarr.json").exists():
        raise InputError(
            f"{part} is in the way: a data set is built under that name, but this is not one; "
            f"move it or choose another folder."
        )
    file = ZarrFile(part)
    begun = build(Attributes, file.attributes, file.metadata)
    alike = {**begun.config, "samples": None} == {**to_json(config), "samples": None}
    if not alike or check_file(file, config) != samples:
        raise InputError(
            f"{part} was begun with another configuration or number of samples; remove it or "
            f"choose another folder."
        )
    done, count = file.read_begun("complete") == 1, file.arrays["complete"].chunks[0]
    shards = [range(k, min(k + count, done.size)) for k in range(0, done.size, count)]
    return begun, [indices for indices in shards if not done[indices].all()]


def _make_shard(
    config: DatasetConfig, slopes: list[float], rays: int | None, folder: Path, indices: range
) -> range:
    """Simulate the samples of a shard, write them all at once, and return their indices."""
    made = [simulate_sample(config, slopes, index, rays) for index in indices]

    def write(name: str, values: Sequence[Any]) -> None:
        array = zarr.open_array(folder, path=name, mode="r+")
        array[indices.start : indices.stop] = np.stack(values)

    write("input", [sample["input"] for sample in made])
    write("target", [sample["target"] for sample in made])
    for name in made[0]["parameters"]:
        write(f"parameters/{name}", [sample["parameters"][name] for sample in made])
    write("complete", [np.uint8(1)] * len(made))  # last, so that a partial shard is made again
    return indices
