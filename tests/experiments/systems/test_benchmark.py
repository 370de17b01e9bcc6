import hashlib
import json
from pathlib import Path

import keras
import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from experiments.__main__ import commands
from experiments.systems import benchmark, compared_sets, entries, figures
from experiments.systems.cost import Cost, measure_cost
from lf_flame import InputError, LightField
from lf_flame._common import figures as drawing
from lf_flame.datasets.config import read_config
from lf_flame.scenes.dead_leaves import DeadLeaves
from lf_flame.systems.formulas import ShiftAndSum
from lf_flame.systems.resnet50 import ResNet50
from lf_flame.systems.view_selection import square_of_views


@pytest.fixture(scope="module")
def flames(coarse_data):
    return read_config(coarse_data[1])


@pytest.fixture(scope="module")
def sets(flames):
    return compared_sets.paper_sets(flames, Path("no run"), 2)


class Dim(ShiftAndSum):
    """A system whose error is known: everything is 0.01 too dark."""

    def _refocus(self, views, slopes, block):
        return super()._refocus(views, slopes, block) - 0.01


class Blind(ShiftAndSum):
    def view_indices(self, rows, columns):
        raise InputError("Blind sees nothing.")


def test_test_sets_are_the_split_and_the_objects_at_other_depths(sets, flames):
    assert [one.name for one in sets] == [
        "flames",
        "flames, first and last exchanged",
        "flames, order reversed",
        "flames, all 5 mm nearer",
        "flames, round aperture",
        "flames, RefNet's slopes",
        "flames, RefNet's slopes",
    ]
    assert [one.truth for one in sets] == [
        *["shift-and-sum"] * 4, "round aperture", "shift-and-sum", "Fourier slice",
    ]  # fmt: skip
    assert sets[5].planes[7] == "alpha 1"
    assert next(sets[5].scenes()).slopes[7] == 0
    assert sets[0].planes == sets[1].planes == ["20 mm", "10 mm", "0 mm", "-10 mm"]
    assert sets[3].planes == ["15 mm", "5 mm", "-5 mm", "-15 mm"]
    for one in sets:
        scenes = list(one.scenes())
        assert len(scenes) == 2
        assert scenes[0].truth(one.truth).shape == (len(one.planes), 24, 48)
        assert np.any(scenes[0].views != scenes[1].views)
    np.testing.assert_allclose(
        next(sets[3].scenes()).slopes, flames.camera.depth_to_slope(np.array([15.0, 5, -5, -15]))
    )


def test_shift_and_sum_of_all_views_is_right(sets):
    table = benchmark.score_systems({"all": ShiftAndSum()}, sets[0])
    assert list(table.columns) == benchmark.COLUMNS
    assert np.all(np.isinf(table.psnr_db))
    assert table.ssim.tolist() == pytest.approx([1] * 4)
    assert list(table.views) == [81] * 4
    assert list(table.light_fields) == [2] * 4


def test_scores_are_those_of_a_known_error(sets):
    """Where the truth is black nothing can be darker, so 0.01 counts in the foreground."""
    table = benchmark.score_systems({"dim": Dim()}, sets[0])
    np.testing.assert_allclose(table.psnr_foreground_db, 40, atol=0.5)


def test_what_a_system_refuses_is_missing_in_its_own_words(sets):
    table = benchmark.score_systems({"blind": Blind()}, sets[0])
    assert list(table.why_missing) == ["Blind sees nothing."]
    assert table.psnr_db.isna().all()


def test_the_border_of_photographs_is_not_scored():
    views = DeadLeaves().draw((9, 9), (60, 70), np.random.default_rng(3)).views
    photographs = compared_sets.photograph_sets("leaves", LightField(views), [-0.5, 0.5])[0]

    class WrongAtTheEdge(ShiftAndSum):
        def _refocus(self, views, slopes, block):
            images = super()._refocus(views, slopes, block)
            images[:, :12] = 0
            return images

    table = benchmark.score_systems({"edge": WrongAtTheEdge()}, photographs)
    assert np.all(np.isinf(table.psnr_db))
    assert list(table.plane) == ["slope -0.5", "slope 0.5"]


def test_the_other_reference_of_photographs_blurs_points_to_discs():
    """A point that moves by a pixel from view to view is a square of 9 x 9, or the disc in it."""
    views = np.zeros((9, 9, 50, 60), np.float32)
    for v in range(9):
        for u in range(9):
            views[v, u, 20 + v, 25 + u] = 1
    square, disc = (
        one.truth(test_set.truth)[0]
        for test_set in compared_sets.photograph_sets("point", LightField(views), [0.0])
        for one in test_set.scenes()
    )
    y, x = np.mgrid[-4:5, -4:5]
    np.testing.assert_allclose(square[20:29, 25:34], 1 / 81, rtol=1e-6)
    inside = disc[20:29, 25:34]
    np.testing.assert_allclose(inside[np.hypot(abs(y) + 0.5, abs(x) + 0.5) < 4.5],
                               4 / (np.pi * 81), rtol=1e-6)  # fmt: skip
    assert np.all(inside[np.hypot(abs(y) - 0.5, abs(x) - 0.5) > 4.5] == 0)
    assert disc.sum() == pytest.approx(1)


def test_photographs_are_as_bright_as_systems_take_them():
    views = DeadLeaves().draw((9, 9), (60, 70), np.random.default_rng(3)).views
    few = ShiftAndSum("few", square_of_views)
    bright, plain = (
        benchmark.score_systems(
            {"few": few}, compared_sets.photograph_sets("leaves", LightField(v), [0.5])[0]
        )
        for v in (1000 * views, views / views.max())
    )
    assert bright.psnr_db[0] == pytest.approx(plain.psnr_db[0], abs=0.01)
    assert 15 < bright.psnr_db[0] < 60


def test_a_photograph_too_small_to_be_scored_is_refused():
    """After the border is cut off, a window of the structural similarity must be left."""
    views = np.zeros((3, 3, 35, 35), np.float32)
    dark = compared_sets.photograph_sets("dark", LightField(views), [0.0])[0]
    (scene,) = dark.scenes()
    assert benchmark.score_systems({"all": ShiftAndSum()}, dark).ssim.tolist() == [1.0]
    assert scene.views.shape == views.shape
    with pytest.raises(
        InputError, match="dark needs views of 35 pixels or more along each side, got 34 x 40"
    ):
        compared_sets.photograph_sets("dark", LightField(np.zeros((3, 3, 34, 40))), [0.0])


def test_less_light_is_shot_noise_of_the_same_scenes(sets):
    """Its variance is the mean over the electrons; the truth stays that of the clean views."""
    dark = sets[0].in_low_light(100, seed=4)
    for scene, clean, again in zip(dark.scenes(), sets[0].scenes(), dark.scenes(), strict=True):
        error = scene.views - clean.views
        assert abs(error.mean()) < 1e-4
        assert np.var(error) == pytest.approx(clean.views.mean() / 100, rel=0.02)
        np.testing.assert_array_equal(scene.truth(), clean.truth())
        np.testing.assert_array_equal(scene.views, again.views)
    table = benchmark.score_systems({"all": ShiftAndSum()}, dark)
    assert set(table.electrons) == {100}
    assert np.all(table.psnr_db.between(40, 70))


@pytest.mark.slow
def test_a_price_is_measured_in_a_process_of_its_own(sets):
    scene = next(sets[0].scenes())
    large = np.ones(100_000_000)  # what this process holds does not count
    found = measure_cost(ShiftAndSum, scene.views, scene.slopes, scene.block)
    assert found.milliseconds > 0
    assert 10 < found.memory_mb < 400 < large.nbytes / 1e6  # no network was loaded


@pytest.fixture
def _no_clock(monkeypatch):
    """Times of nobody: each takes a process, and `measure_cost` has a test of its own.

    Figures are made and not drawn, which takes half a second for each.
    """
    monkeypatch.setattr(benchmark, "measure_cost", lambda *_: Cost(2.0, 30.0))
    monkeypatch.setattr(drawing, "save", lambda figure, path, dpi=150: path.touch())


@pytest.mark.slow
@pytest.mark.usefixtures("_no_clock")
def test_the_program_compares_and_says_what_is_missing(system_runs, coarse_data, tmp_path):
    views = DeadLeaves().draw((9, 9), (40, 48), np.random.default_rng(3)).views
    leaves = tmp_path / "leaves.npy"
    np.save(leaves, views)
    arguments = ["compare", system_runs, "--out", tmp_path / "out", "--data", coarse_data[1],
                 "--light-fields", 1, "--photograph", leaves, "-0.5,1", "--electrons",
                 50, "--variant", system_runs / "refocusnet"]  # fmt: skip
    shown = CliRunner().invoke(commands, [str(x) for x in arguments], catch_exceptions=False)
    assert shown.exit_code == 0
    scores = pd.read_csv(tmp_path / "out/compare.csv")
    trained = scores[scores.system == "RefocusNet"]
    assert set(trained.test_set) == set(scores.test_set)
    assert trained.psnr_db.notna().all()
    absent = scores[scores.system.str.startswith("RefNet")]
    assert absent.psnr_db.isna().all()
    assert absent.why_missing.str.contains("no finished run").all()
    variant = scores[scores.system == "ResNet-50, smoke recipe, refocusnet"]
    assert variant.why_missing.str.contains("it must hold one of the paper's network").all()
    assert len(variant)
    costs = pd.read_csv(tmp_path / "out/systems.csv").set_index("system")
    assert costs.milliseconds["RefocusNet"] == 2
    assert costs.memory_mb["RefocusNet"] == 30
    assert costs.training_s["RefocusNet"] > 0
    assert costs.views["RefocusNet"] == 4
    assert costs.steps["RefocusNet"] == 2
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "compare.csv", "compare.json", "compare.md", "compare.png", "compare_learning.png",
        "compare_noise.png", "learning.csv", "systems.csv",
    }  # fmt: skip
    text = (tmp_path / "out/compare.md").read_text()
    assert "missing" in text
    assert "50 electrons" in text
    assert "While learning" in text


@pytest.mark.parametrize(
    ("record", "steps", "seconds"),
    [
        # Four epochs, one of them while the machine did other things; drawing samples aside.
        ({"system": "refnet", "epochs": 4, "recipe": {"steps_per_epoch": 7, "batch_size": 2}},
         28, 8.0),
        # Of the paper's network the start counts, and an epoch sees every sample once.
        ({"epochs": 4, "recipe": {"batch_size": 2}, "parts": {"train": 9}}, 20, 38.0),
        ({"epochs": 0, "recipe": {"batch_size": 2}, "parts": {"train": 9}}, 0, 30.0),
    ],
)  # fmt: skip
def test_a_busy_machine_hardly_changes_what_training_took(tmp_path, record, steps, seconds):
    (tmp_path / "model.keras").write_bytes(b"")
    digest = hashlib.sha256(b"").hexdigest()
    (tmp_path / "run.json").write_text(json.dumps(record | {"model_sha256": digest}))
    rows = ["epoch,loss,val_loss,val_psnr_db,seconds", "0,1,1,0,30"]
    rows += [f"{k},1,1,0,{s}" for k, s in ((1, 2), (2, 2), (3, 50), (4, 2))]
    (tmp_path / "history.csv").write_text("\n".join(rows[: 2 + record["epochs"]]) + "\n")
    about = entries._about(tmp_path)
    assert about["steps"] == steps
    assert about["seconds"] == pytest.approx(seconds)
    if "system" in record:
        assert about["curve"]["steps"] == [0, 7, 14, 21, 28]
        assert about["curve"]["seconds"] == [0, 2, 4, 6, 8]
    else:
        assert "curve" not in about
    (tmp_path / "history.csv").unlink()
    assert not {"steps", "seconds"} & entries._about(tmp_path).keys()
    assert entries._about(tmp_path)["epochs"] == record["epochs"]


@pytest.mark.slow
@pytest.mark.usefixtures("_no_clock")
def test_a_system_for_one_data_set_is_not_scored_on_the_other(sets, tmp_path):
    entered = [entries.Entry(x, ShiftAndSum, {}, only=x) for x in ("shapes", "flames")]
    benchmark.run_benchmark(entered, sets[:1], tmp_path)
    table = pd.read_csv(tmp_path / "compare.csv").set_index("system")
    assert table.why_missing["shapes"] == "it was trained on shapes."
    assert table.loc["flames", "psnr_db"].eq(np.inf).all()


def test_a_row_of_the_picture_is_a_system_that_could_be_timed(sets):
    names = ["missing", "all", "dim"]
    systems = {"missing": InputError("gone"), "all": ShiftAndSum(), "dim": Dim()}
    scores = benchmark.score_systems(systems, sets[0].in_low_light(10, seed=1))
    costs = pd.DataFrame({"system": names, "parameters": [np.nan, 0, 0]})
    costs["milliseconds"] = [np.nan, 2.0, 3.0]
    axis = figures.figure(scores, costs).axes[0]
    assert [label.get_text() for label in axis.get_yticklabels()] == ["all: 2 ms", "dim: 3 ms"]
    means = scores.groupby("system")["psnr_db"].mean().clip(*figures.SHOWN_DB)
    shown = {line.get_ydata()[0]: line.get_xdata()[0] for line in axis.lines}
    assert shown == pytest.approx({0: means["all"], 1: means["dim"]})


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--light-fields", "0"], "1 or more, got 0"),
        (["--photograph", "x.npy", "1;2"], "got '1;2'"),
        (["--variant", ".", "--variant", "."], "Two systems are called"),
    ],
)
def test_bad_input_is_one_sentence(system_runs, tmp_path, options, words):
    np.save(tmp_path / "x.npy", np.zeros((3, 3, 20, 20)))
    options = [str(tmp_path / x) if x == "x.npy" else x for x in options]
    with pytest.raises(InputError, match=words):
        CliRunner().invoke(
            commands, ["compare", str(system_runs), "--out", str(tmp_path), *options],
            catch_exceptions=False, standalone_mode=False,
        )  # fmt: skip


def test_the_papers_network_is_for_its_own_camera_and_slopes(flames):
    """What it refuses needs no training: a network whose plane k is as bright as k tenths."""
    seen = keras.Input((24, 48, 1))
    planes = [0 * seen + k / 10 for k in range(4)]
    system = ResNet50(
        keras.Model(seen, keras.ops.stack(planes, axis=1)), flames, [1.0, 0.5, 0.0, -0.5]
    )
    views = np.zeros((9, 9, 48, 96), np.float32)
    stack = system.refocus(views, [-0.5, 0.5], (2, 2))
    np.testing.assert_allclose(stack, np.broadcast_to(np.float32([[[0.3]], [[0.1]]]), (2, 24, 48)))
    for wrong, slope, block, words in [
        (views, 0.3, (2, 2), "only does the slopes 1.00, 0.50, 0.00, -0.50, got 0.3"),
        (views[:5, :5], 0.5, (2, 2), "a camera of 9 x 9 views, got 5 x 5"),
        (views, 0.5, (1, 1), "48 x 96 lenslets, 2 x 2 to a pixel, got .* and 1 x 1"),
        (views[..., None].repeat(3, -1), 0.5, (2, 2), "trained on grey light fields"),
    ]:
        with pytest.raises(InputError, match=words):
            system.refocus(wrong, slope, block)
