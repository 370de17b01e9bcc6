import json
import math
import shutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from builders import shapes
from click.testing import CliRunner
from matplotlib.image import imread
from matplotlib.text import Annotation, Text

from experiments import timing
from experiments.__main__ import commands
from experiments.costs import refocusing, refocusing_report
from experiments.costs.refocusing import (
    ALONE,
    NETWORK,
    formula_methods,
    measure_refocusing,
    network_methods,
    summarise,
)
from experiments.held_out import SAMPLES, find_scenes
from lf_flame._common import figures
from lf_flame._common.config import build, to_json
from lf_flame.datasets.config import config_from_json
from lf_flame.datasets.making import make_dataset
from lf_flame.datasets.sampling import render_sample
from lf_flame.datasets.store import Dataset
from lf_flame.learning.run_folders import predict_test_split
from lf_flame.learning.training import train
from lf_flame.learning.training_config import TrainingConfig
from lf_flame.lightfield import LightField
from lf_flame.refocus import fourier_refocus

pytestmark = [pytest.mark.jit, pytest.mark.slow]

VALUES = shapes(12, coarser=3)
"""Small shape light fields with two planes."""

LABELS = {
    "interpolation": ["nearest", "linear", "cubic"],
    "central": ["3 x 3"],
    "spread": ["2 x 2", "3 x 3"],
    "storage": ["float16", "uint16", "uint8", "2 x 2 binned"],
    "fourier": ["phases, padded", "phases", "slice, padded", "slice"],
}


@pytest.fixture(scope="module")
def config():
    return config_from_json(VALUES, "here")


@pytest.fixture(scope="module")
def run(config, tmp_path_factory):
    """A run folder with a network that was trained for a moment."""
    folder = tmp_path_factory.mktemp("runs")
    make_dataset(config, 12, folder / "shapes.zarr")
    values = {
        "title": "test",
        "seed": 1,
        "split": [0.5, 0.25, 0.25],
        "model": {"backbone_depth": "none"},
        "presets": {"smoke": {"epochs": 1, "neck": "positions"}},
    }
    training = build(TrainingConfig, values, "here")
    train(training, "smoke", folder / "shapes.zarr", folder / "shapes")
    return folder


@pytest.fixture(scope="module", autouse=True)
def _short_runs():
    patch = pytest.MonkeyPatch()
    patch.setattr(timing, "SHORT_S", 0.0)
    patch.setattr(timing, "ROUNDS", 1)
    yield
    patch.undo()


@pytest.fixture(scope="module")
def measured(config, run, tmp_path_factory):
    out, record = tmp_path_factory.mktemp("costs"), measure_refocusing(run, [config])
    refocusing_report.write(out, record)
    return out, record


def test_all_files_are_there_and_agree(measured):
    out, record = measured
    names = {f"refocusing.{ending}" for ending in ("csv", "md", "json", "png")}
    assert {path.name for path in out.iterdir()} == names
    pixels = imread(out / "refocusing.png")[..., :3]
    assert min(pixels.shape[:2]) > 500
    assert 0.005 < np.mean(pixels < 0.9) < 0.5  # neither empty nor covered
    text = (out / "refocusing.json").read_text()
    stored = json.loads(text, parse_constant=pytest.fail)
    pd.testing.assert_frame_equal(
        refocusing_report.table_of(stored), refocusing_report.table_of(record)
    )
    assert stored["threads"] >= 1
    assert len(pd.read_csv(out / "refocusing.csv")) == len(record["methods"])
    report = (out / "refocusing.md").read_text()
    for words in (stored["command"], stored["machine"], "premise", "preset smoke, 1 epochs"):
        assert words in report
    assert "nan" not in report
    assert "missing" not in report


def test_every_way_has_a_row_with_a_time_and_scores(measured):
    table = pd.read_csv(measured[0] / "refocusing.csv")
    expected = {**LABELS, "network": [NETWORK, ALONE]}
    rows = [(family, label) for family, labels in expected.items() for label in labels]
    assert list(zip(table["family"], table["label"], strict=True)) == rows
    assert (table["milliseconds"] > 0).all()
    assert table["ssim"].between(table["worst_ssim"], 1 + 1e-6).all()
    assert (table["psnr_db"] >= table["worst_psnr_db"]).all()


def test_scores_are_in_the_order_that_theory_gives(measured):
    table = pd.read_csv(measured[0] / "refocusing.csv")
    scores = {(row.family, row.label): row.psnr_db for row in table.itertuples()}
    assert scores["fourier", "phases, padded"] == np.inf  # the exact result itself
    interpolations = [scores["interpolation", name] for name in ("nearest", "linear", "cubic")]
    assert sorted(interpolations) == interpolations
    assert interpolations[-1] < scores["fourier", "slice, padded"]
    linear = scores["interpolation", "linear"]
    assert scores["spread", "2 x 2"] < scores["spread", "3 x 3"] < linear
    assert scores["central", "3 x 3"] < linear
    assert scores["storage", "uint16"] == pytest.approx(linear, abs=0.1)
    assert scores["network", NETWORK] == scores["network", ALONE] < linear


def test_a_missing_run_shows_as_missing(config, tmp_path):
    found = measure_refocusing(tmp_path / "none", [replace(config, image=(80, 128))])
    refocusing_report.write(tmp_path, found)
    record = json.loads((tmp_path / "refocusing.json").read_text())
    (row,) = (row for row in record["methods"] if row["family"] == "network")
    assert row["label"] == NETWORK
    assert not {"milliseconds", "psnr_db", "ssim"} & row.keys()
    assert "no finished run in" in record["scenes"]["shapes"]["network"]
    report = (tmp_path / "refocusing.md").read_text()
    assert f"{NETWORK} is missing" in report
    assert report.count("missing |") == 5
    assert "nan" not in report
    assert imread(tmp_path / "refocusing.png").size > 0


def test_a_run_needs_no_data_set_but_a_record_that_says_what_it_held(config, run, tmp_path):
    record = json.loads((run / "shapes" / "run.json").read_text())
    shutil.copy(run / "shapes" / "model.keras", tmp_path)
    (tmp_path / "run.json").write_text(json.dumps(record | {"data": "none.zarr"}))
    found, known = find_scenes(config, tmp_path), find_scenes(config, run / "shapes")
    assert found.run == tmp_path
    assert (found.indices, found.slopes) == (known.indices, known.slopes)
    assert to_json(found.config) == to_json(known.config)
    old = {name: value for name, value in record.items() if name != "dataset"}
    (tmp_path / "run.json").write_text(json.dumps(old | {"data": str(tmp_path / "none.zarr")}))
    found = find_scenes(config, tmp_path)
    assert found.run is None
    assert "dataset is missing" in found.origin


def test_scenes_are_those_of_the_test_split_as_the_network_saw_them(config, run):
    found = find_scenes(config, run / "shapes")
    dataset, indices, predictions = predict_test_split(run / "shapes")
    assert found.indices == tuple(indices[:SAMPLES])
    assert found.slopes == tuple(dataset.attrs["slopes"])
    whole, alone = network_methods(found)
    for index, prediction in zip(found.indices, predictions, strict=False):
        views = render_sample(found.config, index)[0].views
        seen = found.config.encode(LightField(views))
        # Those of the data set came straight from the scene.
        np.testing.assert_allclose(seen, dataset.inputs[index], atol=1e-6)
        images = whole.refocus(views, None)
        np.testing.assert_allclose(images, prediction, atol=1e-5)
        np.testing.assert_array_equal(alone.refocus(alone.store(views), None), images)


def test_without_a_run_the_slopes_are_those_that_data_sets_find(config, run):
    found = find_scenes(config, run / "none")
    assert found.indices == (9, 10, 11)
    np.testing.assert_allclose(
        found.slopes, Dataset(run / "shapes.zarr").attrs["slopes"], atol=0.01
    )


@pytest.mark.parametrize("views", [4, 5])
def test_whole_shifts_are_exact_and_fewer_views_keep_their_places(views, rng):
    """A point on every view moves as its slope says: only methods that know its views find it."""
    light_field = np.zeros((views, views, 24, 40), np.float32)
    for v in range(views):
        for u in range(views):
            light_field[v, u, 12 + 2 * v - views, 20 + 2 * u - views] = 1
    slopes = np.array([2.0])
    exact = fourier_refocus(light_field, slopes, interpolation="sinc", edges="clamp")
    methods = formula_methods(views, (1, 1))
    assert {method.family for method in methods} == set(LABELS)
    for method in methods:
        images = method.refocus(method.store(light_field), slopes)
        if views % 2:  # else half a lenslet aside, which is interpolated
            np.testing.assert_allclose(images, exact, atol=1e-3, err_msg=method.title)
        assert images.sum() == pytest.approx(1, abs=2e-3)


def test_few_views_count_those_of_the_camera():
    labels = [
        method.label
        for method in formula_methods(15, (3, 3))
        if method.family in ("central", "spread")
    ]
    central = [f"{n} x {n}" for n in (3, 5, 7, 9, 11, 13)]
    assert labels == [*central, "2 x 2", "3 x 3", "8 x 8"]


def test_psnr_is_that_of_the_mean_squared_error():
    common = {"data_set": "a", "family": "b", "label": "c", "title": "d"}
    scores = [(0.2, 1.0, 20.0), (0.1, 0.5, math.inf)]
    rows = [{**common, "seconds": s, "ssim": q, "psnr_db": p} for s, q, p in scores]
    (row,) = summarise(pd.DataFrame(rows)).to_dict("records")
    assert row["milliseconds"] == pytest.approx(100)
    assert (row["ssim"], row["worst_ssim"], row["worst_psnr_db"]) == (0.75, 0.5, 20.0)
    assert row["psnr_db"] == pytest.approx(-10 * math.log10(0.01 / 2))
    (exact,) = summarise(pd.DataFrame(rows[1:]))["psnr_db"]
    assert exact == math.inf


def test_the_text_says_what_the_numbers_say(measured):
    table = pd.read_csv(measured[0] / "refocusing.csv")

    def words(milliseconds, psnr_db):
        for (family, label), value in milliseconds.items():
            chosen = (table["family"] == family) & (table["label"] == label)
            table.loc[chosen, "milliseconds"] = value
        table.loc[table["family"] == "network", "psnr_db"] = psnr_db
        table.loc[table["label"] == "linear", "psnr_db"] = 50.0
        record = measured[1] | {"methods": table.to_dict("records")}
        return "\n".join(refocusing_report.body(record))

    linear, raw = ("interpolation", "linear"), ("storage", "uint8")
    network, small = ("network", NETWORK), ("storage", "2 x 2 binned")
    report = words({linear: 10.0, raw: 5.0, small: 1.0, network: 50.0}, 40.0)
    assert "takes 50 ms, 5 times as long, and its images are 10.0 dB worse (40.0 dB" in report
    assert "100 of float32, 200 of uint8, 1e+03 of 40 x 64 lenslets; by the network: 20" in report
    assert "the premise holds for none of them" in report
    report = words({linear: 80.0, network: 20.0}, 52.0)
    assert "takes 20 ms, 4 times as fast, and its images are 2.0 dB better (52.0 dB" in report
    assert "the premise holds for light fields of float32." in report


def test_labels_of_the_figure_overlap_neither_points_nor_each_other(measured):
    table = pd.read_csv(measured[0] / "refocusing.csv")
    picture = refocusing_report.figure(measured[1])
    for axis in picture.axes:
        notes = [note for note in axis.texts if isinstance(note, Annotation)]
        assert len(notes) == len(table)
        boxes = [Text.get_window_extent(note) for note in notes]
        points = axis.transData.transform([note.xy for note in notes])
        for k, box in enumerate(boxes):
            assert not any(box.overlaps(other) for other in boxes[:k])
            assert not any(box.contains(*point) for point in points)


def test_the_program_measures_the_chapter_that_is_asked_for(measured, tmp_path, monkeypatch):
    monkeypatch.setattr(refocusing, "measure_refocusing", lambda run: measured[1])
    monkeypatch.setattr(figures, "save", lambda figure, path, dpi=150: path.touch())
    options = ["--chapter", "refocusing", "--out", str(tmp_path)]
    done = CliRunner().invoke(commands, ["costs", *options], catch_exceptions=False)
    assert done.exit_code == 0
    assert "What accuracy costs in time: refocusing" in done.output
    assert not (tmp_path / "costs.md").exists()
    assert (tmp_path / "refocusing.csv").exists()
