import json
import shutil
from dataclasses import replace
from pathlib import Path

import keras
import numpy as np
import pandas as pd
import pytest
from builders import shapes

from lf_flame import InputError
from lf_flame._common.config import build
from lf_flame.datasets import fresh_scenes
from lf_flame.datasets.config import config_from_json
from lf_flame.datasets.fresh_scenes import fresh_samples
from lf_flame.datasets.making import make_dataset
from lf_flame.datasets.split import split_indices
from lf_flame.datasets.store import Dataset
from lf_flame.learning import feature_stream, training, training_run
from lf_flame.learning.imagenet_weights import ImagenetUnavailable
from lf_flame.learning.run_folders import predict_test_split
from lf_flame.learning.trainers import make_trainer
from lf_flame.learning.training import train
from lf_flame.learning.training_config import TrainingConfig, read_training_config


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Twelve small shape light fields with two planes."""
    path = tmp_path_factory.mktemp("data") / "shapes.zarr"
    make_dataset(config_from_json(shapes(12, (12, 20)), "here"), 12, path)
    return path


@pytest.fixture(scope="module")
def config():
    values = {
        "title": "test",
        "seed": 1,
        "split": [0.5, 0.25, 0.25],
        "model": {"backbone_weights": "random", "backbone_depth": "none"},
        "presets": {"smoke": {"epochs": 3, "batch_size": 2}},
    }
    return build(TrainingConfig, values, "here")


@pytest.fixture(scope="module")
def whole(config, data, tmp_path_factory):
    """A run that nothing cut."""
    folder = tmp_path_factory.mktemp("whole")
    train(config, "smoke", data, folder)
    return folder


def change_recipe(config, **changes):
    recipe = replace(config.recipe("smoke"), **changes)
    return replace(config, presets={"smoke": recipe})


@pytest.mark.slow
def test_a_run_in_pieces_is_the_whole_run(config, data, whole, tmp_path, monkeypatch):
    """One epoch, then two more: ended by the minute, and cut."""
    run_epoch, out = training_run._run_epoch, tmp_path / "pieces"

    def cut_in_epoch_3(trainer, seed, epoch):
        if epoch == 3:
            raise KeyboardInterrupt
        return run_epoch(trainer, seed, epoch)

    def go_on(epochs, done, **options):
        train(config.with_epochs("smoke", epochs), "smoke", data, out, **options)
        record = json.loads((out / "run.json").read_text())
        assert (record["epochs"], record["finished"]) == (done, done == epochs)
        assert record["best_epoch"] <= done
        history = pd.read_csv(out / "history.csv")
        assert list(history.epoch) == list(range(done + 1))
        return record, history

    _, first = go_on(1, 1)
    _, second = go_on(3, 2, minutes=1e-9)
    assert list(second.seconds[:2]) == list(first.seconds)  # it went on, and did not begin again
    (out / "model.keras").unlink()
    monkeypatch.setattr(training_run, "_run_epoch", cut_in_epoch_3)
    with pytest.raises(KeyboardInterrupt):
        go_on(3, 3)
    monkeypatch.undo()
    assert not (out / "model.keras").exists()
    assert list(pd.read_csv(out / "history.csv").epoch) == [0, 1, 2]
    record, last = go_on(3, 3)
    assert list(go_on(3, 3)[1].seconds) == list(last.seconds)  # what is finished stays
    uncut = pd.read_csv(whole / "history.csv")[["epoch", "loss", "val_loss"]]
    np.testing.assert_allclose(last[["epoch", "loss", "val_loss"]], uncut, rtol=1e-5)
    assert record["recipe"] == json.loads((whole / "run.json").read_text())["recipe"]
    predictions = [predict_test_split(run)[2] for run in (whole, out)]
    np.testing.assert_allclose(predictions[1], predictions[0], atol=1e-5)
    with pytest.raises(InputError, match="holds a run with another recipe"):  # not for fewer
        go_on(2, 2)
    with pytest.raises(InputError, match="minutes must be 0"):
        go_on(3, 3, minutes=-1.0)


@pytest.mark.slow
def test_the_best_weights_are_kept_and_the_record_is_whole(config, data, tmp_path):
    config = change_recipe(config, epochs=4, learning_rate=3e-2)  # too large: it gets worse again
    train(config, "smoke", data, tmp_path)
    history = pd.read_csv(tmp_path / "history.csv")
    record = json.loads((tmp_path / "run.json").read_text())
    assert record["best_epoch"] == history.val_loss.idxmin()
    assert record["best_validation_loss"] == pytest.approx(history.val_loss.min(), rel=1e-6)
    dataset = training.Dataset(data)
    parts = split_indices(12, config.split, config.seed)
    model = keras.saving.load_model(tmp_path / "model.keras", compile=False)
    inputs = dataset.inputs[parts["validation"]]
    loss = np.mean(
        (model.predict(inputs, verbose=0)[..., 0] - dataset.targets[parts["validation"]]) ** 2
    )
    assert loss == pytest.approx(history.val_loss.min(), rel=1e-3)
    expected = {"preset", "seed", "epochs", "backbone_weights", "backbone_depth", "wall_s"}
    assert set(record) >= expected | {
        "versions",
        "git_revision",
        "dataset",
        "recipe",
        "command",
    }
    assert record["backbone_weights"] == "no backbone"


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        {"warm_start": True, "dropout_place": "none"},
        {"schedule": "cosine", "dropout_place": "vector", "checkpoint_s": 1000.0},
    ],
)
def test_one_epoch_on_every_presets_code_path(config, data, tmp_path, changes):
    train(change_recipe(config, epochs=1, **changes), "smoke", data, tmp_path)
    assert (tmp_path / "model.keras").exists()


@pytest.mark.slow
def test_without_epochs_the_start_is_the_network(config, data, tmp_path):
    """A run of none may go on for some, from where it stands."""
    start = {"warm_start": True, "neck": "positions", "refinements": 1, "bands": 2}
    rest = {"dropout_place": "none", "learning_rate": 1e-7}
    for epochs in (0, 1):
        asked = change_recipe(config, epochs=epochs, **start, **rest)
        train(asked, "smoke", data, tmp_path)
        history = pd.read_csv(tmp_path / "history.csv")
        assert list(history.epoch) == list(range(epochs + 1))
    record = json.loads((tmp_path / "run.json").read_text())
    best = history.val_loss.min()
    assert record["best_validation_loss"] == pytest.approx(best, rel=1e-6)
    losses = history.val_loss
    assert losses[1] == pytest.approx(losses[0], rel=0.01)  # no second beginning


@pytest.mark.slow
def test_fresh_scenes_are_learnt_from_beside_the_stored_ones_and_never_scored(
    config, data, finished, tmp_path, monkeypatch
):
    """The network sees the training part and the fresh ones; the rest of the split is as before."""
    learnt = []

    def remember(*asked):
        learnt.append({part: [x.copy() for x in pair] for part, pair in asked[3].items()})
        return make_trainer(*asked)

    monkeypatch.setattr(training, "make_trainer", remember)
    monkeypatch.setattr(feature_stream, "REMEMBERED", 2)  # epochs need them all
    monkeypatch.setattr(fresh_scenes, "cpu_count", lambda: 1)  # processes take seconds to start
    train(change_recipe(config, epochs=1, fresh_scenes=3), "smoke", data, tmp_path)
    record, before = (json.loads((run / "run.json").read_text()) for run in (tmp_path, finished))
    assert record["parts"] == before["parts"] | {"train": before["parts"]["train"] + 3}
    assert record["test_indices"] == before["test_indices"]
    dataset, parts = Dataset(data), split_indices(12, config.split, config.seed)
    (found,) = learnt
    stored = {part: dataset.targets[parts[part]] for part in found}
    np.testing.assert_array_equal(found["validation"][1][..., 0], stored["validation"])
    ((_, targets),) = fresh_samples(dataset, 3, workers=1)
    np.testing.assert_array_equal(
        found["train"][1][..., 0], np.concatenate([stored["train"], targets])
    )
    assert len(found["train"][0]) == len(found["train"][1])


@pytest.mark.slow
def test_a_changed_configuration_is_refused(config, data, run):
    before = (run / "model.keras").read_bytes()
    for changes in ({"epochs": 1, "batch_size": 3}, {"epochs": 2, "schedule": "cosine"}):
        with pytest.raises(InputError, match="holds a run with another recipe"):
            train(change_recipe(config, **changes), "smoke", data, run)
    assert (run / "model.keras").read_bytes() == before


def again(config, data, out):
    """Go on with a run whose network is gone, so that its checkpoint is read."""
    (out / "model.keras").unlink(missing_ok=True)
    return train(change_recipe(config, epochs=1), "smoke", data, out)


@pytest.fixture(scope="module")
def finished(config, data, tmp_path_factory):
    out = tmp_path_factory.mktemp("finished")
    train(change_recipe(config, epochs=1), "smoke", data, out)
    return out


@pytest.fixture
def run(finished, tmp_path):
    return Path(shutil.copytree(finished, tmp_path / "run"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "damage"),
    [
        ("state.npz", b"PK\3\4 and then nothing"),
        ("best.npz", None),
        ("history.json", b""),
        ("manifest.json", None),
    ],
)
def test_a_damaged_checkpoint_is_named(config, data, run, name, damage):
    file = next(run.glob("checkpoint-*")) / name
    file.unlink() if damage is None else file.write_bytes(damage)
    with pytest.raises(
        InputError, match=f"checkpoint-000001/{name} (cannot be read|is not a JSON file)"
    ):
        again(config, data, run)


@pytest.mark.slow
def test_a_history_that_lost_its_end_is_no_start(config, data, run):
    checkpoint = next(run.glob("checkpoint-*"))
    history = json.loads((checkpoint / "history.json").read_text())
    (checkpoint / "history.json").write_text(json.dumps({"epochs": history["epochs"][:0]}))
    with pytest.raises(
        InputError, match="checkpoint-000001 is damaged: its history ends elsewhere"
    ):
        again(config, data, run)


@pytest.mark.slow
def test_a_checkpoint_of_another_run_is_refused(config, data, run):
    (run / "config.json").unlink()
    with pytest.raises(InputError, match=r"belongs to a run with another seed \(1, now 2\)"):
        again(replace(config, seed=2), data, run)
    assert not (run / "config.json").exists()  # which would speak for the other run


@pytest.mark.slow
def test_a_run_of_an_older_version_is_known(config, data, run):
    """Its records hold hashes, and not the number of samples."""
    for path in (
        run / "run.json",
        run / "config.json",
        next(run.glob("checkpoint-*/manifest.json")),
    ):
        record = json.loads(path.read_text())
        changed = record.get("run", record)
        del changed["samples"]
        record |= {"sha256": {}, "model_sha256": "0", "data_sha256": "1", "record_sha256": "2"}
        path.write_text(json.dumps(record))
    before = (run / "model.keras").stat().st_ino
    train(change_recipe(config, epochs=1), "smoke", data, run)
    assert (run / "model.keras").stat().st_ino == before  # it is finished
    again(config, data, run)


@pytest.mark.slow
@pytest.mark.parametrize("keep", [0, 1000])
def test_a_network_that_was_cut_off_is_written_again(config, data, run, keep):
    shutil.copy(run / "model.keras", run.parent / "whole.keras")
    (run / "model.keras").write_bytes((run / "model.keras").read_bytes()[:keep])
    model = train(change_recipe(config, epochs=1), "smoke", data, run)
    networks = [
        keras.saving.load_model(path, compile=False) for path in (model, run.parent / "whole.keras")
    ]
    for one, other in zip(*(network.get_weights() for network in networks), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.slow
def test_a_loss_that_is_no_number_stops_the_run(config, data, tmp_path):
    config = change_recipe(config, learning_rate=1e38)
    with pytest.raises(InputError, match="no longer a number in epoch 1"):
        train(config, "smoke", data, tmp_path)


def test_without_imagenet_a_preset_goes_on_or_stops(config, data, tmp_path, monkeypatch, caplog):
    def offline():
        raise ImagenetUnavailable("no network.")

    monkeypatch.setattr(training, "imagenet_file", offline)
    model = replace(config.model, backbone_weights="imagenet", backbone_depth="conv3")
    config = replace(config, model=model)
    with pytest.raises(InputError, match="weights FILE .*weights random .*BACKBONE_WEIGHTS"):
        train(config, "smoke", data, tmp_path / "run")
    asked = change_recipe(config, without_imagenet="random")
    assert training.find_backbone(asked, "smoke") == "random (seed 1), conv3"
    assert "RANDOM backbone weights" in caplog.text


def test_a_recipe_may_cut_the_backbone_elsewhere_and_the_command_comes_first(tmp_path):
    path = tmp_path / "config.toml"
    path.write_text(
        'title = "t"\nseed = 1\n[model]\nbackbone_depth = "conv5"\n[presets.a]\nepochs = 1\n'
        '[presets.b]\nepochs = 1\nbackbone_depth = "conv4"\n'
    )
    asked = read_training_config(path)
    assert [asked.with_recipe(x).model.backbone_depth for x in "ab"] == ["conv5", "conv4"]
    asked = read_training_config(path, backbone_depth="conv5")
    assert [asked.with_recipe(x).model.backbone_depth for x in "ab"] == ["conv5", "conv5"]


def test_split_is_whole_disjoint_and_seeded():
    parts = split_indices(200, (0.8, 0.1, 0.1), 1)
    assert [len(part) for part in parts.values()] == [160, 20, 20]
    assert sorted(np.concatenate(list(parts.values()))) == list(range(200))
    assert not np.array_equal(parts["test"], split_indices(200, (0.8, 0.1, 0.1), 2)["test"])
