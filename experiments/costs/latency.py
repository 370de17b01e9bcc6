"""How long a trained network takes for one picture, stage by stage, in 32 bits and in fewer.

The clock runs as for a user who has a raw lenslet image in memory: it is averaged to the network's
size, the backbone makes features of it, and the decoder images of these; at batch 1. In each round
every precision goes it once stage by stage and once in one go, so that what else the machine does
hits all alike. The floor is the time that it takes to read weights and raw image from memory once,
at a bandwidth measured in the same run.
"""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import keras
import numpy as np

from experiments.command_parts import step_bar
from experiments.costs.precision import (
    PRECISIONS,
    compiled,
    compilers,
    describe,
    in_precision,
    weight_bytes,
)
from experiments.timing import in_turn, measure_bandwidth
from lf_flame._common.arrays import area_average
from lf_flame._common.config import to_json
from lf_flame.errors import InputError
from lf_flame.learning.model_card import NetworkCard, load_network, read_card
from lf_flame.learning.prediction import input_size
from lf_flame.learning.run_folders import open_run
from lf_flame.learning.scores import psnr

STAGES = ("resize", "backbone", "decoder")
WHOLE = "whole"
"""Label of all stages in one go."""

FACTS = "weights_mb", "psnr_db", "truth_psnr_db"
"""Columns of what a variant weighs, and of its images against float32's and against the truth."""

PICTURES = 16
"""Test inputs at most, on which precisions are compared."""


@dataclass(frozen=True, eq=False)
class Subject:
    """A trained network by its path, as it was given, and what it is shown.

    Attributes
    ----------
    raw : ndarray of float32, shape (lenslets * views along t, along s), values in [0, 1]
        Raw lenslet image, random: how long it takes does not depend on what it shows.
    inputs : ndarray of float32, shape (n, h, w, 1)
        On which precisions are compared.
    truths : ndarray of float32, shape (n, planes, h, w), or None
        What the network should make of them, where that is known.
    origin : str
        What the inputs are.
    """

    label: str
    card: NetworkCard
    network: keras.Model
    raw: np.ndarray
    inputs: np.ndarray
    truths: np.ndarray | None
    origin: str


def open_subject(path: str | Path, seed: int = 0) -> Subject:
    """Load a network, of a run folder or an exported ``.keras`` file, with pictures to show it.

    An InputError says that there is none, that it is not made of a backbone and a decoder, or that
    it is shown several views.
    """
    path = Path(path)
    card = read_card(path)
    size = input_size(card)
    network = load_network(path, card)
    check_parts(network, path)
    camera = card.camera
    shape = [n * camera.views for n in camera.lenslets]
    raw = np.random.default_rng(seed).random(shape, np.float32)
    alone = "the random raw image: no test inputs are at hand"
    inputs, truths, origin = _test_inputs(path) or (_resized(raw, size), None, alone)
    return Subject(str(path), card, network, raw, inputs, truths, origin)


def _test_inputs(path: Path) -> tuple | None:
    """Read pictures of a run's test split; None where its data set is not at hand."""
    if not path.is_dir():
        return None
    try:
        run = open_run(path)
        dataset = run.open_dataset()
    except InputError:
        return None
    indices = run.record["test_indices"][:PICTURES]
    origin = f"{len(indices)} test inputs of its data set, {dataset.path.name}"
    return dataset.inputs[indices], dataset.targets[indices], origin


def check_parts(network: keras.Model, path: Path) -> None:
    """Refuse a network that is not made of a backbone and a decoder."""
    names = [layer.name for layer in network.layers[1:]]
    if names != ["backbone", "decoder"]:
        raise InputError(
            f"{path} is made of {', '.join(names)}; it must be a backbone and a decoder, as "
            f"`lf-flame train` makes them."
        )


def _resized(raw: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    return area_average(raw, size)[None, ..., None]


def build_variants(subject: Subject, chosen: dict[str, bool]) -> Iterator[tuple[dict, tuple]]:
    """Build a network in each precision, compile it, and compare its images with float32's.

    Yields what the table says of it, and backbone, decoder and the whole; of what the platform
    cannot do the reason, and none.
    """
    reference, truths = None, subject.truths
    for precision in PRECISIONS:
        network, reason = _attempt(in_precision, subject.network, precision)
        computes = "" if network is None else describe(network, precision)
        for compiler, xla in chosen.items():
            parts, missing, facts = (), reason, dict.fromkeys(FACTS, math.nan)
            if network is not None:
                parts = tuple(compiled(part, xla) for part in (*network.layers[1:], network))
                stacks, missing = _attempt(predict, parts[-1], subject.inputs)
            if missing is None:
                reference = stacks if reference is None else reference
                facts = {
                    "weights_mb": weight_bytes(network) / 1e6,
                    "psnr_db": psnr(reference, stacks),
                    "truth_psnr_db": math.nan if truths is None else psnr(truths, stacks),
                }
            names = {"network": subject.label, "precision": precision, "compiler": compiler}
            said = {"computes": computes, "missing": missing or ""}
            yield names | facts | said, () if missing else parts


def _attempt(call: Callable, *args) -> tuple:
    """Give a result and None, or None and why there is no result, in a sentence."""
    try:
        return call(*args), None
    except MemoryError:
        raise
    except Exception as error:  # each library has kinds of its own for "not on this machine"
        return None, f"{type(error).__name__}: {str(error).strip().partition(chr(10))[0]}"


def predict(network: keras.Model, inputs: np.ndarray) -> np.ndarray:
    """Refocus inputs [n, h, w, 1] one by one: float32 [n, planes, h, w]."""
    stacks = [network.predict_on_batch(image[None]) for image in inputs]
    found = np.float32(np.concatenate(stacks))[..., 0]
    if not np.all(np.isfinite(found)):
        raise FloatingPointError("its images are not finite")
    return found


def stages(parts: tuple, raw: np.ndarray, size: tuple[int, int]) -> dict[str, Callable]:
    """List calls from a raw image to images [1, plane, h, w, 1]: each stage, and all in one go."""
    backbone, decoder, network = parts
    image = _resized(raw, size)
    features = backbone.predict_on_batch(image)
    calls = (
        lambda: _resized(raw, size),
        lambda: backbone.predict_on_batch(image),
        lambda: np.float32(decoder.predict_on_batch(features)),
        lambda: np.float32(network.predict_on_batch(_resized(raw, size))),
    )
    return dict(zip((*STAGES, WHOLE), calls, strict=True))


def measure_latency(networks: Sequence[str | Path], repeats: int = 30, seed: int = 0) -> dict:
    """Time trained networks stage by stage in all precisions, in 3 rounds or more that count.

    The seed is that of the raw images. Returns the record, in ``ways`` a row for each variant. An
    InputError says that a network cannot be used, or that the rounds are too few.
    """
    if repeats < 3:
        raise InputError(f"repeats must be 3 or more, for a median and its spread, got {repeats}.")
    started, bandwidth = time.perf_counter(), measure_bandwidth()
    subjects = [open_subject(path, seed) for path in dict.fromkeys(networks)]
    return {
        "networks": {subject.label: _described(subject) for subject in subjects},
        "repeats": repeats,
        "seed": seed,
        "backend": keras.backend.backend(),
        "bandwidth_gb_s": bandwidth / 1e9,
        "ways": [row for one in step_bar(subjects) for row in _measure(one, repeats, bandwidth)],
        "wall_s": time.perf_counter() - started,
    }


def _measure(subject: Subject, repeats: int, bandwidth: float) -> list[dict]:
    """Build all variants of a network, then time their stages in turn; a row for each variant."""
    variants, size = list(build_variants(subject, compilers())), input_size(subject.card)
    calls = [stages(parts, subject.raw, size).values() for _, parts in variants if parts]
    times = in_turn(*sum(map(list, calls), []), rounds=repeats).seconds if calls else ()
    left = iter(times)
    rows = []
    for facts, parts in variants:
        ms = [1e3 * next(left) if parts else [math.nan] for _ in (*STAGES, WHOLE)]
        rows.append(summarise(facts, ms, subject.raw.nbytes, bandwidth))
    return rows


def columns(stage: str) -> tuple[str, str, str]:
    """Name the columns that hold median, lower and upper quartile of a stage."""
    return f"{stage}_ms", f"{stage}_q1_ms", f"{stage}_q3_ms"


def summarise(facts: dict, ms: Sequence, raw_bytes: int, bandwidth: float) -> dict:
    """Make a row of the table: medians, quartiles, floor, and what it costs in images.

    In milliseconds, megabytes (1e6 bytes) and dB, for a bandwidth in bytes per second; NaN where
    the variant is missing.
    """
    row = {name: facts[name] for name in ("network", "precision", "compiler")}
    for stage, rounds in zip((*STAGES, WHOLE), ms, strict=True):
        quartiles = np.percentile(rounds, (50, 25, 75)).tolist()
        row |= dict(zip(columns(stage), quartiles, strict=True))
    floor_ms = 1e3 * (1e6 * facts["weights_mb"] + raw_bytes) / bandwidth
    return row | {"floor_ms": floor_ms, "times_floor": row[f"{WHOLE}_ms"] / floor_ms} | facts


def _described(subject: Subject) -> dict:
    card = subject.card
    return {
        "title": card.title,
        "preset": card.preset,
        "backbone_weights": card.backbone_weights,
        "image": card.image,
        "planes": len(card.depths_mm),
        "camera": to_json(card.camera),
        "raw_pixels": subject.raw.shape,
        "raw_mb": subject.raw.nbytes / 1e6,
        "compared_on": subject.origin,
    }
