import math

import numpy as np
import pandas as pd
import pytest
from builders import shapes
from programs import without_graphs

from experiments import timing
from experiments.costs import refocusing
from experiments.costs.refocusing import (
    NETWORK,
    formula_methods,
    measure_refocusing,
    network_methods,
    summarise,
)
from experiments.inputs import SAMPLES, find_scenes
from lf_flame._common.config import build
from lf_flame.datasets.config import config_from_json
from lf_flame.datasets.making import make_dataset
from lf_flame.datasets.sampling import render_sample
from lf_flame.datasets.store import Dataset
from lf_flame.learning.run_folders import open_run
from lf_flame.learning.training import train
from lf_flame.learning.training_config import TrainingConfig
from lf_flame.lightfield import LightField
from lf_flame.refocus import fourier_refocus

pytestmark = [pytest.mark.jit, pytest.mark.slow]

VALUES = shapes(12, (20, 32), coarser=3, sides_mm=(5.0, 4.5), off_axis_mm=5.0)
"""Small shape light fields with two planes."""


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
        "model": {"backbone_weights": "random", "backbone_depth": "none"},
        "presets": {"smoke": {"epochs": 1}},
    }
    training = build(TrainingConfig, values, "here")
    with without_graphs():
        train(training, "smoke", folder / "shapes.zarr", folder / "shapes")
    return folder


@pytest.fixture(scope="module")
def measured(config, run, tmp_path_factory):
    out = tmp_path_factory.mktemp("costs")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(timing, "SHORT_S", 0.0)
        patch.setattr(timing, "ROUNDS", 1)
        record = measure_refocusing(run, [config])
    refocusing.write(out, record)
    return out, record


def test_scores_are_in_the_order_that_theory_gives(measured):
    table = pd.read_csv(measured[0] / "refocusing.csv")
    assert (table["milliseconds"] > 0).all()
    assert table["ssim"].between(table["worst_ssim"], 1 + 1e-6).all()
    scores = dict(zip(table["title"], table["psnr_db"], strict=True))
    assert scores["exact phases"] == np.inf  # the exact result itself
    interpolations = [scores[name] for name in ("nearest", "linear", "cubic")]
    assert sorted(interpolations) == interpolations
    assert interpolations[-1] < scores["Fourier slice"]
    few = [scores[f"linear, {n} x {n} views over the full aperture"] for n in (2, 3)]
    assert few[0] < few[1] < scores["linear"]
    bits_16 = scores["linear, from the raw image of 16 bits"]
    assert bits_16 == pytest.approx(scores["linear"], abs=0.1)
    assert scores["linear, from the raw image"] == scores["linear"]
    networks = [score for title, score in scores.items() if title.startswith(NETWORK)]
    assert len(networks) == 3
    assert np.ptp(networks) < 1e-3
    assert networks[0] < scores["linear"]


def test_scenes_are_those_of_the_test_split_as_the_network_saw_them(config, run):
    found = find_scenes(config, run / "shapes")
    dataset, indices, predictions = open_run(run / "shapes").predict_test_split()
    assert found.indices == tuple(indices[:SAMPLES])
    assert found.slopes == tuple(dataset.attrs["slopes"])
    methods = network_methods(found)
    for index, prediction in zip(found.indices, predictions, strict=False):
        views = render_sample(found.config, index)[0].views
        seen = found.config.encode(LightField(views))
        # Those of the data set came straight from the scene.
        np.testing.assert_allclose(seen, dataset.inputs[index], atol=1e-6)
        for method in methods:
            images = method.refocus(method.store(views), None)
            np.testing.assert_allclose(images, prediction, atol=1e-5)
    without = find_scenes(config, run / "none")
    assert without.indices == (9, 10, 11)
    slopes = Dataset(run / "shapes.zarr").attrs["slopes"]
    np.testing.assert_allclose(without.slopes, slopes, atol=0.02)


@pytest.mark.parametrize("views", [4, 5])
def test_whole_shifts_are_exact_and_fewer_views_keep_their_places(views):
    """A point on every view moves as its slope says: only methods that know its views find it."""
    light_field = np.zeros((views, views, 24, 40), np.float32)
    for v in range(views):
        for u in range(views):
            light_field[v, u, 12 + 2 * v - views, 20 + 2 * u - views] = 1
    slopes = np.array([2.0])
    exact = fourier_refocus(light_field, slopes, interpolation="sinc", edges="clamp")
    for method in formula_methods(views, (1, 1)):
        images = method.refocus(method.store(light_field), slopes)
        if views % 2:  # else half a lenslet aside, which is interpolated
            np.testing.assert_allclose(images, exact, atol=1e-3, err_msg=method.title)
        assert images.sum() == pytest.approx(1, abs=2e-3)


def test_psnr_is_that_of_the_mean_squared_error():
    common = {"data_set": "a", "family": "b", "title": "d"}
    scores = [(0.2, 1.0, 20.0), (0.1, 0.5, math.inf)]
    rows = [{**common, "seconds": s, "ssim": q, "psnr_db": p} for s, q, p in scores]
    (row,) = summarise(pd.DataFrame(rows)).to_dict("records")
    assert row["milliseconds"] == pytest.approx(100)
    assert (row["ssim"], row["worst_ssim"], row["worst_psnr_db"]) == (0.75, 0.5, 20.0)
    assert row["psnr_db"] == pytest.approx(-10 * math.log10(0.01 / 2))
    (exact,) = summarise(pd.DataFrame(rows[1:]))["psnr_db"]
    assert exact == math.inf
