"""Accuracy against time in refocusing: SSIM and PSNR over milliseconds, and the network's.

All methods go from the same light fields in memory, as separated views or as the raw image of the
camera, to the same images, those of a data set's targets, on all cores, one after the other in one
process, compiled beforehand. Exact are all views, shifted by exact phases
(`lf_flame.refocus.fourier_refocus`, "sinc", in float64, with clamped edges): nothing is
interpolated. (The targets that networks are trained on are linear shift-and-sum.)
"""

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numba
import numpy as np
import pandas as pd
from scipy.fft import set_workers
from skimage.transform import downscale_local_mean

from experiments.inputs import DATA_SETS, HeldOut, find_scenes
from experiments.report import markdown, panels, step_bar, write_report
from experiments.timing import in_turn
from lf_flame.datasets.config import DatasetConfig, read_config
from lf_flame.datasets.sampling import render_sample
from lf_flame.errors import InputError
from lf_flame.learning.run_folders import open_run
from lf_flame.learning.scores import psnr, ssim
from lf_flame.lightfield import LightField
from lf_flame.refocus import fourier_refocus, fourier_slice, shift_and_sum

NETWORK, UNTRAINED = "ResNet-50", "all five stages, random weights, not trained: only time counts"
"""Title of the network from separated views, and its origin without a run."""

FAMILIES = {
    "interpolation": ("#0072B2", "osD"),
    "raw": ("#56B4E9", "osD"),
    "few": ("#009E73", "o^sD"),
    "binned": ("#CC79A7", "o"),
    "fourier": ("#000000", "os"),
    "network": ("#D55E00", "*oP"),
}
"""Colour and markers of the families of methods."""


@dataclass(frozen=True)
class Method:
    """A method that takes a light field in memory to refocused images.

    `refocus` takes what is stored, and slopes, to images [n, t, s] of the lenslets or of the
    targets; `store` takes views to what lies in memory, which is not timed.
    """

    family: str
    title: str
    refocus: Callable[[np.ndarray, np.ndarray], np.ndarray]
    store: Callable[[np.ndarray], np.ndarray] = np.asarray


def formula_methods(views: int, block: tuple[int, int]) -> Iterator[Method]:
    """Yield the methods that need no training; a block of lenslets is a pixel of the targets."""
    for name in ("nearest", "linear", "cubic"):
        yield Method("interpolation", name, partial(_in_space, interpolation=name))
    for bits, words in ((0, ""), (16, " of 16 bits"), (8, " of 8 bits")):
        yield Method("raw", f"linear, from the raw image{words}", partial(_from_raw, views=views),
                     partial(_as_raw, bits=bits))  # fmt: skip
    for step in (k for k in range(views - 1, 1, -1) if (views - 1) % k == 0):
        n = (views - 1) // step + 1
        yield Method("few", f"linear, {n} x {n} views over the full aperture",
                     partial(_in_space, step=step),
                     lambda views, step=step: views[::step, ::step].copy())  # fmt: skip
    if block[0] == block[1] > 1:
        yield Method("binned", f"linear, stored {block[0]} x {block[1]} binned",
                     partial(_in_space, step=1 / block[0]),
                     partial(downscale_local_mean, factors=(1, 1, *block)))  # fmt: skip
    yield Method("fourier", "exact phases", partial(fourier_refocus, edges="clamp"))
    yield Method("fourier", "Fourier slice", partial(fourier_slice, edges="clamp"))


def _in_space(views, slopes, interpolation: str = "linear", step: float = 1.0) -> np.ndarray:
    images = shift_and_sum(views, step * slopes, interpolation=interpolation)
    return images / np.float32(np.iinfo(views.dtype).max if views.dtype.kind == "u" else 1)


def _as_raw(views: np.ndarray, bits: int = 0) -> np.ndarray:
    """Join views to a raw image: float32, or integers of `bits` bits that saturate at 1."""
    raw = LightField.trusted(views).to_raw()
    whole = np.round(np.clip(raw, 0, 1) * np.float32(2**bits - 1))
    return whole.astype(f"uint{bits}") if bits else raw


def _from_raw(raw: np.ndarray, slopes: np.ndarray, views: int) -> np.ndarray:
    cells = raw.reshape(len(raw) // views, views, -1, views)
    return _in_space(cells.transpose(1, 3, 0, 2), slopes)


def shrink(images: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Average areas so that the last two axes have `size`, by a product that memory limits."""
    down, across = (n // m for n, m in zip(images.shape[-2:], size, strict=True))
    rows = images.reshape(*images.shape[:-2], size[0], down, -1)
    sums = np.ones(down, images.dtype) @ rows
    return sums.reshape(*sums.shape[:-1], size[1], across).sum(-1) / np.float32(down * across)


def network_methods(scenes: HeldOut) -> list[Method]:
    """Load the trained network, from views, raw image and input; without a run it is untrained.

    Its time does not depend on its weights. The input is the paper's, the raw image resized.
    """
    import keras  # here, so that the rest can be measured without loading it

    from lf_flame.models import build_refocus_resnet50

    config, size = scenes.config, scenes.config.image
    if config.input.kind != "raw":
        raise InputError(f"The network in {scenes.run} must see the raw image, as in the paper.")
    build = partial(build_refocus_resnet50, size, len(scenes.slopes), "random")
    with keras.device("cpu:0"):
        model = open_run(scenes.run).load_network() if scenes.run else build()
    model.compile(jit_compile=True)  # XLA: for single images the fastest form there is

    def predict(image: np.ndarray, _slopes) -> np.ndarray:
        with keras.device("cpu:0"):
            return model.predict_on_batch(image[None, ..., None])[0, ..., 0]

    def encode(views: np.ndarray) -> np.ndarray:
        pixels = math.prod(config.camera.lenslets)
        photograph = shrink(views.reshape(-1, pixels), (1, pixels))
        return shrink(photograph.reshape(config.camera.lenslets), size)

    return [
        Method("network", NETWORK, lambda views, _: predict(encode(views), _)),
        Method("network", f"{NETWORK}, from the raw image",
               lambda raw, _: predict(shrink(raw, size), _), _as_raw),
        Method("network", f"{NETWORK}, its input given", predict, encode),
    ]  # fmt: skip


def measure_refocusing(run: Path, configs: Sequence[DatasetConfig] | None = None) -> dict:
    """Measure all methods on data sets, by default the paper's, and the networks RUN/KIND."""
    started, rows = time.perf_counter(), []
    found = [
        find_scenes(config, run / config.kind) for config in configs or map(read_config, DATA_SETS)
    ]
    with set_workers(numba.get_num_threads()):
        for scenes in found:
            camera, block = scenes.config.camera, scenes.config.block
            methods = [*formula_methods(camera.views, block), *network_methods(scenes)]
            for some in step_bar(_measure(scenes, methods), len(scenes.indices) * len(methods)):
                rows += some
    return {
        "scenes": {scenes.config.kind: _described(scenes) for scenes in found},
        "threads": numba.get_num_threads(),
        "wall_s": time.perf_counter() - started,
        "methods": summarise(pd.DataFrame(rows)).to_dict("records"),
    }


def _described(scenes: HeldOut) -> dict:
    config = scenes.config
    (lines, columns), views = config.camera.lenslets, config.camera.views
    return {
        "light_field": f"{views} x {views} views of {lines} x {columns} lenslets to "
        f"{len(scenes.slopes)} images of {config.image[0]} x {config.image[1]}",
        "samples": scenes.indices,
        "slopes": scenes.slopes,
        "network": scenes.origin if scenes.run else UNTRAINED,
    }


def _measure(scenes: HeldOut, methods: Sequence[Method]) -> Iterator[list[dict]]:
    """Yield the scores of a sample's images, method by method; timed on the first sample."""
    slopes, size = np.array(scenes.slopes), scenes.config.image
    for index in scenes.indices:
        views = render_sample(scenes.config, index)[0].views
        exact = fourier_refocus(views, slopes, interpolation="sinc", edges="clamp")
        exact = np.clip(shrink(exact, size), 0, 1)
        for method in methods:
            stored = method.store(views)

            def call(method=method, stored=stored) -> np.ndarray:
                return np.clip(shrink(method.refocus(stored, slopes), size), 0, 1)

            images, seconds = call(), math.nan
            if index == scenes.indices[0]:
                seconds = in_turn(call).best[0]
            if method.family == "network" and scenes.run is None:
                images = np.full_like(exact, np.nan)  # no score
            row = {"data_set": scenes.config.kind, "family": method.family, "title": method.title}
            yield [
                row | {"seconds": seconds, "ssim": ssim(*pair), "psnr_db": psnr(*pair)}
                for pair in zip(exact, images, strict=True)
            ]


def summarise(rows: pd.DataFrame) -> pd.DataFrame:
    """Put the scores of all images together: one data set and method per row.

    PSNR is that of the mean squared error of all images: a mean in dB would be infinite where one
    image is exact.
    """
    squared = rows.assign(mse=10 ** (-rows["psnr_db"] / 10))
    methods = squared.groupby(["data_set", "family", "title"], sort=False)
    with np.errstate(divide="ignore"):
        pooled = -10 * np.log10(methods["mse"].mean())
    columns = {
        "milliseconds": 1e3 * methods["seconds"].min(),
        "psnr_db": pooled,
        "worst_psnr_db": methods["psnr_db"].min(),
        "ssim": methods["ssim"].mean(),
        "worst_ssim": methods["ssim"].min(),
    }
    return pd.DataFrame(columns).reset_index()


def write(out: Path, record: dict) -> Path:
    """Write ``refocusing.*`` from the record of `measure_refocusing`."""
    table = pd.DataFrame(record["methods"])

    def decibels(value: float) -> str:
        return {math.inf: "exact"}.get(value, "" if math.isnan(value) else f"{value:.1f}")

    headings = {
        "data_set": ("data set", ""),
        "title": ("method", ""),
        "milliseconds": ("ms", ",.1f"),
        "psnr_db": ("PSNR (dB)", decibels),
        "worst_psnr_db": ("worst", decibels),
        "ssim": ("SSIM", ".5f"),
        "worst_ssim": ("worst", ".5f"),
    }
    lines = [
        f"- {name}: {x['light_field']}; samples {', '.join(map(str, x['samples']))}. "
        f"{NETWORK}: {x['network']}"
        for name, x in record["scenes"].items()
    ]
    body = [
        "\n".join(lines),
        f"""Time: from separated views in memory, or from the raw image, to the finished images, the
fastest of a few runs, compiled beforehand, on {record["threads"]} threads, without a graphics card;
the network sees one image at a time, and averaging the views or the raw image to its input counts.
Score: against exact phases of all views, averaged and clipped like the targets of the data sets,
over samples that no network was trained on. PSNR is that of the mean squared error of all images;
worst is a single image. Few views over the full aperture show ghosts.""",
        "![PSNR over milliseconds](refocusing.png)",
        markdown(table, headings),
    ]
    return write_report(
        out, "refocusing", "What accuracy costs in time: refocusing", record, body,
        tables={"refocusing": table}, pictures={"refocusing": figure(record["scenes"], table)},
    )  # fmt: skip


def figure(scenes: Mapping[str, dict], table: pd.DataFrame):
    """Draw PSNR over milliseconds, without the exact result, one panel for each data set."""
    titles = [f"{name}: {scene['light_field']}" for name, scene in scenes.items()]
    size = (6.0 * len(scenes), 6.5)
    picture, axes = panels(titles, size, "milliseconds on all cores", sharex=True, sharey=True)
    for axis, name in zip(axes, scenes, strict=True):
        rows = table[(table["data_set"] == name) & (table["psnr_db"] < np.inf)]
        for family, (colour, markers) in FAMILIES.items():
            some = rows[rows["family"] == family].to_dict("records")
            for row, marker in zip(some, markers, strict=False):
                axis.plot(row["milliseconds"], row["psnr_db"], marker, color=colour,
                          label=row["title"], markersize=8)  # fmt: skip
    axes[0].set(xscale="log", ylabel="PSNR against the exact result (dB)")
    handles = axes[0].get_legend_handles_labels()
    picture.legend(*handles, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    return picture
