import json
from dataclasses import replace

import pytest

from experiments.effects import absolute, report
from experiments.effects.absolute import effect_trials, measure_effect, measure_effects
from experiments.effects.cameras import CAMERAS
from lf_flame import PAPER_CAMERA, plan_effects
from lf_flame.simulation.planning.effects import EFFECTS

SMALL = replace(PAPER_CAMERA, views=3, lenslets=(10, 10))


@pytest.mark.parametrize("camera", CAMERAS)
def test_every_effect_has_a_trial_that_calls_for_it(camera):
    trials = effect_trials(CAMERAS[camera])
    assert list(trials) == list(EFFECTS)
    for name, trial in trials.items():
        assert plan_effects(trial.scene, trial.camera, absolute.TOLERANCE)[name].kept, name


@pytest.mark.slow
@pytest.mark.parametrize("name", ["defocus", "vignetting", "chromatic", "saturation", "read_noise"])
def test_the_library_stands_beside_its_reference(name):
    row = measure_effect(name, "small", effect_trials(SMALL)[name], rays=2**10)
    allowed = 5 * row["reference_error"] + absolute.TOLERANCE
    assert abs(row["difference"]) <= allowed
    assert row["rms_difference"] <= allowed
    assert 0 < row["change"] <= row["bound"]
    assert row["looseness"] == pytest.approx(row["bound"] / row["change"])


def test_the_report_has_a_row_for_each_effect_and_camera(tmp_path, monkeypatch):
    names = ("defocus", "shot_noise", "quantisation")
    some = {name: trial for name, trial in effect_trials(SMALL).items() if name in names}
    monkeypatch.setattr(absolute, "effect_trials", lambda camera: some)
    path = report.write(tmp_path, measure_effects(cameras={"small": SMALL}, rays=2**6))
    text = path.read_text()
    assert all(f"| {name} " in text for name in names)
    record = json.loads((tmp_path / "absolute.json").read_text())
    assert [row["effect"] for row in record["rows"]] == list(names)
    assert record["cameras"]["small"]["views"] == 3
    assert (tmp_path / "absolute.csv").read_text().count("\n") == len(names) + 1
