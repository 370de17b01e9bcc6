import json
from dataclasses import replace

import pytest

from experiments.effects import bounds, effects
from experiments.effects.effects import CAMERAS, effect_trials, run_effects
from lf_flame import PAPER_CAMERA, plan_effects
from lf_flame.simulation.planning.effects import EFFECTS

SMALL = replace(PAPER_CAMERA, views=3, lenslets=(10, 10))


@pytest.mark.slow
@pytest.mark.parametrize("camera", CAMERAS)
def test_every_effect_has_a_trial_that_calls_for_it(camera):
    trials = effect_trials(CAMERAS[camera])
    assert list(trials) == list(EFFECTS)
    for name, trial in trials.items():
        assert plan_effects(*trial, effects.TOLERANCE)[name].kept, name


@pytest.mark.slow
@pytest.mark.parametrize("scene", [161, 727, 909])
def test_no_change_exceeds_its_bound(scene, monkeypatch):
    """Scenes, among a thousand, in which a bound seemed to be broken."""
    monkeypatch.setattr(bounds, "RAY_COUNTS", (6, 12))
    rows = bounds.measure_scene(0, scene)
    assert len(rows) >= 3
    for row in rows:
        assert 0 <= row["change"] <= row["bound"] + row["error"] + bounds.ROUNDING


def test_the_report_has_all_effects_and_counts_violations(tmp_path, monkeypatch):
    some = {name: effect_trials(SMALL)[name] for name in ("defocus", "shot_noise", "quantisation")}
    changes = [0.1, 0.11, 0.0]  # the second is above its bound

    class Here:
        """Instead of processes, which take seconds each."""

        def __init__(self, **_):
            pass

        __enter__ = lambda self: self
        __exit__ = lambda *_: None

        def map(self, _, numbers):
            lines = [(n, "cos4", b, changes[n], 0.001) for n, b in enumerate((0.2, 0.1, 0.1))]
            names = ("scene", "effect", "bound", "change", "error")
            return [[dict(zip(names, lines[n], strict=True))] if n < 3 else None for n in numbers]

    monkeypatch.setattr(bounds, "ProcessPoolExecutor", Here)
    monkeypatch.setattr(effects, "CAMERAS", {"small": SMALL})
    monkeypatch.setattr(effects, "effect_trials", lambda camera: some)
    text = run_effects(tmp_path, scenes=4, rays=2**6).read_text()
    assert all(f"| {name} " in text for name in some)
    record = json.loads((tmp_path / "effects.json").read_text())
    assert [row["effect"] for row in record["rows"]] == list(some)
    (row,), found = record["bounds"]["rows"], record["bounds"]
    assert (row["scenes"], row["violations"], found["refused"], found["scenes"]) == (3, 1, 1, 4)
    assert (row["smallest"], row["largest"]) == pytest.approx((0.1 / 0.11, 2))
    assert [line["scene"] for line in found["violations"]] == [1]
    assert (tmp_path / "effects.csv").read_text().count("\n") == 1 + len(some)
    assert (tmp_path / "effects.png").stat().st_size > 1000
