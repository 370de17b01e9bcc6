"""`python -m experiments latency`: the network itself is timed, in the precision that is said."""

import json
import math
from pathlib import Path
from types import SimpleNamespace

import keras
import numpy as np
import pandas as pd
import pytest
from builders import shapes
from click.testing import CliRunner

from experiments.__main__ import commands
from experiments._kernels import sum_rows
from experiments.costs import latency, latency_report
from experiments.costs.precision import (
    compiled,
    compilers,
    describe,
    in_precision,
    quantised_layers,
    weight_bytes,
)
from lf_flame import InputError
from lf_flame._common.arrays import area_average
from lf_flame._common.config import build
from lf_flame.datasets.config import config_from_json
from lf_flame.datasets.making import make_dataset
from lf_flame.learning.model_card import export_network, load_network, read_card
from lf_flame.learning.scores import psnr
from lf_flame.learning.training import train
from lf_flame.learning.training_config import TrainingConfig

pytestmark = pytest.mark.slow

SIZE, VIEWS = (16, 32), 3

DATA = shapes(10, SIZE, VIEWS, sides_mm=(9.0, 9.0), off_axis_mm=8.0)

TRAINING = {
    "title": "Test images",
    "seed": 1,
    "split": [0.6, 0.2, 0.2],
    "model": {"backbone_depth": "none"},
    "presets": {"smoke": {"epochs": 1}},
}

PLAIN = {"TensorFlow": False}


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    make_dataset(config_from_json(DATA, "here"), 10, folder / "shapes.zarr")
    config = build(TrainingConfig, TRAINING, "here")
    train(config, "smoke", folder / "shapes.zarr", folder / "shapes")
    return folder / "shapes"


@pytest.fixture(scope="module")
def subject(run_folder):
    return latency.open_subject(run_folder)


@pytest.fixture(scope="module")
def results(run_folder, tmp_path_factory):
    """Folder and record of a measurement in which a precision cannot be had."""
    out, made = tmp_path_factory.mktemp("out"), latency.in_precision

    def without_half(network, precision):
        if precision == "float16":
            raise NotImplementedError("No arithmetic in 16 bits.\nTraceback ...")
        return made(network, precision)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(latency, "in_precision", without_half)
        patch.setattr(latency, "PRECISIONS", ("float32", "float16", "int8"))
        patch.setattr(latency, "compilers", lambda: PLAIN)
        shown = run("latency", run_folder, "--out", out, "--repeats", 3).stdout
    assert (out / "latency.md").read_text() in shown
    return out, json.loads((out / "latency.json").read_text())


def run(*args):
    """Run the command in this process; what users may do wrong raises InputError here."""
    result = CliRunner().invoke(commands, [*map(str, args)])
    if result.exception is not None:
        raise result.exception
    return result


def parts_of(network):
    return [layer for part in network.layers[1:] for layer in _leaves(part)]


def _leaves(part):
    return (
        [x for layer in part.layers for x in _leaves(layer)] if hasattr(part, "layers") else [part]
    )


def test_stages_and_whole_are_what_the_network_predicts(run_folder, subject):
    """From a raw image whose micro-images have their own mean each."""
    assert subject.raw.shape == (SIZE[0] * VIEWS, SIZE[1] * VIEWS)
    assert subject.raw.dtype == np.float32
    assert 0 <= subject.raw.min() < 0.01 < 0.99 < subject.raw.max() <= 1
    image = area_average(subject.raw, SIZE)
    np.testing.assert_allclose(image[2, 5], subject.raw[6:9, 15:18].mean(), rtol=1e-6)
    expected = load_network(run_folder, read_card(run_folder)).predict(
        image[None, ..., None], verbose=0
    )
    _, parts = next(latency.build_variants(subject, PLAIN))
    calls = latency.stages(parts, subject.raw, SIZE)
    assert list(calls) == ["resize", "backbone", "decoder", "whole"]
    for stage in ("decoder", "whole"):
        np.testing.assert_allclose(calls[stage](), expected, atol=1e-6)
    np.testing.assert_allclose(calls["backbone"](), parts[0].predict_on_batch(calls["resize"]()))


def test_compilers_agree(subject, rng):
    decoder = subject.network.get_layer("decoder")
    features = rng.random((1, *decoder.input_shape[1:]), np.float32)
    plain, xla = (compiled(decoder, jit) for jit in (False, True))
    assert (plain.jit_compile, xla.jit_compile) == (False, True)
    stacks = [model.predict_on_batch(features) for model in (plain, xla)]
    np.testing.assert_allclose(*stacks, atol=1e-5)
    assert set(compilers()) == {"TensorFlow", "XLA"}


def test_every_layer_computes_in_the_precision_that_is_said(subject):
    precision = "float16"
    network = in_precision(subject.network, precision)
    features = network.get_layer("backbone").predict_on_batch(subject.inputs[:1])
    assert str(features.dtype) == precision
    halves = 0
    for layer in parts_of(network):
        if not isinstance(layer, keras.layers.InputLayer):
            assert layer.compute_dtype == precision, layer.name
        kept = "float32" if isinstance(layer, keras.layers.BatchNormalization) else precision
        for weight in layer.weights:
            assert weight.dtype == kept, weight.path
            halves += weight.dtype == precision
    assert halves == 8  # kernels and biases of three convolutions and of the dense layer
    assert parts_of(subject.network)[5].compute_dtype == "float32"  # the reference stays as it is
    ratio = weight_bytes(network) / weight_bytes(subject.network)
    assert 0.5 < ratio < 0.51


def test_variances_beyond_the_range_of_float16_do_no_harm(subject):
    """Kept in float16 they would be infinite, and their channels dead."""
    network = in_precision(subject.network, "float32")
    kept = network.get_weights()
    norm = next(x for x in parts_of(network) if isinstance(x, keras.layers.BatchNormalization))
    try:
        norm.moving_variance.assign(np.full(norm.moving_variance.shape, 1e5))
        half = in_precision(network, "float16")
        twin = next(x for x in parts_of(half) if x.name == norm.name)
        np.testing.assert_array_equal(twin.moving_variance, norm.moving_variance)
    finally:
        network.set_weights(kept)


def test_int8_are_the_dense_layers(subject):
    network = in_precision(subject.network, "int8")
    assert quantised_layers(network) == ["basis"]
    assert describe(network, "int8") == "dense layers alone (basis), all else float32"
    basis = network.get_layer("decoder").get_layer("basis")
    assert basis._kernel.dtype == "int8"
    saved = weight_bytes(subject.network) - weight_bytes(network)  # 3 of 4 bytes, less scales
    assert saved == pytest.approx(3 * 256 * 2 * math.prod(SIZE), rel=0.02)
    assert quantised_layers(subject.network) == []


def test_a_network_without_dense_layers_has_no_int8():
    image = keras.Input((8, 8, 1))
    network = keras.Model(image, keras.layers.Conv2D(2, 3)(image))
    with pytest.raises(ValueError, match="no dense layer"):
        in_precision(network, "int8")


def test_fewer_bits_change_the_images_a_little(subject, results):
    """The distances that are printed, against what a network predicts by itself."""
    rows = {row["precision"]: row for row in results[1]["ways"]}
    assert rows["float32"]["psnr_db"] is None  # infinite: the same
    assert 35 < rows["int8"]["psnr_db"] < 110
    network = in_precision(subject.network, "int8")
    stack = np.float32(network.predict(subject.inputs, verbose=0))
    reference = subject.network.predict(subject.inputs, verbose=0)
    assert rows["int8"]["psnr_db"] == pytest.approx(psnr(reference, stack), abs=0.5)
    found = psnr(subject.truths, stack[..., 0])
    assert rows["int8"]["truth_psnr_db"] == pytest.approx(found, abs=0.05)


def test_what_cannot_be_had_is_missing_with_the_reason(results):
    out, record = results
    row = next(row for row in record["ways"] if row["precision"] == "float16")
    assert row["missing"] == "NotImplementedError: No arithmetic in 16 bits."
    assert row["whole_ms"] is row["weights_mb"] is row["psnr_db"] is None
    said = (out / "latency.md").read_text()
    assert "float16 is missing: NotImplementedError: No arithmetic in 16 bits." in said


def test_images_that_are_not_finite_are_missing(subject, monkeypatch):
    images = np.full((1, 2, 4, 5, 1), [[[[0.5], [np.nan], [0], [0], [0]]]])
    blind = SimpleNamespace(predict_on_batch=lambda inputs: images)
    monkeypatch.setattr(latency, "compiled", lambda part, xla: blind)
    row, parts = next(latency.build_variants(subject, PLAIN))
    assert row["missing"] == "FloatingPointError: its images are not finite"
    assert parts == ()


def test_records_are_complete(run_folder, results):
    out, record = results
    assert sorted(path.name for path in out.iterdir()) == [
        f"latency.{ending}" for ending in ("csv", "json", "md", "png")
    ]
    assert {"command", "git_revision", "machine", "versions", "bandwidth_gb_s", "seed"} <= set(
        record
    )
    network = record["networks"][str(run_folder)]
    assert network["raw_pixels"] == [SIZE[0] * VIEWS, SIZE[1] * VIEWS]
    assert "2 test inputs of" in network["compared_on"]
    table = pd.read_csv(out / "latency.csv")
    assert list(table["precision"]) == ["float32", "float16", "int8"]
    done = table[table["missing"].isna()]
    assert len(done) == 2
    for stage in ("resize", "backbone", "decoder", "whole"):
        middle, low, high = (done[name] for name in latency.columns(stage))
        assert ((low > 0) & (low <= middle) & (middle <= high)).all()
    raw_mb = 4 * math.prod(SIZE) * VIEWS**2 / 1e6
    floor_ms = (done["weights_mb"] + raw_mb) / record["bandwidth_gb_s"]
    np.testing.assert_allclose(done["floor_ms"], floor_ms)
    np.testing.assert_allclose(done["times_floor"], done["whole_ms"] / floor_ms)


def test_the_text_says_where_the_time_goes(results):
    said = (results[0] / "latency.md").read_text()
    assert "| int8 (dense layers)" in said
    assert "- int8: dense layers alone (basis), all else float32." in said
    assert "times its floor of" in said
    assert "dB to float32, which moves that against the truth by" in said
    assert "nan" not in said
    assert (results[0] / "latency.png").stat().st_size > 10_000


def test_of_two_compilers_the_faster_is_drawn():
    rows = pd.DataFrame(
        {
            "precision": ["float32", "float32", "int8", "int8"],
            "compiler": ["a", "b", "a", "b"],
            "whole_ms": [3.0, 2.0, np.nan, 4.0],
        }
    )
    assert list(latency_report.fastest(rows)["compiler"]) == ["b", "b"]


def test_exported_networks_are_shown_the_raw_image(run_folder, tmp_path):
    path = tmp_path / "network.keras"
    export_network(run_folder, path)
    subject = latency.open_subject(path)
    assert subject.truths is None
    np.testing.assert_array_equal(subject.inputs[0, ..., 0], area_average(subject.raw, SIZE))
    assert subject.origin.startswith("the random raw image")


def test_rows_are_summed(rng):
    rows = rng.random((3, 200), np.float32)
    sums = np.empty(3, np.float32)
    sum_rows(rows, sums)
    np.testing.assert_allclose(sums, rows.sum(axis=1), rtol=1e-5)


@pytest.mark.parametrize(
    ("network", "options", "message"),
    [
        ("none.keras", [], "There is no trained network .*none.keras"),
        (".", [], "There is no finished run in"),
        (None, ["--repeats", 2], "repeats must be 3 or more.*got 2"),
    ],
)
def test_bad_input_is_one_sentence(run_folder, tmp_path, network, options, message):
    given = run_folder if network is None else tmp_path / network
    with pytest.raises(InputError, match=message) as caught:
        run("latency", given, "--out", tmp_path / "out", *options)
    assert len(str(caught.value).splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_other_networks_are_one_sentence():
    image = keras.Input((8, 8, 1))
    network = keras.Model(image, keras.layers.Conv2D(2, 3, name="single")(image))
    with pytest.raises(InputError, match="is made of single; it must be a backbone and a decoder"):
        latency.check_parts(network, Path("theirs.keras"))
