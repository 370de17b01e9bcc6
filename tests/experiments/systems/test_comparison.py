"""Refocusing systems side by side: known errors, known budgets, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from experiments.__main__ import commands
from experiments.inputs import find_scenes
from experiments.systems import compared, comparison
from experiments.timing import measure_cost
from lf_flame import InputError, LightField
from lf_flame._common import figures
from lf_flame.datasets.config import read_config
from lf_flame.scenes.dead_leaves import DeadLeaves
from lf_flame.systems.formulas import ShiftAndSum
from lf_flame.systems.training import NETWORKS


@pytest.fixture(scope="module")
def flames(coarse_data):
    return read_config(coarse_data[1])


@pytest.fixture(scope="module")
def sets(flames):
    return compared.paper_sets(flames, find_scenes(flames, Path("no run"), 2), 2)


@pytest.fixture(scope="module")
def leaves():
    return DeadLeaves().draw((9, 9), (60, 70), np.random.default_rng(3)).views


class Dim(ShiftAndSum):
    """A system whose error is known: everything is 0.01 too dark, and the edges are black."""

    def _refocus(self, views, slopes, block):
        images = super()._refocus(views, slopes, block) - 0.01
        images[:, :12] = images[:, -12:] = images[:, :, :12] = images[:, :, -12:] = 0
        return images


class Blind(ShiftAndSum):
    def view_indices(self, rows, columns):
        raise InputError("Blind sees nothing.")


@pytest.mark.slow
def test_test_sets_are_the_split_and_the_objects_at_other_depths(sets, flames):
    planes = ["20 mm", "10 mm", "0 mm", "-10 mm"]
    assert {one.name: one.planes for one in sets[:4]} == {
        "flames": planes,
        "flames, first and last exchanged": planes,
        "flames, order reversed": planes,
        "flames, all 5 mm nearer": ["15 mm", "5 mm", "-5 mm", "-15 mm"],
    }
    assert [one.name for one in sets[4:]] == ["flames, RefNet's slopes"]
    assert dict(zip(sets[4].planes, next(sets[4].scenes()).slopes, strict=True))["alpha 1"] == 0
    for one in sets:
        first, second = one.scenes()
        assert first.reference().shape == (len(one.planes), 24, 48)
        assert np.any(first.views != second.views)
    np.testing.assert_allclose(
        next(sets[3].scenes()).slopes, flames.camera.depth_to_slope(np.array([15.0, 5, -5, -15]))
    )


def test_scores_are_those_of_known_errors(leaves):
    """An exact system, one with an error of 0.01, one that refuses the set, and a missing one.

    Photographs are scaled to values up to 1.
    """
    light_field = LightField(500 * leaves + 100)
    photograph = compared.photograph_set("leaves", light_field, [-0.5, 0.5])
    (scene,) = photograph.scenes()
    assert 0.5 < scene.views.max() <= 1
    systems = {"exact": ShiftAndSum(), "dim": Dim(), "blind": Blind(), "gone": InputError("No.")}
    table = comparison.score_systems(systems, photograph)
    assert list(table.columns) == comparison.COLUMNS
    assert list(table.plane[:2]) == ["slope -0.5", "slope 0.5"]
    rows = table.set_index("system")
    assert np.all(np.isinf(rows.psnr_db["exact"]))
    np.testing.assert_allclose(rows.psnr_db["dim"], 40, atol=1e-3)
    assert list(rows.views["dim"]) == [81, 81]
    assert list(rows.light_fields["dim"]) == [1, 1]
    assert rows.psnr_db[["blind", "gone"]].isna().all()
    assert list(rows.why_missing[["blind", "gone"]]) == ["Blind sees nothing.", "No."]


@pytest.mark.slow
def test_cost_is_measured_in_a_process_of_its_own(sets):
    scene = next(sets[0].scenes())
    large = np.ones(100_000_000)  # memory of this process does not count
    found = measure_cost(ShiftAndSum, scene.views, scene.slopes, scene.block)
    assert found["milliseconds"] > 0
    assert 10 < found["memory_mb"] < 400 < large.nbytes / 1e6  # no network was loaded


@pytest.mark.parametrize(
    ("record", "steps", "seconds"),
    [
        # Four epochs, one of them while the machine was busy.
        ({"system": "refnet", "epochs": 4, "recipe": {"steps_per_epoch": 7, "batch_size": 2}},
         28, 8.0),
        # The paper's network uses every sample once in an epoch.
        ({"epochs": 4, "recipe": {"batch_size": 2}, "parts": {"train": 9}}, 20, 8.0),
    ],
)  # fmt: skip
def test_training_takes_the_median_epoch_times_the_epochs(tmp_path, record, steps, seconds):
    (tmp_path / "model.keras").write_bytes(b"")
    (tmp_path / "run.json").write_text(json.dumps(record | {"train_s": 1.0}))
    rows = ["epoch,loss,val_loss,val_psnr_db,seconds"]
    rows += [f"{k},1,1,0,{s}" for k, s in ((1, 2), (2, 2), (3, 50), (4, 2))]
    (tmp_path / "history.csv").write_text("\n".join(rows[: 1 + record["epochs"]]) + "\n")
    about = compared.training_of(tmp_path)
    assert (about["steps"], about["seconds"]) == (steps, pytest.approx(seconds))
    if "system" in record:
        assert about["curve"]["steps"] == [7, 14, 21, 28]
        assert about["curve"]["seconds"] == [2, 4, 6, 8]
    (tmp_path / "history.csv").unlink()
    assert compared.training_of(tmp_path) == {}


COST = {"milliseconds": 2.0, "memory_mb": 30.0}

SYSTEMS = pd.DataFrame({
    "system": ["fast", "slow", "long", "formula"], "views": [9, 4, 4, 225],
    "parameters": [8, 9, 7, 0], "steps": [300, 200, 900, np.nan],
    "training_s": [3, 4, 9, np.nan], "milliseconds": [2.0, 3.0, 4.0, 1.0], "memory_mb": 1.0,
})  # fmt: skip

ABOUT = {
    "fast": {"curve": {"steps": [100, 200, 300], "seconds": [1, 2, 3],
                       "psnr_db": [30.0, 29.0, 33.0]}},
    "slow": {"curve": {"steps": [100, 200], "seconds": [2, 4], "psnr_db": [20.0, 35.0]}},
    "long": {}, "formula": {},
}  # fmt: skip


def test_budgets_are_stated_in_every_row():
    table = comparison.with_equal_effort(SYSTEMS, ABOUT).set_index("system")
    assert table.at_seconds.to_dict() == pytest.approx(
        {"fast": 3, "slow": 3, "long": np.nan, "formula": np.nan}, nan_ok=True
    )
    # The best weights are kept, so a later, worse epoch does not count.
    assert list(table.after_steps_db[:2]) == [30, 35]
    assert list(table.after_seconds_db[:2]) == [33, 20]
    scores = pd.DataFrame([
        {"system": name, "test_set": "set", "psnr_db": 30.0 + k, "ssim": 0.9, "plane": "0 mm",
         "why_missing": ""}
        for k, name in enumerate(SYSTEMS.system)
    ])  # fmt: skip
    frame = {"planes": 4, "image": "9 x 9", "views": "3 x 3"}
    text = "\n".join(comparison.body(scores, table.reset_index(), {"frame": frame}))
    assert "trained for 3 to 4 s; in that time they took 200 to 300 steps" in text
    tables = [line for line in text.splitlines() if line.startswith("| ")]
    names = [line.split("|")[1].strip() for line in tables]
    assert names == 3 * ["system", "slow", "long", "fast", "formula"]  # fewest views first
    rows = [[cell.strip() for cell in row.split("|")[1:-1]] for row in text.splitlines()]
    assert ["fast", "9", "8", "300", "3", "33.00", "30.00", "2.0", "1"] in rows
    assert ["slow", "4", "200", "4", "31.00"] in rows  # beside PSNR: views, steps, seconds
    assert ["formula", "225", "", "", "33.00"] in rows


@pytest.mark.slow
def test_the_program_compares_and_lists_what_is_missing(
    system_runs, coarse_data, leaves, tmp_path, monkeypatch
):
    """Costs have a test of their own, and drawing the figure takes half a second."""
    monkeypatch.setattr(comparison, "measure_cost", lambda *_: COST)
    monkeypatch.setattr(figures, "save", lambda figure, path, dpi=150: Path(path).touch())
    np.save(tmp_path / "leaves.npy", leaves[:, :, :40, :48])
    arguments = ["compare", system_runs, "--out", tmp_path / "out", "--data", coarse_data[1],
                 "--light-fields", 1, "--photograph", tmp_path / "leaves.npy",
                 "-0.5,0.5"]  # fmt: skip
    shown = CliRunner().invoke(commands, [str(x) for x in arguments], catch_exceptions=False)
    assert shown.exit_code == 0
    assert (tmp_path / "out/compare.md").read_text() in shown.stdout
    scores = pd.read_csv(tmp_path / "out/compare.csv")
    trained = scores[scores.system == "RefocusNet"]
    assert set(trained.test_set) == set(scores.test_set)
    assert trained.psnr_db.notna().all()
    own = scores[scores.system == "shift-and-sum, RefocusNet's 4 views"]
    assert own.psnr_db.notna().all()
    missing = scores[scores.system == "ResNet-50, no run, flames"]
    assert missing.why_missing.str.contains("no finished run").any()
    systems = pd.read_csv(tmp_path / "out/systems.csv").set_index("system")
    assert set(systems.index) >= {network.system.name for network in NETWORKS.values()}
    assert list(systems.loc["RefocusNet", ["milliseconds", "views", "steps"]]) == [2, 4, 2]


def test_a_system_for_one_data_set_is_not_scored_on_the_other(sets):
    entries = [compared.Entry(x, ShiftAndSum, {}, only=x) for x in ("shapes", "flames")]
    frame = compared.Scene(np.zeros((1, 1, 2, 2), np.uint8), np.zeros(1))  # refused, so not timed
    *_, table = comparison._measure_and_score(entries, sets[:1], frame)
    rows = table.set_index("system")
    assert rows.why_missing["shapes"] == "it was trained on shapes."
    assert rows.psnr_db[["flames"]].eq(np.inf).all()
