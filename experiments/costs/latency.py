"""How long a trained network takes for one picture, stage by stage, in 32 bits and in fewer.

The clock runs as for a user who has a raw lenslet image in memory: it is averaged to the network's
size, the backbone makes features of it, and the decoder images of these; at batch 1. In each round
every precision goes it once stage by stage and once in one go, in an order drawn anew, so that what
else the machine does, and what the one before left behind, hits all alike. The floor is the time
that it takes to read weights and raw image from memory once, at a bandwidth measured in the same
run.
"""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
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
from experiments.timing import measure_bandwidth
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

WARM_UP = 3
"""Rounds that do not count: memory and caches settle."""

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


@dataclass(eq=False)
class Variant:
    """A network in one precision, compiled in one way.

    It says what `computes` in which type, or why it is `missing`. `facts` are the columns
    ``weights_mb``, ``psnr_db`` and ``truth_psnr_db``, `parts` the backbone, the decoder and the
    whole network, and `seconds` those of each stage, and of the whole, in each round.
    """

    label: str
    precision: str
    compiler: str
    computes: str = ""
    facts: dict[str, float] = field(default_factory=dict)
    parts: tuple = ()
    missing: str | None = None
    seconds: list[dict[str, float]] = field(default_factory=list)

    def go(self, raw: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """Refocus a raw image of an image size stage by stage, and in one go; keep the seconds.

        Returns
        -------
        tuple of two ndarrays of float32, shape (1, planes, h, w, 1)
        """
        backbone, decoder, network = self.parts
        clock = [time.perf_counter()]
        image = _resized(raw, size)
        clock.append(time.perf_counter())
        features = backbone.predict_on_batch(image)
        clock.append(time.perf_counter())
        staged = np.float32(decoder.predict_on_batch(features))
        clock.append(time.perf_counter())
        whole = np.float32(network.predict_on_batch(_resized(raw, size)))
        clock.append(time.perf_counter())
        self.seconds.append(dict(zip((*STAGES, WHOLE), np.diff(clock).tolist(), strict=True)))
        return staged, whole

    def predict(self, inputs: np.ndarray) -> np.ndarray:
        """Refocus inputs [n, h, w, 1] one by one: float32 [n, planes, h, w]."""
        stacks = [self.parts[-1].predict_on_batch(image[None]) for image in inputs]
        return np.float32(np.concatenate(stacks))[..., 0]


def _resized(raw: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    return area_average(raw, size)[None, ..., None]


def build_variants(subject: Subject, chosen: dict[str, bool]) -> Iterator[Variant]:
    """Build a network in each precision, compile it, and compare its images with float32's.

    What the platform cannot do is `missing`, with the reason.
    """
    reference = None
    for precision in PRECISIONS:
        network, reason = _attempt(in_precision, subject.network, precision)
        for compiler, xla in chosen.items():
            variant = Variant(subject.label, precision, compiler, missing=reason)
            if network is not None:
                variant.computes = describe(network, precision)
                variant.parts = tuple(
                    compiled(part, xla) for part in (*network.layers[1:], network)
                )
                stacks, variant.missing = _attempt(_finite, variant, subject.inputs)
            if variant.missing is None:
                reference = stacks if reference is None else reference
                variant.facts = _compared(subject, stacks, reference)
                variant.facts["weights_mb"] = weight_bytes(network) / 1e6
            yield variant


def _attempt(call: Callable, *args) -> tuple:
    """Give a result and None, or None and why there is no result, in a sentence."""
    try:
        return call(*args), None
    except MemoryError:
        raise
    except Exception as error:  # each library has kinds of its own for "not on this machine"
        return None, f"{type(error).__name__}: {str(error).strip().partition(chr(10))[0]}"


def _finite(variant: Variant, inputs: np.ndarray) -> np.ndarray:
    stacks = variant.predict(inputs)
    if not np.all(np.isfinite(stacks)):
        raise FloatingPointError("its images are not finite")
    return stacks


def _compared(subject: Subject, stacks: np.ndarray, reference: np.ndarray) -> dict:
    truths = subject.truths
    known = math.nan if truths is None else psnr(truths, stacks)
    return {"psnr_db": psnr(reference, stacks), "truth_psnr_db": known}


def measure_latency(networks: Sequence[str | Path], repeats: int = 30, seed: int = 0) -> dict:
    """Time trained networks stage by stage in all precisions, in 3 rounds or more that count.

    The seed is that of the raw images, and of the order in each round. Returns the record, in
    ``ways`` a row for each variant. An InputError says that a network cannot be used, or that the
    rounds are too few.
    """
    if repeats < 3:
        raise InputError(f"repeats must be 3 or more, for a median and its spread, got {repeats}.")
    started, chosen = time.perf_counter(), compilers()
    subjects = [open_subject(path, seed) for path in dict.fromkeys(networks)]
    variants, bandwidth = [], measure_bandwidth()
    steps = (
        step for subject in subjects for step in _measure(subject, chosen, repeats, seed, variants)
    )
    total = len(subjects) * (len(PRECISIONS) * len(chosen) + WARM_UP + repeats)
    for _ in step_bar(steps, total):
        pass
    raw_bytes = {subject.label: subject.raw.nbytes for subject in subjects}
    return {
        "networks": {subject.label: _described(subject) for subject in subjects},
        "repeats": repeats,
        "seed": seed,
        "backend": keras.backend.backend(),
        "bandwidth_gb_s": bandwidth / 1e9,
        "wall_s": time.perf_counter() - started,
        "ways": [summarise(one, raw_bytes[one.label], bandwidth) for one in variants],
    }


def _measure(subject: Subject, chosen, repeats: int, seed: int, variants: list) -> Iterator[None]:
    """Build all variants of a network, then time them in turn."""
    found = []
    for variant in build_variants(subject, chosen):
        found.append(variant)
        yield
    variants += found
    there = [variant for variant in found if variant.missing is None]
    rng = np.random.default_rng(seed)
    for number in range(WARM_UP + repeats):
        for k in rng.permutation(len(there)):
            if number == WARM_UP:
                there[k].seconds.clear()
            there[k].go(subject.raw, input_size(subject.card))
        yield
    for variant in found:
        variant.parts = ()  # networks that are done make room for the next


def columns(stage: str) -> tuple[str, str, str]:
    """Name the columns that hold median, lower and upper quartile of a stage."""
    return f"{stage}_ms", f"{stage}_q1_ms", f"{stage}_q3_ms"


def summarise(variant: Variant, raw_bytes: int, bandwidth: float) -> dict:
    """Make a row of the table: medians, quartiles, floor, and what it costs in images.

    In milliseconds, megabytes (1e6 bytes) and dB, for a bandwidth in bytes per second; NaN where
    the variant is missing.
    """
    row = {"network": variant.label, "precision": variant.precision, "compiler": variant.compiler}
    for stage in (*STAGES, WHOLE):
        ms = [1e3 * seconds[stage] for seconds in variant.seconds] or [math.nan]
        quartiles = np.percentile(ms, (50, 25, 75)).tolist()
        row |= dict(zip(columns(stage), quartiles, strict=True))
    weights_mb = variant.facts.get("weights_mb", math.nan)
    floor_ms = 1e3 * (1e6 * weights_mb + raw_bytes) / bandwidth
    return {
        **row,
        "floor_ms": floor_ms,
        "times_floor": row[f"{WHOLE}_ms"] / floor_ms,
        "weights_mb": weights_mb,
        "psnr_db": variant.facts.get("psnr_db", math.nan),
        "truth_psnr_db": variant.facts.get("truth_psnr_db", math.nan),
        "computes": variant.computes,
        "missing": variant.missing or "",
    }


def _described(subject: Subject) -> dict:
    card = subject.card
    return {
        "title": card.title,
        "preset": card.preset,
        "backbone_weights": card.backbone_weights,
        "sha256": card.sha256,
        "image": card.image,
        "planes": len(card.depths_mm),
        "camera": to_json(card.camera),
        "raw_pixels": subject.raw.shape,
        "raw_mb": subject.raw.nbytes / 1e6,
        "compared_on": subject.origin,
    }
