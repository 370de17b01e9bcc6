"""What accuracy costs in time when refocusing: SSIM and PSNR over milliseconds, beside the network.

All methods go from the same light fields in memory to the same images, those of a data set's
targets, on all cores of one machine, one after the other in one process, compiled beforehand. Exact
are all views, shifted by exact phases (`lf_flame.refocus.fourier_refocus`, "sinc", in float64, with
clamped edges): nothing is interpolated. (The targets that networks are trained on are linear
shift-and-sum.)
"""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numba
import numpy as np
import pandas as pd
from scipy.fft import set_workers
from skimage.transform import downscale_local_mean

from experiments.command_parts import step_bar
from experiments.held_out import HeldOut, find_scenes
from experiments.paths import DATA_SETS
from experiments.timing import in_turn
from lf_flame._common.arrays import area_average
from lf_flame._common.config import to_json
from lf_flame.datasets.config import DatasetConfig, read_config
from lf_flame.datasets.sampling import render_sample
from lf_flame.learning.run_folders import open_run
from lf_flame.learning.scores import psnr, ssim
from lf_flame.lightfield import LightField
from lf_flame.refocus import fourier_refocus, fourier_slice, shift_and_sum

SHOWN = {"raw": "the mean of all views", "views": "three views", "grid": "views side by side"}
"""Input of networks in words, by its kind."""

NETWORK, ALONE = "ResNet-50", "ResNet-50, its input given"
"""Labels of the trained network: from the light field, and without averaging its views."""


@dataclass(frozen=True)
class Method:
    """A method that takes a light field in memory to refocused images.

    Its family, what it has in common with others, has a colour in the figure; the label is short,
    the title stands in the table. `refocus` takes what is stored, and slopes, to images [n, t, s]
    of the lenslets or of the targets; `store` takes views to what lies in memory, in no time that
    counts.
    """

    family: str
    label: str
    title: str
    refocus: Callable[[np.ndarray, np.ndarray], np.ndarray]
    store: Callable[[np.ndarray], np.ndarray] = np.asarray


def formula_methods(views: int, block: tuple[int, int]) -> list[Method]:
    """List the methods that need no training; a block of lenslets is a pixel of the targets."""
    every = f"{views} x {views} views"
    interpolations = [
        Method("interpolation", name, f"{name}, {every}", partial(_in_space, interpolation=name))
        for name in ("nearest", "linear", "cubic")
    ]
    return [
        *interpolations,
        *_with_fewer_views(views),
        *_stored_smaller(every, block),
        Method("fourier", "phases, padded", f"exact phases, {every}, padded",
            partial(fourier_refocus, edges="clamp")),
        Method("fourier", "phases", f"exact phases, {every}, not padded", fourier_refocus),
        Method("fourier", "slice, padded", f"Fourier slice, {every}, padded",
            partial(fourier_slice, edges="clamp")),
        Method("fourier", "slice", f"Fourier slice, {every}, not padded", fourier_slice),
    ]  # fmt: skip


def _with_fewer_views(views: int) -> Iterator[Method]:
    """Take the central views; then views as far apart as leaves those at the rim."""
    for n in range(2 + views % 2, views, 2):
        title, store = f"linear, {n} x {n} central views", partial(_central, count=n)
        yield Method("central", f"{n} x {n}", title, _in_space, store)
    for step in (k for k in range(views - 1, 1, -1) if (views - 1) % k == 0):
        n = (views - 1) // step + 1
        title, store = f"linear, {n} x {n} views over the full aperture", partial(_every, step=step)
        yield Method("spread", f"{n} x {n}", title, partial(_in_space, step=step), store)


def _stored_smaller(every: str, block: tuple[int, int]) -> Iterator[Method]:
    for kind in (np.float16, np.uint16, np.uint8):
        name, store = np.dtype(kind).name, partial(_stored, kind=kind)
        yield Method("storage", name, f"linear, {every}, stored as {name}", _in_space, store)
    if block[0] == block[1] > 1:
        name, store = binned(block), partial(downscale_local_mean, factors=(1, 1, *block))
        refocus = partial(_in_space, step=1 / block[0])
        yield Method("storage", name, f"linear, {every}, stored {name}", refocus, store)


def binned(block: tuple[int, int]) -> str:
    """Label the light field whose lenslets are averaged to the pixels of the targets."""
    return f"{block[0]} x {block[1]} binned"


def _in_space(views, slopes, interpolation: str = "linear", step: float = 1.0) -> np.ndarray:
    images = shift_and_sum(views, step * slopes, interpolation=interpolation)
    full_scale = np.iinfo(views.dtype).max if views.dtype.kind == "u" else 1
    return images / np.float32(full_scale)


def _central(views: np.ndarray, count: int) -> np.ndarray:
    """Cut out the views of a smaller aperture, as a camera without others has them in memory."""
    middle = slice((len(views) - count) // 2, (len(views) + count) // 2)
    return np.ascontiguousarray(views[middle, middle])


def _every(views: np.ndarray, step: int) -> np.ndarray:
    return np.ascontiguousarray(views[::step, ::step])


def _stored(views: np.ndarray, kind: type) -> np.ndarray:
    """Store views in fewer bits; where they become whole numbers the sensor saturates at 1."""
    if np.issubdtype(kind, np.floating):
        return views.astype(kind)
    return np.round(np.clip(views, 0, 1) * np.float32(np.iinfo(kind).max)).astype(kind)


def network_methods(scenes: HeldOut) -> list[Method]:
    """Load the trained network, if there is one: from the light field, and from its input alone.

    It runs on the processor like all others, compiled as a whole.
    """
    if scenes.run is None:
        return []
    import keras  # here, so that the rest can be measured without loading it

    with keras.device("cpu:0"):
        model = open_run(scenes.run).load_network()
    model.compile(jit_compile=True)  # XLA: for single images the fastest form there is

    def predict(image: np.ndarray, _slopes) -> np.ndarray:
        with keras.device("cpu:0"):
            return model.predict_on_batch(image[None])[0, ..., 0]

    def encode(views: np.ndarray) -> np.ndarray:
        return scenes.config.encode(LightField.trusted(views))

    return [
        Method("network", NETWORK, f"{NETWORK}, shown {SHOWN[scenes.config.input.kind]}",
            lambda views, slopes: predict(encode(views), slopes)),
        Method("network", ALONE, ALONE, predict, encode),
    ]  # fmt: skip


def measure_refocusing(run: Path, configs: Sequence[DatasetConfig] | None = None) -> dict:
    """Measure SSIM and PSNR against the exact result over milliseconds.

    A run is a folder of trained networks, one for each kind of data set, ``shapes`` and ``flames``;
    one that is missing shows as missing. Default of the configurations: the paper's. Returns the
    record, in ``methods`` a row for each.
    """
    started, rows = time.perf_counter(), []
    if configs is None:
        configs = [read_config(path) for path in DATA_SETS]
    found = [find_scenes(config, run / config.kind) for config in configs]
    studies = [
        (one, formula_methods(one.config.camera.views, one.config.block) + network_methods(one))
        for one in found
    ]
    steps = (step for study in studies for step in _measure(*study))
    total = sum(len(scenes.indices) * len(methods) for scenes, methods in studies)
    with set_workers(numba.get_num_threads()):
        for more in step_bar(steps, total):
            rows += more
    missing = [
        {"data_set": scenes.name, "family": "network", "label": NETWORK, "title": NETWORK}
        for scenes in found
        if scenes.run is None
    ]
    return {
        "scenes": {scenes.name: _described(scenes) for scenes in found},
        "threads": numba.get_num_threads(),
        "wall_s": time.perf_counter() - started,
        "methods": [*summarise(pd.DataFrame(rows)).to_dict("records"), *missing],
    }


def _described(scenes: HeldOut) -> dict:
    return {
        "config": to_json(scenes.config),
        "slopes": scenes.slopes,
        "samples": scenes.indices,
        "run": scenes.run and str(scenes.run),
        "network": scenes.origin,
    }


def _measure(scenes: HeldOut, methods: Sequence[Method]) -> Iterator[list[dict]]:
    """Yield the scores of a sample's images, method by method; timed on the first sample."""
    slopes, size = np.array(scenes.slopes), scenes.config.image
    for index in scenes.indices:
        views = render_sample(scenes.config, index)[0].views
        exact = area_average(
            fourier_refocus(views, slopes, interpolation="sinc", edges="clamp"), size
        )
        for method in methods:
            stored = method.store(views)

            def call(method=method, stored=stored) -> np.ndarray:
                return area_average(method.refocus(stored, slopes), size)

            images, seconds = call(), math.nan
            if index == scenes.indices[0]:
                seconds = in_turn(call).best[0]
            row = {"data_set": scenes.name, "family": method.family, "label": method.label}
            row |= {"title": method.title, "seconds": seconds}
            pairs = zip(exact, images, strict=True)
            yield [row | {"ssim": ssim(*pair), "psnr_db": psnr(*pair)} for pair in pairs]


def summarise(rows: pd.DataFrame) -> pd.DataFrame:
    """Put the scores of all images together.

    One method and data set a row: milliseconds; mean and lowest SSIM; PSNR of the mean squared
    error of all images (a mean in dB would be infinite where one image is exact), and the lowest of
    an image.
    """
    squared = rows.assign(mse=10 ** (-rows["psnr_db"] / 10))
    methods = squared.groupby(["data_set", "family", "label", "title"], sort=False)
    with np.errstate(divide="ignore"):
        pooled = -10 * np.log10(methods["mse"].mean())
    table = pd.DataFrame(
        {
            "milliseconds": 1e3 * methods["seconds"].min(),
            "ssim": methods["ssim"].mean(),
            "psnr_db": pooled,
            "worst_ssim": methods["ssim"].min(),
            "worst_psnr_db": methods["psnr_db"].min(),
        }
    )
    return table.reset_index()
