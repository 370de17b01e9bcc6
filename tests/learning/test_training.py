"""The paper's training, on twelve small light fields."""

import json
from dataclasses import replace

import keras
import numpy as np
import pandas as pd
import pytest
from builders import shapes, toml
from programs import run

from lf_flame import InputError
from lf_flame._common.config import build
from lf_flame.datasets.config import config_from_json
from lf_flame.datasets.making import make_dataset
from lf_flame.datasets.store import Dataset, split_indices
from lf_flame.learning import training
from lf_flame.learning.decoder import build_refocus_resnet50
from lf_flame.learning.imagenet_weights import ImagenetUnavailable
from lf_flame.learning.run_folders import open_run
from lf_flame.learning.training import compute_features, train
from lf_flame.learning.training_config import TrainingConfig

VALUES = {
    "title": "test",
    "seed": 1,
    "split": [0.5, 0.25, 0.25],
    "model": {"backbone_weights": "random", "backbone_depth": "none"},
    "presets": {"smoke": {"epochs": 4, "learning_rate": 1e-2}},
}


@pytest.fixture
def config():
    return build(TrainingConfig, VALUES, "here")


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Twelve small shape light fields with two planes."""
    path = tmp_path_factory.mktemp("data") / "shapes.zarr"
    make_dataset(config_from_json(shapes(12, (12, 20)), "here"), 12, path)
    return path


@pytest.mark.slow
def test_the_network_is_that_of_the_lowest_validation_loss_and_the_record_is_whole(
    config, data, tmp_path
):
    train(config, "smoke", data, tmp_path, minutes=1e-9)
    assert len(pd.read_csv(tmp_path / "history.csv")) == 1
    train(config, "smoke", data, tmp_path)
    history = pd.read_csv(tmp_path / "history.csv")
    assert history.val_loss.idxmin() < 3, history  # the last one would show nothing
    record = json.loads((tmp_path / "run.json").read_text())
    dataset, parts = Dataset(data), split_indices(12, config.split, config.seed)
    model = keras.saving.load_model(tmp_path / "model.keras", compile=False)
    held_out = dataset.inputs[parts["validation"]]
    stack = model.predict(held_out, verbose=0)[..., 0]
    loss = np.mean((stack - dataset.targets[parts["validation"]]) ** 2)
    assert loss == pytest.approx(history.val_loss.min(), rel=1e-4)
    assert {
        "preset", "seed", "epochs", "backbone_weights", "backbone_depth", "wall_s", "versions",
        "git_revision", "dataset", "recipe", "command", "test_indices",
    } <= record.keys()  # fmt: skip
    assert record["backbone_weights"] == "no backbone"
    _, indices, predictions = open_run(tmp_path).predict_test_split()
    np.testing.assert_array_equal(indices, parts["test"])
    assert predictions.shape == (3, 2, 12, 20)
    with pytest.raises(InputError, match="contains a run with another seed"):
        train(replace(config, seed=2), "smoke", data, tmp_path)
    recipe = replace(config.recipe("smoke"), checkpoint_s=9.0)  # which changes no result
    again = train(
        replace(config, title="other", presets={"smoke": recipe}), "smoke", data, tmp_path
    )
    assert again == tmp_path / "model.keras"


@pytest.mark.slow
def test_training_on_stored_features_is_training_the_whole_network(rng):
    """Losses of Keras's own steps through the frozen backbone, and on its features."""
    inputs = rng.uniform(size=(4, 32, 40, 1)).astype(np.float32)
    targets = rng.uniform(size=(4, 2, 8, 10, 1)).astype(np.float32)
    whole, parts = (
        build_refocus_resnet50(
            (8, 10), 2, backbone_weights="random", backbone_depth="conv3", dropout_place="none",
            seed=1, shown=(32, 40, 1),
        )
        for _ in range(2)
    )  # fmt: skip
    features, decoder = compute_features(parts, inputs), parts.get_layer("decoder")
    for network in (whole, decoder):
        network.compile(keras.optimizers.Adam(1e-3), "mse", run_eagerly=True)
    losses = [
        [float(network.train_on_batch(x[k], targets[k])) for k in (slice(0, 2), slice(2, 4))]
        for network, x in ((whole, inputs), (decoder, features))
    ]
    np.testing.assert_allclose(losses[1], losses[0], rtol=1e-5)


def test_features_of_many_samples_are_those_of_each(rng, monkeypatch):
    """More than the backbone processes together; without a backbone, the features are the image."""
    model = build_refocus_resnet50((10, 16), 1, backbone_depth="none")
    inputs = rng.uniform(size=(2 * training.FEATURE_BATCH + 3, 10, 16, 1)).astype(np.float32)
    np.testing.assert_array_equal(compute_features(model, inputs), inputs)
    monkeypatch.setenv("LF_FLAME_MEMORY_GB", "1e-6")
    with pytest.raises(InputError, match="features of 35 samples would need"):
        compute_features(model, inputs)


def test_without_imagenet_a_preset_continues_or_stops(config, data, tmp_path, monkeypatch, caplog):
    def offline():
        raise ImagenetUnavailable("no network.")

    monkeypatch.setattr(training, "imagenet_file", offline)
    model = replace(config.model, backbone_weights="imagenet", backbone_depth="conv3")
    config = replace(config, model=model)
    with pytest.raises(InputError, match="weights FILE .*weights random .*BACKBONE_WEIGHTS"):
        train(config, "smoke", data, tmp_path / "run")
    recipe = replace(config.recipe("smoke"), without_imagenet="random")
    asked = replace(config, presets={"smoke": recipe})
    assert training.find_weights(asked, "smoke") == ("random", "random (seed 1), conv3")
    assert "RANDOM backbone weights" in caplog.text


def test_train_without_data_finds_the_weights_alone(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "flames.toml").write_text(toml(VALUES))
    shown = run("train", "flames.toml", "--preset", "smoke")
    assert shown.output.splitlines()[-1] == "Weights of the backbone: no backbone."
    assert [path.name for path in tmp_path.iterdir()] == ["flames.toml"]
    refused = run("train", "flames.toml", "--preset", "smoke", "--out", "r")
    assert "--data and --out need each other" in str(refused.exception)
