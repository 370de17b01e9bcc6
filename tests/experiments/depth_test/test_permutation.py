"""The depth permutation test: its scenes, its measure, and what it says of networks."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from builders import shapes
from click.testing import CliRunner
from programs import without_graphs

from experiments.__main__ import commands
from experiments.depth_test.permutation import run_depth_test, share_memorised
from experiments.inputs import draw_scenario, make_scenarios
from experiments.linear import RIDGE, Ridge
from experiments.systems.compared import resnet_entry
from lf_flame import InputError, render
from lf_flame._common.config import build
from lf_flame.datasets.config import config_from_json, read_config
from lf_flame.datasets.encodings import InputEncoding
from lf_flame.datasets.making import make_dataset
from lf_flame.datasets.sampling import render_sample
from lf_flame.datasets.store import split_indices
from lf_flame.learning.run_folders import open_run
from lf_flame.learning.scores import score
from lf_flame.learning.training import train
from lf_flame.learning.training_config import TrainingConfig
from lf_flame.systems.formulas import ShiftAndSum
from lf_flame.systems.resnet50 import ResNet50

DATA = shapes(24, (20, 32), sides_mm=(9, 9), off_axis_mm=12.0)
DATA["camera"] |= {"lenslet_focal_mm": 4.0, "lenslet_pitch_mm": 1.12}
DATA["template"] |= {"position_mm": 0.4, "size": 0.08, "brightness": [0.85, 1.0]}
for thing, depth in zip(DATA["template"]["objects"], (40.0, -40.0), strict=True):
    thing["depth_mm"] = depth
TRAINING = {
    "title": "test", "seed": 1, "split": [0.75, 0.125, 0.125],
    "model": {"backbone_weights": "random", "backbone_depth": "none"},
    "presets": {"smoke": {"epochs": 1}},
}  # fmt: skip


@pytest.fixture(scope="module")
def config():
    return config_from_json(DATA, "here")


@pytest.fixture(scope="module")
def run_folder(config, tmp_path_factory):
    """A small network, shown three views; beside it the raw images of the same scenes."""
    folder = tmp_path_factory.mktemp("runs")
    for kind in ("raw", "views"):
        make_dataset(replace(config, input=InputEncoding(kind)), 24, folder / f"{kind}.zarr")
    training = build(TrainingConfig, TRAINING, "here")
    with without_graphs():
        train(training, "smoke", folder / "views.zarr", folder / "views")
    return folder / "views"


def test_a_run_refocuses_light_fields_as_it_does_its_own_samples(run_folder):
    system, dataset = ResNet50.of_run(run_folder), open_run(run_folder).open_dataset()
    views = render_sample(dataset.config, 3)[0].views
    stack = system.refocus(views, system.slopes, dataset.config.block)
    expected = system.model.predict(dataset.inputs[3:4], verbose=0)[0, ..., 0]
    np.testing.assert_allclose(stack, np.clip(expected, 0, 1), atol=1e-5)
    backwards = system.refocus(views, system.slopes[::-1], dataset.config.block)
    np.testing.assert_array_equal(backwards, stack[::-1])


def test_a_run_of_the_papers_network_is_entered_with_its_training(run_folder):
    found = resnet_entry(run_folder)
    assert found.name == "no backbone, 1 epochs, views"
    assert len(found.load().view_indices(5, 5)) == 3


def test_objects_look_the_same_from_the_middle_wherever_they_stand(config):
    scene, _ = config.template.draw(None)
    before = render(scene, config.camera).views
    for scenario in make_scenarios(config)[1:3]:
        placed = scenario.place(scene, config)
        assert [layer.depth_mm for layer in placed.layers] == list(scenario.depths_mm)
        after = render(placed, config.camera).views
        middle, corner = (np.abs(after[k, k] - before[k, k]).mean() for k in (2, 0))
        assert middle < 0.3 * corner  # defocus within a view is all that differs in the middle


def test_scenarios_exchange_move_and_leave_out(config):
    own, turned, moved, alone = make_scenarios(config)
    assert own.depths_mm == (40.0, -40.0)
    assert turned.depths_mm == (-40.0, 40.0)
    assert moved.depths_mm == (0.0, -80.0)
    assert alone.present == (0,)
    four = make_scenarios(read_config(Path(__file__).parents[3] / "data_gen" / "flames.toml"))
    assert [scenario.depths_mm for scenario in four[:3]] == [
        (20.0, 10.0, 0.0, -10.0),
        (-10.0, 10.0, 0.0, 20.0),
        (-10.0, 0.0, 10.0, 20.0),
    ]
    assert [scenario.name for scenario in four[3:]] == ["all 5 mm nearer", "flame 1 alone"]


def test_the_share_memorised_lies_between_both_references(rng):
    reference, trained, noise = rng.uniform(size=(3, 2, 2, 8, 8))
    for share in (0, 0.25, 1):
        predicted = (1 - share) * reference + share * trained
        assert share_memorised(predicted, reference, trained) == pytest.approx(share)
    assert np.isnan(share_memorised(noise, reference, reference))


def test_what_has_memorised_its_scenes_is_found_out(run_folder, tmp_path):
    """The ridge regression has; each score is that of images which are drawn here, one by one."""
    raw = run_folder.with_name("raw.zarr")  # a data set alone will do
    result = CliRunner().invoke(
        commands,
        ["depth-test", str(run_folder), str(raw), "--out", str(tmp_path), "--samples", "3"],
    )
    assert result.exit_code == 0, result.output
    table = pd.read_csv(tmp_path / "depth_test.csv")
    means = table.set_index(["scenario", "system"])
    network = f"{run_folder}: input views, fixed depths; no backbone, 1 epochs"
    linear = f"{RIDGE}: input views, fixed depths"
    assert set(table.system) == {
        "shift-and-sum of 3 views", "shift-and-sum of 9 views", network, linear,
        f"{RIDGE}: input raw, fixed depths",
    }  # fmt: skip
    rows = means.xs(linear, level="system")
    assert rows.psnr_db["as trained"] > rows.psnr_db["first and last exchanged"] + 5
    assert rows.share_memorised["first and last exchanged"] > 0.7
    assert rows.share_memorised[["as trained"]].isna().all()
    views = means.xs("shift-and-sum of 9 views", level="system")
    assert views.share_memorised.dropna().abs().max() < 0.2
    assert (views.psnr_db > 25).all()
    found = open_run(run_folder)
    exchanged = make_scenarios(found.config)[1]
    dataset = found.open_dataset()
    ridge = Ridge(dataset, split_indices(len(dataset), (0.75, 0.125, 0.125), 1))
    reference, *drawn = zip(*[
        (ShiftAndSum().refocus(field, found.slopes, found.config.block),
         ResNet50.of_run(run_folder).refocus(field, found.slopes, found.config.block),
         ridge.predict(dataset.config.encode(field)[None])[0])
        for field in draw_scenario(found.config, exchanged, 3)
    ], strict=True)  # fmt: skip
    for name, images in zip((network, linear), drawn, strict=True):
        expected = score(np.array(reference), np.array(images))
        rows = table[(table.system == name) & (table.scenario == exchanged.name)]
        np.testing.assert_allclose(rows.psnr_db, expected.psnr_db.mean(), atol=1e-3)
    record = json.loads((tmp_path / "depth_test.json").read_text())
    assert list(record["runs"]) == [network]
    assert "first and last exchanged" in result.output


def test_what_cannot_be_tested_is_one_sentence(run_folder, tmp_path):
    shutil.copytree(run_folder, tmp_path / "other", ignore=shutil.ignore_patterns("checkpoint*"))
    shutil.copytree(run_folder.with_name("views.zarr"), tmp_path / "other.zarr")
    record = json.loads((run_folder / "run.json").read_text()) | {"data": "../other.zarr"}
    group = json.loads((tmp_path / "other.zarr" / "zarr.json").read_text())
    for config in (record["dataset"]["config"], group["attributes"]["config"]):
        config["camera"]["views"] = 3
    (tmp_path / "other" / "run.json").write_text(json.dumps(record))
    (tmp_path / "other.zarr" / "zarr.json").write_text(json.dumps(group))
    for among, samples, words in (
        ([tmp_path], 1, "no finished run"),
        ([run_folder, tmp_path / "other"], 1, "is of other scenes"),
    ):
        with pytest.raises(InputError, match=words):
            run_depth_test(among, tmp_path / "out", samples)
    assert not (tmp_path / "out").exists()
