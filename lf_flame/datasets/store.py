"""Data sets of light-field images and their refocused stacks, as Zarr v3 groups.

A group holds ``input`` (n, h, w, channels), what the network is shown of the light field, see
`lf_flame.datasets.encodings`; ``target`` (n, objects, h, w), the light field refocused at the slope of each
object; ``parameters/*``, what was drawn; and ``complete`` (n,). Every sample is a chunk of its own
with a checksum, seeded by its index, so that workers write side by side, a run that was cut goes
on, and the bytes do not depend on the number of workers. The group is built as ``NAME.part`` and
renamed when it is whole.
"""

import hashlib
import json
import multiprocessing
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
import zarr
from zarr.codecs import Crc32cCodec, ZstdCodec

from lf_flame._common import provenance
from lf_flame._common.arrays import area_average
from lf_flame._common.config import build, read_toml, to_json
from lf_flame.datasets.encodings import InputEncoding
from lf_flame.datasets.templates import TEMPLATES, Template
from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.refocus import SlopeSearch, find_sharpest_slope, shift_and_sum
from lf_flame.scenes.scene import Scene
from lf_flame.simulation.plan import EffectPlan, plan_effects
from lf_flame.simulation.rendering import render_plan


@dataclass(frozen=True)
class DatasetConfig:
    """What a data set is made of; read from data_gen/*.toml by `read_config`.

    Parameters
    ----------
    kind : {"shapes", "flames"}
    seed : int
        Sample i is drawn from ``numpy.random.default_rng([seed, i])``.
    image : (int, int)
        Height and width of the targets; the lenslets are a whole multiple of it.
    samples : dict
        Number of light fields for each preset.
    camera : PlenopticCamera
    template : ShapeTemplate or FlameTemplate
    effects : dict of str to bool, optional
        Effects to force on or off.
    input : InputEncoding, optional
        What the network is shown. Default: what the paper's is.
    shuffled_depths : bool, optional
        Let the objects of each sample stand at the template's depths in an order drawn at random,
        as large in the central view as at their own depths. The effect plan stays that of the
        objects at their own depths.
    """

    kind: Literal["shapes", "flames"]
    seed: int
    image: tuple[int, int]
    samples: dict[str, int]
    camera: PlenopticCamera
    template: Template
    effects: dict[str, bool] = field(default_factory=dict)
    input: InputEncoding = InputEncoding()
    shuffled_depths: bool = False

    __pydantic_config__ = {"extra": "forbid"}

    def __post_init__(self):
        lenslets = self.camera.lenslets
        for size in (self.image, self.input.image or self.image):
            if min(size) < 1 or any(n % m for n, m in zip(lenslets, size, strict=True)):
                raise InputError(
                    f"image must divide the camera's lenslets {lenslets} into whole numbers, "
                    f"got {size}."
                )
        if self.camera.views < self.input.views_per_side:
            raise InputError(
                f"input {self.input.kind!r} shows {self.input.views_per_side} views along an axis, "
                f"the camera has {self.camera.views}."
            )
        if self.seed < 0 or min(self.samples.values(), default=0) < 1:
            raise InputError(
                f"seed must be 0 or above and samples at least 1 for each preset, "
                f"got seed={self.seed}, samples={self.samples}."
            )

    def sample_count(self, preset: str) -> int:
        """Light fields of a preset."""
        if preset not in self.samples:
            raise InputError(f"preset must be one of {', '.join(self.samples)}, got {preset!r}.")
        return self.samples[preset]

    @cached_property
    def plan(self) -> EffectPlan:
        """Effect plan of the mean scene, by which all samples are simulated alike."""
        scene, _ = self.draw(None)
        return plan_effects(scene, self.camera, effects=self.effects)

    @property
    def block(self) -> tuple[int, int]:
        """Lenslets that are averaged into one pixel, along (t, s)."""
        return tuple(n // m for n, m in zip(self.camera.lenslets, self.image, strict=True))

    @property
    def depths_mm(self) -> list[float]:
        """Depths of the objects, in the order of the targets."""
        return [o.depth_mm for o in self.template.objects]

    def draw(self, rng: np.random.Generator | None) -> tuple[Scene, dict[str, np.ndarray]]:
        """Draw a scene; without a generator, the mean scene, all objects at their own depths.

        Returns
        -------
        Scene
        dict
            What was drawn: see the template; with shuffled depths ``depth_mm``, (objects,), too.
        """
        scene, parameters = self.template.draw(rng)
        if not self.shuffled_depths:
            return scene, parameters
        depths = np.array(self.depths_mm)
        if rng is not None:
            depths = rng.permutation(depths)
            scene = scene.at_depths(depths, self.camera)
        return scene, {**parameters, "depth_mm": depths}

    def encode(self, light_field: LightField) -> np.ndarray:
        """Show a light field to the network: float32 from 0 to 1, (height, width, channels)."""
        return self.input.encode(light_field, self.image)


def read_config(path: str | Path) -> DatasetConfig:
    """Read a data-set configuration from a TOML file.

    Raises
    ------
    InputError
        If the file cannot be read or holds an unknown, missing or impossible value.
    """
    values = read_toml(path)
    return config_from_json(values, path)


def config_from_json(values: dict, source: str | Path) -> DatasetConfig:
    """Rebuild a configuration from the JSON values that are stored with a data set."""
    template = TEMPLATES.get(values.get("kind"))
    if template is not None and "template" in values:
        # Built first, by its kind, so that a mistake in it is told in the words of that kind.
        built = build(template, values["template"], f"{source}: template")
        values = {**values, "template": built}
    return build(DatasetConfig, values, source)


def search_slopes(config: DatasetConfig) -> list[SlopeSearch]:
    """Find, on the mean scene, the slope that makes each object sharpest.

    Each search sees only the part of the image around its object.

    Returns
    -------
    list of SlopeSearch
        In the order of the template's objects.
    """
    scene, _ = config.draw(None)
    light_field = render_plan(scene, config.camera, config.plan, seed=config.seed)
    regions = [_region(layer, config.camera) for layer in scene.layers]
    return [find_sharpest_slope(light_field, region=region) for region in regions]


def _region(layer, camera: PlenopticCamera) -> tuple[int, int, int, int]:
    """Lenslets that a layer covers in the central view, and a few around them."""
    scale = camera.field_mm(layer.depth_mm)[0] / camera.lenslets[0]  # mm per lenslet
    region = []
    for axis in (0, 1):
        middle = (camera.lenslets[axis] - 1) / 2
        edges = layer.cell_edges_mm(axis)[[0, -1]] / scale + middle
        low, high = np.clip((edges[0] - 6, edges[1] + 6), 0, camera.lenslets[axis])
        region += [int(low), int(np.ceil(high))]
    return tuple(region)


def simulate_sample(config: DatasetConfig, slopes: list[float], index: int) -> dict:
    """Draw, render and refocus one sample.

    Returns
    -------
    dict
        ``input`` (height, width, channels) and ``target`` (objects, h, w), float32 in [0, 1], and
        ``parameters``.
    """
    light_field, parameters = render_sample(config, index)
    return {
        "input": config.encode(light_field),
        "target": area_average(shift_and_sum(light_field, slopes), config.image),
        "parameters": parameters,
    }


def render_sample(config: DatasetConfig, index: int) -> tuple[LightField, dict]:
    """Draw and render the light field of one sample; returns it with the scene's parameters."""
    scene, parameters = config.draw(np.random.default_rng([config.seed, index]))
    return render_drawn(scene, config, config.plan, index), parameters


def render_drawn(scene: Scene, config: DatasetConfig, plan: EffectPlan, index: int) -> LightField:
    """Render the scene of a sample."""
    seed = [config.seed, index, 1]  # of the sensor's noise, apart from the scene's
    return render_plan(scene, config.camera, plan, seed=seed)


def make_dataset(
    config: DatasetConfig,
    samples: int,
    path: str | Path,
    workers: int = 1,
    progress: Callable[[Iterable, int, int], Iterable] | None = None,
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

    Raises
    ------
    InputError
        If `path` exists, or a part of another data set lies in its way.
    OSError
        If a file cannot be written; finished samples are kept.
    """
    started, path = time.perf_counter(), Path(path)
    if path.exists():
        raise InputError(f"{path} exists; remove it or choose another folder.")
    part = path.with_name(path.name + ".part")
    if not _is_laid_out(part):
        _create(part, config, samples)
    group = zarr.open_group(part, mode="r+")
    _check_same(group, config, samples, part)
    slopes = group.attrs["slopes"]
    open_indices = np.flatnonzero(group["complete"][:] == 0).tolist()
    finished = _run(config, slopes, part, open_indices, workers)
    if progress is not None:
        finished = progress(finished, samples - len(open_indices), samples)
    for _ in finished:
        pass
    group.attrs["sha256"] = _digest(group)
    group.attrs["provenance"] = {
        **provenance.environment(),
        "workers": workers,
        "wall_s": round(time.perf_counter() - started, 2),
        "samples_this_run": len(open_indices),
    }
    part.rename(path)


def _create(part: Path, config: DatasetConfig, samples: int) -> None:
    searches = search_slopes(config)  # first: it also shows that the scene can be rendered
    part.mkdir(parents=True, exist_ok=True)
    _, parameters = config.draw(None)
    group = zarr.open_group(part, mode="w", zarr_format=3)

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
    add("complete", (), "uint8", 0)
    group.attrs.update(
        {
            "slopes": [search.slope for search in searches],
            "slopes_geometry": [config.camera.depth_to_slope(z) for z in config.depths_mm],
            "depths_mm": config.depths_mm,
            "objects": [o.name for o in config.template.objects],
            "plan": config.plan.to_json(),
            "config": to_json(config),  # last: its presence says that the group is laid out
        }
    )


def _is_laid_out(part: Path) -> bool:
    """Whether an earlier run got as far as the attributes, which come last."""
    if not (part / "zarr.json").exists():
        return False
    try:
        return "config" in zarr.open_group(part, mode="r").attrs
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{part} is damaged ({error}); remove it to start again.") from None


def _check_same(group: zarr.Group, config: DatasetConfig, samples: int, part: Path) -> None:
    same = group.attrs.get("config") == to_json(config) and group["complete"].shape[0] == samples
    if not same:
        raise InputError(
            f"{part} was begun with another configuration or number of samples; "
            f"remove it or choose another folder."
        )


def _run(config, slopes, part: Path, indices: list[int], workers: int) -> Iterable[int]:
    if workers == 1:
        group = zarr.open_group(part, mode="r+")
        for index in indices:
            _store(group, index, simulate_sample(config, slopes, index))
            yield index
        return
    context = multiprocessing.get_context("spawn")
    setup = (to_json(config), slopes, str(part))
    with ProcessPoolExecutor(workers, context, _start_worker, setup) as pool:
        jobs = [pool.submit(_work, index) for index in indices]
        try:
            for job in as_completed(jobs):
                yield job.result()
        finally:
            pool.shutdown(cancel_futures=True)


_worker = {}


def _start_worker(config: dict, slopes: list[float], part: str) -> None:
    import signal

    import numba

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    numba.set_num_threads(1)  # one process per core: the kernels run serially here
    _worker["config"] = config_from_json(config, part)
    _worker["slopes"] = slopes
    _worker["group"] = zarr.open_group(part, mode="r+")


def _work(index: int) -> int:
    _store(_worker["group"], index, simulate_sample(_worker["config"], _worker["slopes"], index))
    return index


def _store(group: zarr.Group, index: int, sample: dict) -> None:
    group["input"][index] = sample["input"]
    group["target"][index] = sample["target"]
    for name, values in sample["parameters"].items():
        group[f"parameters/{name}"][index] = values
    group["complete"][index] = 1  # last: a sample without it is made again


def _digest(group: zarr.Group) -> str:
    digest = hashlib.sha256()
    for index in range(group["complete"].shape[0]):
        digest.update(np.ascontiguousarray(group["input"][index]))
        digest.update(np.ascontiguousarray(group["target"][index]))
    return digest.hexdigest()


def split_indices(n: int, shares: tuple[float, float, float], seed: int) -> dict[str, np.ndarray]:
    """Split n samples at random into "train", "validation" and "test".

    Raises
    ------
    InputError
        If a part would be empty.
    """
    order = np.random.default_rng(seed).permutation(n)
    first, second = round(n * shares[0]), round(n * (shares[0] + shares[1]))
    parts = np.split(order, [first, second])
    if min(len(part) for part in parts) == 0:
        raise InputError(f"{n} samples are too few to split by {shares}: a part would be empty.")
    return dict(zip(("train", "validation", "test"), map(np.sort, parts), strict=True))


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
            raise InputError(f"There is no data set at {path}{hint}; make it with `make dataset`.")
        try:
            self._group = zarr.open_group(self.path, mode="r")
            self.attrs = dict(self._group.attrs)
            self.config = config_from_json(self.attrs["config"], self.path)
            complete = self._group["complete"][:]
        except (KeyError, ValueError, TypeError, RuntimeError, OSError) as error:
            raise InputError(f"{path} is not a data set, or is damaged: {error}") from None
        if not np.all(complete == 1):
            missing = np.flatnonzero(complete != 1)[0]
            raise InputError(f"{path} is not complete: sample {missing} is missing; make it again.")

    def __len__(self) -> int:
        return self._group["complete"].shape[0]

    @property
    def scenes_sha256(self) -> str:
        """Hash of what was asked for: the same on every machine, whose rounding may differ."""
        asked = {**to_json(self.config), "samples": len(self)}
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
        array = self._group[name]
        samples = []
        for index in range(len(self)):
            try:
                samples.append(array[index])
            except (ValueError, RuntimeError, OSError) as error:
                raise InputError(
                    f"Sample {index} of {self.path}/{name} is damaged ({error}); "
                    f"remove the data set and make it again."
                ) from None
            if not np.all(np.isfinite(samples[-1])):
                raise InputError(
                    f"Sample {index} of {self.path}/{name} is missing or not finite; "
                    f"remove the data set and make it again."
                )
        return np.stack(samples)
