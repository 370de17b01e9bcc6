"""Systems against the light fields that they learn from: others are scored, the same for all."""

import json

import numpy as np
import pandas as pd
import pytest

from experiments.systems.scene_counts import FIRST_SCORED, run_scene_counts, score_systems
from lf_flame import InputError
from lf_flame._common import figures
from lf_flame._common.config import build
from lf_flame.systems.aperturenet import ApertureNet
from lf_flame.systems.formulas import ShiftAndSum
from lf_flame.systems.registry import NETWORKS
from lf_flame.systems.training import FIRST_HELD_OUT, load_system
from lf_flame.systems.training_config import SystemsConfig
from lf_flame.systems.view_selection import square_of_views


@pytest.fixture(scope="module")
def config(coarse_data):
    recipe = {
        "epochs": 1,
        "steps_per_epoch": 2,
        "batch_size": 2,
        "patch": 20,
        "learning_rate": 1e-5,
    }
    values = {
        "seed": 3,
        "training_samples": {"data": [str(path) for path in coarse_data], "slopes": 2},
        "presets": {"smoke": {"training_samples": 4, "held_out": 2}},
        "systems": {"aperturenet": recipe},
    }
    return build(SystemsConfig, values, "test")


class Off(ShiftAndSum):
    """All views' sum, wrong by a known amount where nothing clips it."""

    def __init__(self, by: float):
        super().__init__()
        self.by = by

    def slopes_to_learn(self, slopes, block):
        return slopes

    def _refocus(self, views, slopes, block):
        # Towards the middle of the range, so that no value leaves it.
        images = super()._refocus(views, slopes, block)
        return images + np.where(images > 0.5, -self.by, self.by)


def test_an_error_that_is_known_has_its_psnr(config):
    one, ten = score_systems([Off(0.01), Off(0.1)], config.training_samples, 3, 3, Off(0))
    assert one["images"] == 6
    for score, error in ((one, 0.01), (ten, 0.1)):
        # The reference is projected, not summed: equal to float32.
        assert score["psnr_db"] == pytest.approx(-20 * np.log10(error), abs=0.01)
        assert score["psnr_of_mean_error_db"] == pytest.approx(-20 * np.log10(error), abs=0.01)
    assert one["ssim"] > ten["ssim"]


def test_what_is_scored_was_neither_learnt_nor_held_out(config, monkeypatch):
    drawn = []
    draw = type(config.training_samples).draw

    def watched(self, seed, index, *args, **options):
        drawn.append(index)
        return draw(self, seed, index, *args, **options)

    monkeypatch.setattr(type(config.training_samples), "draw", watched)
    score_systems([Off(0)], config.training_samples, 3, 2, Off(0.01))
    assert drawn == [FIRST_SCORED, FIRST_SCORED + 1]
    assert min(drawn) > FIRST_HELD_OUT + 100_000


@pytest.mark.slow
def test_report_holds_every_run_and_the_sum_of_the_same_views(config, tmp_path, monkeypatch):
    monkeypatch.setattr(ApertureNet, "smallest", 1)  # the pictures are small
    monkeypatch.setattr(figures, "save", lambda figure, path, dpi=150: path.touch())
    work, out = tmp_path / "work", tmp_path / "out"
    path = run_scene_counts(config, ["aperturenet"], [4, 2, 4], 2, 2, work, out)
    table = pd.read_csv(out / "scene_counts.csv")
    assert list(table["light_fields"].fillna(0)) == [0, 2, 4]
    assert list(table["views"]) == [9, 9, 9]
    assert set(table["steps"].dropna()) == {2}
    record = json.loads((out / "scene_counts.json").read_text())
    assert record["runs"]["aperturenet-4"]["counts"] == {"training_samples": 4, "held_out": 2}
    assert "shift-and-sum of the same views" in path.read_text()

    # Each row is of its run, and the formula's of the views that the network looks at.
    trained = [load_system(work / f"aperturenet-{count}") for count in (2, 4)]
    systems = [ShiftAndSum(selection=square_of_views), *trained]
    found = score_systems(systems, config.training_samples, config.seed, 2, trained[0])
    np.testing.assert_allclose(table["psnr_db"], [x["psnr_db"] for x in found], atol=1e-4)
    assert len(set(table["psnr_db"])) == 3

    # What is done is not done again.
    before = (work / "aperturenet-2" / "run.json").stat().st_mtime_ns
    run_scene_counts(config, ["aperturenet"], [2, 4], 2, 2, work, out)
    assert (work / "aperturenet-2" / "run.json").stat().st_mtime_ns == before


@pytest.mark.parametrize(
    ("names", "counts", "says"),
    [
        (["aperturenet"], [0, 2], "1 or more"),
        (["aperturenet"], [], "1 or more"),
        (["refnet"], [2], "system must be one of"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_trained(
    config, tmp_path, names, counts, says
):
    assert "refnet" in NETWORKS
    with pytest.raises(InputError, match=says):
        run_scene_counts(config, names, counts, 2, 2, tmp_path / "work", tmp_path / "out")
    assert not (tmp_path / "work").exists()
