"""Data sets of light-field images and their refocused stacks, as Zarr v3 groups.

A group holds ``input`` (n, h, w, channels), what the network is shown of the light field, see
`lf_flame.datasets.encodings`; ``target`` (n, objects, h, w), the light field refocused at the slope
of each object; ``parameters/*``, what was drawn; and ``complete`` (n,). Where effects are decided
for each sample, ``simulated`` (n, 1 + effects) says whether rays were traced and which effects were
simulated, and an attribute of that name counts the samples. Every sample is a chunk of its own with
a checksum, seeded by its index, so that workers write side by side, a run that was cut goes on, and
the bytes do not depend on the number of workers. The group is built as ``NAME.part`` and renamed
when it is whole; its attributes hold the hashes of images, parameters and attributes.
"""

import hashlib
import json
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import as_completed
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from zarr.codecs import Crc32cCodec, ZstdCodec
from zarr.storage import LocalStore

from lf_flame._common import provenance
from lf_flame._common.atomic_files import atomic_folder
from lf_flame._common.input_files import readable
from lf_flame._common.locks import exclusive
from lf_flame._common.memory import check_memory
from lf_flame._common.workers import worker_pool
from lf_flame.datasets.config import (
    MOST_SAMPLES,
    DatasetConfig,
    config_from_json,
    config_to_json,
)
from lf_flame.datasets.metadata import METADATA, ZARR_ERRORS, check_array, read_attributes
from lf_flame.datasets.sampling import search_slopes, simulate_sample
from lf_flame.errors import InputError
from lf_flame.refocus import SlopeSearch
from lf_flame.simulation.effects import EFFECTS
from lf_flame.simulation.plan import EffectPlan

SIMULATED = "simulated"
"""Array, and attribute, of what was simulated where that is decided for each sample."""

ATTRIBUTES_SHA256 = "attributes_sha256"
"""Attribute that guards the others."""

THROUGH_LIGHT_FIELD = "through_light_field"
"""Attribute: whether light fields were formed even where the plan needs none for the images."""


def make_dataset(
    config: DatasetConfig,
    samples: int,
    path: str | Path,
    workers: int = 1,
    progress: Callable[[Iterable, int, int], Iterable] | None = None,
    through_light_field: bool = False,
) -> None:
    """Make a data set, or finish one that was cut off.

    Parameters
    ----------
    config : DatasetConfig
    samples : int
    path : str or Path
        Folder of the finished group, which must not exist yet.
    workers : int, optional
        Processes; 1 works in this one.
    progress : callable, optional
        ``progress(finished, done, total)`` wraps the iterable of finished samples.
    through_light_field : bool, optional
        Form every light field, even where the effect plan needs none for the images.

    Raises
    ------
    InputError
        If `path` exists, something else lies where it is built, or another process builds it.
    OSError
        If a file cannot be written; finished samples are kept.
    """
    with exclusive(path):
        _make(config, samples, Path(path), workers, progress, through_light_field)


def _make(
    config: DatasetConfig,
    samples: int,
    path: Path,
    workers: int,
    progress: Callable | None,
    through_light_field: bool,
) -> None:
    started, part = time.perf_counter(), path.with_name(path.name + ".part")
    if path.exists():
        raise InputError(f"{path} exists; remove it or choose another folder.")
    if not part.exists():
        _create(part, config, samples, through_light_field)
    elif not _is_laid_out(part):
        raise InputError(
            f"{part} is in the way: a data set is built under that name, but this is none; move it "
            f"or choose another folder."
        )
    group = zarr.open_group(part, mode="r+")
    _check_same(group, config, samples, through_light_field, part)
    attrs: dict[str, Any] = dict(group.attrs)
    open_indices = np.flatnonzero(np.asarray(_array(group, "complete")[:]) == 0).tolist()
    asked = config, attrs["slopes"], through_light_field
    finished = _run(*asked, part, open_indices, workers)
    if progress is not None:
        finished = progress(finished, samples - len(open_indices), samples)
    for _ in finished:
        pass
    attrs |= {"sha256": _digest(group), "parameters_sha256": _digest_parameters(group)}
    if SIMULATED in group:
        attrs[SIMULATED] = _count_simulated(group)
    attrs["provenance"] = {
        **provenance.environment(),
        "workers": workers,
        "wall_s": round(time.perf_counter() - started, 2),
        "samples_this_run": len(open_indices),
    }
    _set_attributes(group, attrs)
    _remove_partial_files(part)
    part.rename(path)


def _create(part: Path, config: DatasetConfig, samples: int, through_light_field: bool) -> None:
    searches = search_slopes(config)  # first: it also shows that the scene can be rendered
    with atomic_folder(part) as aside:  # what bears the name of a part is one
        group = zarr.open_group(aside, mode="w", zarr_format=3)
        _lay_out(group, config, samples, searches, through_light_field)


def _lay_out(
    group: zarr.Group,
    config: DatasetConfig,
    samples: int,
    searches: Sequence[SlopeSearch],
    through_light_field: bool,
) -> None:
    """Make empty arrays, and the attributes."""
    _, parameters = config.draw(None)

    def add(name: str, shape: tuple[int, ...], dtype, fill) -> None:
        group.create_array(
            name,
            shape=(samples, *shape),
            chunks=(1, *shape),
            dtype=dtype,
            fill_value=fill,
            compressors=[ZstdCodec(level=3), Crc32cCodec()],
        )

    add("input", config.input.shape(config.image), "float32", np.nan)
    add("target", (len(searches), *config.image), "float32", np.nan)
    for name, values in parameters.items():
        add(f"parameters/{name}", values.shape, "float64", np.nan)
    if config.planned_by_sample:
        add(SIMULATED, (len(EFFECTS) + 1,), "uint8", 0)
    add("complete", (), "uint8", 0)
    attrs = {
        "slopes": [search.slope for search in searches],
        "slopes_geometry": [config.camera.depth_to_slope(z) for z in config.depths_mm],
        "depths_mm": config.depths_mm,
        "objects": [o.name for o in config.template.objects],
        "plan": config.plan.to_json(),
        THROUGH_LIGHT_FIELD: through_light_field,
        "config": config_to_json(config),
    }
    _set_attributes(group, attrs)


def _is_laid_out(part: Path) -> bool:
    """Whether a folder holds the beginning of a data set."""
    if not (part / "zarr.json").exists():
        return False
    return read_attributes(part) is not None


def _array(group: zarr.Group, name: str) -> zarr.Array:
    """Array of a group, never a group inside it."""
    assert isinstance(group.store, LocalStore)
    with readable(group.store.root / name / METADATA, ZARR_ERRORS):
        array = group[name]
    if not isinstance(array, zarr.Array):
        raise InputError(f"{name} of a data set must be an array, got a group: it is damaged.")
    return array


def _check_same(
    group: zarr.Group, config: DatasetConfig, samples: int, through_light_field: bool, part: Path
) -> None:
    same = group.attrs.get("config") == config_to_json(config)
    if not same or _check_arrays(part, config) != samples:
        raise InputError(
            f"{part} was begun with another configuration or number of samples; "
            f"remove it or choose another folder."
        )
    # Older ones were always made so.
    if group.attrs.get(THROUGH_LIGHT_FIELD, True) != through_light_field:
        begun = "without forming" if through_light_field else "by forming"
        raise InputError(
            f"{part} was begun {begun} light fields: their last digits differ; remove it or choose "
            f"another folder."
        )
    _check_attributes(group, part)


def _check_arrays(path: Path, config: DatasetConfig) -> int:
    """Look at what the arrays of a data set say of themselves; give the number of samples."""
    shown = config.input.shape(config.image)
    shapes = {
        "complete": [()],
        # Older data sets hold one channel without an axis.
        "input": [shown, shown[:2]] if shown[2] == 1 else [shown],
        "target": [(len(config.depths_mm), *config.image)],
    }
    counts = {check_array(path / name, some) for name, some in shapes.items()}
    if len(counts) > 1 or max(counts) > MOST_SAMPLES:
        raise InputError(
            f"{path} is damaged: its arrays must have as many samples, up to {MOST_SAMPLES}, got "
            f"{', '.join(map(str, sorted(counts)))}."
        )
    return counts.pop()


def _run(
    config: DatasetConfig, slopes: list[float], through_light_field: bool, part: Path,
    indices: list[int], workers: int,
) -> Iterable[int]:  # fmt: skip
    if workers == 1:
        group = zarr.open_group(part, mode="r+")
        for index in indices:
            _store(group, index, simulate_sample(config, slopes, index, through_light_field))
            yield index
        return
    setup = (config_to_json(config), slopes, through_light_field, str(part))
    with worker_pool(workers, _start_worker, *setup) as pool:
        jobs = [pool.submit(_work, index) for index in indices]
        for job in as_completed(jobs):
            yield job.result()


_worker: dict[str, Any] = {}


def _start_worker(config: dict, slopes: list[float], through_light_field: bool, part: str) -> None:
    import numba

    numba.set_num_threads(1)  # one process per core: the kernels run serially here
    _worker["config"] = config_from_json(config, part)
    _worker["slopes"] = slopes
    _worker[THROUGH_LIGHT_FIELD] = through_light_field
    _worker["group"] = zarr.open_group(part, mode="r+")


def _work(index: int) -> int:
    config, slopes, forced = (_worker[x] for x in ("config", "slopes", THROUGH_LIGHT_FIELD))
    sample = simulate_sample(config, slopes, index, forced)
    _store(_worker["group"], index, sample)
    return index


def _store(group: zarr.Group, index: int, sample: dict) -> None:
    _array(group, "input")[index] = sample["input"]
    _array(group, "target")[index] = sample["target"]
    for name, values in sample["parameters"].items():
        _array(group, f"parameters/{name}")[index] = values
    if SIMULATED in group:
        _array(group, SIMULATED)[index] = _simulated(sample["plan"])
    _array(group, "complete")[index] = 1  # last: a sample without it is made again


def _simulated(plan: EffectPlan) -> np.ndarray:
    """Whether a plan traces rays, and which effects it keeps, in the order of `EFFECTS`."""
    kept = [name in plan.kept for name in EFFECTS]
    return np.array([plan.integrator == "rays", *kept], np.uint8)


def _count_simulated(group: zarr.Group) -> dict[str, Any]:
    """Count the samples for which rays were traced and for which each effect was simulated."""
    found = np.asarray(_array(group, SIMULATED)[:])
    counts = [int(count) for count in found.sum(axis=0)]
    return {
        "samples": len(found),
        "by_rays": counts[0],
        "with": dict(zip(EFFECTS, counts[1:], strict=True)),
    }


def _digest(group: zarr.Group) -> str:
    digest = hashlib.sha256()
    inputs, targets = _array(group, "input"), _array(group, "target")
    for index in range(_array(group, "complete").shape[0]):
        digest.update(np.ascontiguousarray(inputs[index]).data)
        digest.update(np.ascontiguousarray(targets[index]).data)
    return digest.hexdigest()


def _digest_parameters(group: zarr.Group) -> str:
    """Hash what was drawn and decided for each sample."""
    digest = hashlib.sha256()
    for name in sorted(name for name, _ in group.members(max_depth=None)):
        if name == SIMULATED or name.startswith("parameters/"):
            digest.update(name.encode())
            digest.update(np.ascontiguousarray(_array(group, name)[:]).data)
    return digest.hexdigest()


def _set_attributes(group: zarr.Group, attributes: dict[str, Any]) -> None:
    """Set attributes and their hash, all in one write."""
    attributes = json.loads(json.dumps(attributes))
    group.attrs.update({**attributes, ATTRIBUTES_SHA256: _digest_attributes(group, attributes)})


def _check_attributes(group: zarr.Group, path: Path) -> None:
    attributes = dict(group.attrs)
    # Data sets from before attributes had a hash have none.
    known = attributes.get(ATTRIBUTES_SHA256)
    if known is not None and known != _digest_attributes(group, attributes):
        raise InputError(
            f"{path} is damaged: its attributes (zarr.json) are not those that were written; "
            f"remove it and make it again."
        )


def _digest_attributes(group: zarr.Group, attributes: dict[str, Any]) -> str:
    """Hash all attributes but this hash, and what is said of each array."""
    attributes = {key: value for key, value in attributes.items() if key != ATTRIBUTES_SHA256}
    arrays = {
        name: array.metadata.to_dict()
        for name, array in group.members(max_depth=None)
        if isinstance(array, zarr.Array)
    }
    text = json.dumps({"attributes": attributes, "arrays": arrays}, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def _remove_partial_files(part: Path) -> None:
    """Remove what Zarr's store left of writes that were cut off."""
    for path in part.rglob("*.partial"):
        path.unlink(missing_ok=True)


class Dataset:
    """A finished data set on disk.

    Parameters
    ----------
    path : str or Path
        Folder of the Zarr group.

    Raises
    ------
    InputError
        If there is none, it is not finished, or it is damaged.
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        if not (self.path / "zarr.json").exists():
            part = self.path.with_name(self.path.name + ".part")
            hint = " (it was begun, but is not finished)" if part.exists() else ""
            raise InputError(
                f"There is no data set at {path}{hint}; make it with `lf-flame dataset`."
            )
        found = read_attributes(self.path)
        if found is None or found.sha256 is None:
            raise InputError(f"{path} is not a data set, or is damaged: it does not say what of.")
        self.config = config_from_json(found.config, self.path)
        _check_arrays(self.path, self.config)
        if not len(found.slopes) == len(found.objects) == len(self.config.depths_mm):
            raise InputError(f"{path} is damaged: its slopes or objects are not as many as depths.")
        with readable(self.path / METADATA, ZARR_ERRORS):
            self._group = zarr.open_group(self.path, mode="r")
            self.attrs: dict[str, Any] = dict(self._group.attrs)
            complete = np.asarray(_array(self._group, "complete")[:])
        _check_attributes(self._group, self.path)
        if not np.all(complete == 1):
            missing = np.flatnonzero(complete != 1)[0]
            raise InputError(f"{path} is not complete: sample {missing} is missing; make it again.")

    def verify(self) -> list[str]:
        """Compute all hashes again, from every sample.

        Returns
        -------
        list of str
            What is as it was written; older data sets know no hashes of parameters and attributes.

        Raises
        ------
        InputError
            If a sample, or what was drawn for it, is not what was written.
        """
        sound = ["attributes"] if ATTRIBUTES_SHA256 in self.attrs else []
        for what, name, digest in (
            ("images", "sha256", _digest),
            ("parameters", "parameters_sha256", _digest_parameters),
        ):
            if name not in self.attrs:
                continue
            try:
                found = digest(self._group)
            except (KeyError, ValueError, RuntimeError, OSError) as error:
                raise InputError(f"{self.path} is damaged ({error}); make it again.") from None
            if found != self.attrs[name]:
                raise InputError(
                    f"{self.path} is damaged: the {what} are not those that were written; remove "
                    f"it and make it again."
                )
            sound.append(what)
        return sound

    def __len__(self) -> int:
        return _array(self._group, "complete").shape[0]

    @property
    def scenes_sha256(self) -> str:
        """Hash of what was asked for: the same on every machine, whose rounding may differ."""
        asked = {**config_to_json(self.config), "samples": len(self)}
        return hashlib.sha256(json.dumps(asked, sort_keys=True).encode()).hexdigest()

    @cached_property
    def inputs(self) -> np.ndarray:
        """Network inputs, shape (n, height, width, channels), float32 in [0, 1]."""
        # Older data sets hold them without an axis of channels.
        return self._read("input").reshape(-1, *self.config.input.shape(self.config.image))

    @cached_property
    def targets(self) -> np.ndarray:
        """Refocused images, shape (n, objects, h, w), float32 in [0, 1]."""
        return self._read("target")

    def parameters(self, name: str) -> np.ndarray:
        """Drawn values, shape (n, objects) or (n, objects, 2), float64."""
        return self._read(f"parameters/{name}")

    def _read(self, name: str) -> np.ndarray:
        array = _array(self._group, name)
        check_memory(array.nbytes, self.path / name)
        samples = np.empty(array.shape, array.dtype)
        for index in range(len(self)):
            try:
                samples[index] = array[index]
            except ZARR_ERRORS as error:
                raise InputError(
                    f"Sample {index} of {self.path}/{name} is damaged ({error}); "
                    f"remove the data set and make it again."
                ) from None
            if not np.all(np.isfinite(samples[index])):
                raise InputError(
                    f"Sample {index} of {self.path}/{name} is missing or not finite; "
                    f"remove the data set and make it again."
                )
        return samples
