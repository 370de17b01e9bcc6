import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from experiments import timing
from experiments.costs import rendering
from experiments.costs.rendering import METHODS, Study, measure_costs
from experiments.effects.effects import effect_trials
from lf_flame import PAPER_CAMERA, Layer, Scene

pytestmark = [pytest.mark.jit, pytest.mark.slow]

CAMERA = replace(PAPER_CAMERA, views=3, lenslets=(12, 14))
TRIALS = {
    name: trial
    for name, trial in effect_trials(replace(CAMERA, views=6)).items()
    if name in ("defocus", "cos4", "shot_noise")
}

FEW_RAYS = {name: replace(method, rays=method.rays[:6]) for name, method in METHODS.items()}


def small_studies():
    rng = np.random.default_rng(4)
    flat = Layer(rng.uniform(0.2, 1, (5, 6)), 20.0, (1.2, 1.4))
    card = Layer([[0.0]], -10.0, (0.5, 0.6), (0.1, 0.1), opaque=True)
    return [
        Study("open", "a layer", Scene([flat]), CAMERA),
        Study("hidden", "a layer behind a card", Scene([flat, card]), CAMERA),
    ]


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    out = tmp_path_factory.mktemp("costs")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(timing, "SHORT_S", 0.0)
        patch.setattr(timing, "ROUNDS", 1)
        patch.setattr(rendering, "METHODS", FEW_RAYS)
        record = measure_costs(1e9, small_studies(), TRIALS)
    rendering.write(out, record)
    return out, record


@pytest.mark.parametrize("scene", ["open", "hidden"])
def test_errors_fall_with_the_rays_to_the_closed_form(measured, scene):
    rows = pd.DataFrame(measured[1]["accuracy"])
    errors = {
        name: rows.loc[(rows["scene"] == scene) & (rows["method"] == name), "error"].to_numpy()
        for name in METHODS
    }
    if scene == "open":
        assert errors["exact"] < 3e-8
    for name in ("random", "thin"):
        assert errors[name][-1] < 0.3 * errors[name][0], name
    np.testing.assert_allclose(errors["random"][1:] / errors["random"][:-1], 0.5, rtol=0.25)


def test_effects_change_the_image_by_no_more_than_their_bound(measured):
    lines = pd.read_csv(measured[0] / "effects.csv")
    assert list(lines["effect"]) == list(TRIALS)
    assert (lines["error_rms"] > 0).all()
    noise = lines["effect"].str.endswith("noise")
    change = lines["error_max"].where(~noise, lines["error_rms"])
    assert (change <= lines["bound"] + 2e-3).all()  # besides the error of rays
    added = lines["seconds_on"] - lines["seconds_off"]
    np.testing.assert_allclose(lines["seconds_added"], added, atol=1e-12)


def test_seconds_are_read_off_between_settings():
    rays = np.array([1.0, 4, 16, 64])
    points = pd.DataFrame({"seconds": rays / 10, "error": 0.5 * rays**-0.5})
    assert rendering.seconds_for(points, 0.1) == "2.5 s"
    assert rendering.seconds_for(points, 0.9) == "<0.1 s"
    assert rendering.seconds_for(points, 0.01) == "not reached"
    assert math.isclose(sum(method.share for method in METHODS.values()), 1)
