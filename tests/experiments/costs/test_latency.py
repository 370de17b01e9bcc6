"""`python -m experiments latency`: the network itself is timed, in the precision that is said."""

import json
import math

import keras
import numpy as np
import pandas as pd
import pytest
from builders import shapes
from click.testing import CliRunner

from experiments.__main__ import commands
from experiments.costs.latency import STAGES, WHOLE, columns, in_precision, stage_calls
from lf_flame import InputError
from lf_flame._common.arrays import area_average
from lf_flame._common.config import build
from lf_flame.datasets.config import config_from_json
from lf_flame.datasets.making import make_dataset
from lf_flame.learning.run_folders import open_run
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


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    make_dataset(config_from_json(DATA, "here"), 10, folder / "shapes.zarr")
    config = build(TrainingConfig, TRAINING, "here")
    train(config, "smoke", folder / "shapes.zarr", folder / "shapes")
    return folder / "shapes"


@pytest.fixture(scope="module")
def network(folder):
    return open_run(folder).load_network()


def call(*words):
    """Run the command in this process; what users may do wrong raises InputError here."""
    result = CliRunner().invoke(commands, ["latency", *map(str, words)])
    if result.exception is not None:
        raise result.exception
    return result.stdout


def leaves(part):
    parts = getattr(part, "layers", [part])
    return [part] if parts == [part] else [leaf for layer in parts for leaf in leaves(layer)]


def test_stages_and_whole_are_what_the_network_predicts(network, rng):
    """From a raw image whose micro-images have their own mean each."""
    raw = rng.random((SIZE[0] * VIEWS, SIZE[1] * VIEWS), np.float32)
    image = area_average(raw, SIZE)
    np.testing.assert_allclose(image[2, 5], raw[6:9, 15:18].mean(), rtol=1e-6)
    expected = network.predict(image[None, ..., None], verbose=0)
    resize, backbone, decoder, whole = stage_calls(in_precision(network, "float32"), raw, SIZE)
    for made in (decoder(), whole()):
        np.testing.assert_allclose(made, expected, atol=1e-5)
    features = network.get_layer("backbone").predict_on_batch(resize())
    np.testing.assert_allclose(backbone(), features, atol=1e-5)


def test_every_layer_computes_in_16_bits_but_keeps_variances(network):
    """Kept in float16, variances above 65,504 would be infinite, and their channels dead."""
    half = in_precision(network, "float16")
    count = 0
    for layer in leaves(half):
        if isinstance(layer, keras.layers.InputLayer):
            continue
        assert layer.compute_dtype == "float16", layer.name
        kept = "float32" if isinstance(layer, keras.layers.BatchNormalization) else "float16"
        for weight in layer.weights:
            assert weight.dtype == kept, weight.path
            count += weight.dtype == "float16"
    assert count == 8  # kernels and biases of three convolutions and of the dense layer
    assert leaves(network)[-1].compute_dtype == "float32"  # the reference stays as it is


def test_the_report_is_complete_and_its_numbers_agree(folder, network, tmp_path):
    shown = call(folder, "--out", tmp_path, "--repeats", 3)
    assert (tmp_path / "latency.md").read_text() in shown
    files = {f"latency.{ending}" for ending in ("csv", "json", "md", "png")}
    assert {path.name for path in tmp_path.iterdir()} == files
    record = json.loads((tmp_path / "latency.json").read_text())
    assert "PSNR on 2 test images" in record["networks"][str(folder)]
    table = pd.read_csv(tmp_path / "latency.csv")
    assert list(table["precision"]) == ["float32", "bfloat16", "float16"]
    for stage in (*STAGES, WHOLE):
        middle, low, high = (table[name] for name in columns(stage))
        assert ((low > 0) & (low <= middle) & (middle <= high)).all()
    raw_mb = 4 * math.prod(SIZE) * VIEWS**2 / 1e6
    floor_ms = (table["weights_mb"] + raw_mb) / record["bandwidth_gb_s"]
    np.testing.assert_allclose(table["floor_ms"], floor_ms)
    assert np.isinf(table["psnr_db"][0])  # the same
    assert (table["psnr_db"][1:] > 35).all()
    data, indices = open_run(folder).open_dataset(), open_run(folder).record["test_indices"]
    images = network.predict(data.inputs[indices], verbose=0)[..., 0]
    found = psnr(data.targets[indices], images)
    np.testing.assert_allclose(table["truth_psnr_db"], found, atol=0.1)
    assert "nan" not in shown


@pytest.mark.parametrize(
    ("run", "repeats", "message"),
    [(".", 3, "There is no finished run in"), (None, 2, "repeats must be 3 or more.*got 2")],
)
def test_bad_input_is_one_sentence(folder, tmp_path, run, repeats, message):
    given = folder if run is None else tmp_path / run
    with pytest.raises(InputError, match=message) as caught:
        call(given, "--out", tmp_path / "out", "--repeats", repeats)
    assert len(str(caught.value).splitlines()) == 1
    assert not (tmp_path / "out").exists()
