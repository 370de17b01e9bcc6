"""How long a trained network takes for one picture, stage by stage, in 32 bits and in 16.

A raw lenslet image in memory is averaged to the network's size, the backbone makes features of it,
and the decoder images of these; at batch 1. Each round runs every precision stage by stage and in
one go, so that other load on the machine slows all alike. The floor is the time to read weights and
raw image from memory once, at the bandwidth measured in the same run.
"""

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import keras
import numpy as np
import pandas as pd

from experiments.command_parts import step_bar
from experiments.report import markdown, write_report
from experiments.timing import in_turn, measure_bandwidth
from lf_flame._common.figures import subplots
from lf_flame.datasets.encodings import area_average
from lf_flame.errors import InputError
from lf_flame.learning.run_folders import open_run
from lf_flame.learning.scores import psnr

PRECISIONS = ("float32", "bfloat16", "float16")

STAGES = {"resize": "#999999", "backbone": "#56B4E9", "decoder": "#E69F00"}
"""Colours of the stages."""

WHOLE = "whole"
"""Name of all stages in one go."""


def in_precision(network: keras.Model, precision: str) -> keras.Model:
    """Copy a network that computes, and keeps its weights, in another precision; XLA compiles it.

    Normalisations keep their weights in float32: variances of ImageNet's features exceed 65,504,
    the largest number of float16.
    """

    def copied(layer):
        normalises = isinstance(layer, keras.layers.BatchNormalization)
        kept = f"mixed_{precision}" if normalises and precision != "float32" else precision
        return type(layer).from_config(layer.get_config() | {"dtype": kept})

    clone = keras.models.clone_model(network, clone_function=copied, recursive=True)
    clone.set_weights(network.get_weights())
    for part in (clone, *clone.layers[1:]):
        part.compile(jit_compile=True)
    return clone


def stage_calls(network: keras.Model, raw: np.ndarray, size: tuple[int, int]) -> list[Callable]:
    """List calls from a raw image to images [1, plane, h, w, 1]: each stage, and all in one go."""
    backbone, decoder = network.layers[1:]

    def resize() -> np.ndarray:
        return area_average(raw, size)[None, ..., None]

    image = resize()
    features = backbone.predict_on_batch(image)
    return [
        resize,
        lambda: backbone.predict_on_batch(image),
        lambda: np.float32(decoder.predict_on_batch(features)),
        lambda: np.float32(network.predict_on_batch(resize())),
    ]


def measure_latency(runs: Sequence[Path], repeats: int = 30) -> dict:
    """Time trained networks in all precisions, in 3 rounds or more; returns the record.

    The raw images are random, for the time does not depend on what they show. An InputError says
    that a run or its data set cannot be used, or that the rounds are too few.
    """
    if repeats < 3:
        raise InputError(f"repeats must be 3 or more, for a median and its spread, got {repeats}.")
    started, bandwidth = time.perf_counter(), measure_bandwidth()
    networks, rows = {}, []
    for path in step_bar(runs):
        run = open_run(path)
        camera, data = run.config.camera, run.open_dataset()
        shape = [n * camera.views for n in camera.lenslets]
        raw = np.random.default_rng(0).random(shape, np.float32)
        indices = run.record["test_indices"][:16]
        shown, truths = data.inputs[indices], data.targets[indices]
        rows += [
            {"network": str(path), "floor_ms": 1e3 * row.pop("read_bytes") / bandwidth, **row}
            for row in _measure(run.load_network(), raw, shown, truths, repeats)
        ]
        networks[str(path)] = (
            f"{run.record['title']}, {run.record['preset']}, backbone "
            f"{run.record['backbone_weights']}: {shape[0]} x {shape[1]} pixels to "
            f"{truths.shape[1]} images; PSNR on {len(indices)} test images"
        )
    return {
        "networks": networks,
        "repeats": repeats,
        "bandwidth_gb_s": bandwidth / 1e9,
        "ways": rows,
        "wall_s": time.perf_counter() - started,
    }


def _measure(network, raw, inputs, truths, repeats: int) -> list[dict]:
    """Time the stages of a network in all precisions in turn; a row for each precision."""
    copies = [in_precision(network, precision) for precision in PRECISIONS]
    calls = [call for copy in copies for call in stage_calls(copy, raw, inputs.shape[1:3])]
    ms = iter(1e3 * in_turn(*calls, rounds=repeats).seconds)
    rows, reference = [], None
    for precision, copy in zip(PRECISIONS, copies, strict=True):
        stacks = [np.float32(copy.predict_on_batch(image[None])) for image in inputs]
        images = np.concatenate(stacks)[..., 0]
        reference = images if reference is None else reference
        weights = sum(keras.ops.convert_to_numpy(x).nbytes for x in copy.weights)
        row = {"precision": precision}
        for stage in (*STAGES, WHOLE):
            quartiles = np.percentile(next(ms), (50, 25, 75)).tolist()
            row |= dict(zip(columns(stage), quartiles, strict=True))
        rows.append(row | {
            "read_bytes": weights + raw.nbytes,
            "weights_mb": weights / 1e6,
            "psnr_db": psnr(reference, images),
            "truth_psnr_db": psnr(truths, images),
        })  # fmt: skip
    return rows


def columns(stage: str) -> tuple[str, str, str]:
    """Name the columns that hold median, lower and upper quartile of a stage."""
    return f"{stage}_ms", f"{stage}_q1_ms", f"{stage}_q3_ms"


def write(out: Path, record: dict) -> Path:
    """Write ``latency.*`` from the record of `measure_latency`."""
    table = pd.DataFrame(record["ways"])
    shown = table.assign(times_floor=table[f"{WHOLE}_ms"] / table["floor_ms"])
    shown["psnr_db"] = shown["psnr_db"].where(shown["precision"] != PRECISIONS[0], "same")
    for stage in (*STAGES, WHOLE):
        quartiles = table[list(columns(stage))].itertuples(index=False)
        shown[stage] = ["{:.1f} ({:.1f}-{:.1f})".format(*row) for row in quartiles]
    headings = {
        "network": ("network", ""),
        "precision": ("precision", ""),
        **{stage: (f"{stage} (ms)", str) for stage in STAGES},
        WHOLE: ("in one go (ms)", str),
        "times_floor": ("x floor", ".1f"),
        "weights_mb": ("weights (MB)", ".0f"),
        "psnr_db": ("PSNR to float32 (dB)", lambda x: x if isinstance(x, str) else f"{x:.1f}"),
        "truth_psnr_db": ("to the truth (dB)", ".2f"),
    }
    body = [
        "\n".join(f"- {name}: {words}" for name, words in record["networks"].items()),
        f"""From a raw lenslet image in memory (random, float32) to refocused images in memory, at
batch 1, loaded and compiled by XLA. Median and quartiles of {record["repeats"]} rounds. Floor:
reading weights and raw image once at {record["bandwidth_gb_s"]:.3g} GB/s, measured in this run.""",
        "![Milliseconds of each stage](latency.png)",
        markdown(shown, headings, missing="missing"),
    ]
    return write_report(
        out, "latency", "Latency of one picture", record, body,
        tables={"latency": table}, pictures={"latency": figure(table)},
    )  # fmt: skip


def figure(table: pd.DataFrame):
    """Draw the stages as bars, one for each network and precision."""
    picture, axis = subplots(figsize=(9, 1.6 + 0.45 * len(table)), layout="constrained")
    at, left = np.arange(len(table)), 0.0
    for stage, colour in STAGES.items():
        axis.barh(at, table[f"{stage}_ms"], 0.62, left, color=colour, label=stage)
        left = left + table[f"{stage}_ms"]
    middle, low, high = (table[name] for name in columns(WHOLE))
    axis.errorbar(
        middle, at, xerr=(middle - low, high - middle), fmt="D", color="black", markersize=4,
        capsize=3, label="in one go, with quartiles",
    )  # fmt: skip
    axis.plot(table["floor_ms"], at, "|", color="#D55E00", markersize=20, markeredgewidth=2.5,
              label="floor: weights and raw image read once")  # fmt: skip
    axis.set_yticks(at, [f"{x.network}, {x.precision}" for x in table.itertuples()])
    axis.invert_yaxis()
    axis.set_xlabel("milliseconds (median), from a raw lenslet image to the refocused images")
    axis.grid(axis="x", alpha=0.25)
    axis.set_axisbelow(True)
    picture.legend(loc="outside lower center", ncols=3, frameon=False)
    return picture
