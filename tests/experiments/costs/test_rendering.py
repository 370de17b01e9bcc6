import json
import math
from dataclasses import replace

import numba
import numpy as np
import pandas as pd
import pytest
from matplotlib.image import imread

from experiments import timing
from experiments.costs import rendering, rendering_report
from experiments.costs.integration_methods import METHODS
from experiments.costs.rendering import measure_costs
from experiments.costs.rendering_scenes import Study, study_scenes
from experiments.effects.effects import effect_trials
from experiments.paths import DATA_SETS
from lf_flame import PAPER_CAMERA, InputError, Layer, Scene
from lf_flame.simulation.rendering import render

pytestmark = [pytest.mark.jit, pytest.mark.slow]

CAMERA = replace(PAPER_CAMERA, views=3, lenslets=(12, 14))
TRIALS = {
    name: trial
    for name, trial in effect_trials(replace(CAMERA, views=6)).items()
    if name in ("defocus", "cos4", "shot_noise")
}
"""Some effects, which all are like; `tests/experiments/effects` has a trial of each."""

FEW_RAYS = {name: replace(method, settings=method.settings[:6]) for name, method in METHODS.items()}


def small_studies():
    rng = np.random.default_rng(4)
    flat = Layer(rng.uniform(0.2, 1, (5, 6)), 20.0, (1.2, 1.4))
    card = Layer([[0.0]], -10.0, (0.5, 0.6), (0.1, 0.1), opaque=True)
    return [
        Study("open", "a layer", Scene([flat]), CAMERA),
        Study("hidden", "a layer behind a card", Scene([flat, card]), CAMERA),
    ]


@pytest.fixture(scope="module")
def measured(tmp_path_factory, coarse_data):
    out = tmp_path_factory.mktemp("costs")
    patch = pytest.MonkeyPatch()
    patch.setattr(timing, "SHORT_S", 0.0)
    patch.setattr(timing, "ROUNDS", 1)
    patch.setattr(rendering, "METHODS", FEW_RAYS)
    patch.setattr(rendering, "WHOLE", rendering.WHOLE[:2])
    threads = numba.get_num_threads()
    record = measure_costs(1e9, small_studies(), TRIALS, coarse_data[:1])
    rendering_report.write_reports(out, record)
    patch.undo()
    assert numba.get_num_threads() == threads
    return out, record


def curve(record, scene, method):
    rows = [r for r in record["accuracy"] if (r["scene"], r["method"]) == (scene, method)]
    return pd.DataFrame(rows)


def test_all_files_are_there(measured):
    out, record = measured
    written = {
        "accuracy.csv", "effects.csv", "costs.md", "costs.json", "costs.png", "light_field.md",
        "light_field.json",
    }  # fmt: skip
    assert {path.name for path in out.iterdir()} == written
    pixels = imread(out / "costs.png")[..., :3]
    assert min(pixels.shape[:2]) > 300
    assert 0.005 < np.mean(pixels < 0.9) < 0.5  # neither empty nor covered
    text = (out / "costs.json").read_text()
    stored = json.loads(text, parse_constant=pytest.fail)
    assert stored["accuracy"] == record["accuracy"]
    assert len(pd.read_csv(out / "accuracy.csv")) == len(record["accuracy"])
    report = (out / "costs.md").read_text()
    for words in (stored["command"], stored["machine"], "numba", "finite-width rays", "shot_noise"):
        assert words in report
    assert "nan" not in report


@pytest.mark.parametrize("scene", ["open", "hidden"])
@pytest.mark.parametrize("method", ["midpoint", "thin"])
def test_errors_fall_with_the_rays(measured, scene, method):
    points = curve(measured[1], scene, method)
    assert len(points) >= 4
    assert points["rays_per_pixel"].is_monotonic_increasing
    errors = points["error"].to_numpy()
    assert errors[-1] < 0.25 * errors[0]
    assert (points["seconds"] > 0).all()


def test_the_exact_integrator_is_at_rounding(measured):
    for scene in ("open", "hidden"):
        (error,) = curve(measured[1], scene, "exact")["error"]
        assert error < 3e-8


def test_effects_change_the_image_by_no_more_than_their_bound(measured):
    lines = pd.read_csv(measured[0] / "effects.csv")
    assert list(lines["effect"]) == list(TRIALS)
    assert (lines["error_rms"] > 0).all()
    noise = lines["effect"].str.endswith("noise")
    change = lines["error_max"].where(~noise, lines["error_rms"])
    assert (change <= lines["bound"] + 2e-3).all()  # besides the error of rays
    np.testing.assert_allclose(
        lines["seconds_added"], lines["seconds_on"] - lines["seconds_off"], atol=1e-12
    )


def test_the_study_keeps_the_optics_and_frames_all_light():
    studies = study_scenes(*DATA_SETS)
    assert [study.name for study in studies] == ["shapes", "flame", "hidden"]
    for study in studies:
        assert study.camera.pixel_mm == pytest.approx(0.112 * (1 + 0.4 / 277.84) / 15, rel=1e-4)
        assert study.camera.aperture_mm == pytest.approx(77.8, abs=0.1)
        views = render(study.scene, study.camera, effects={"occlusion": False}).views
        assert views.max() > 0.5
        assert max(np.abs(views[:, :, i]).max() for i in (0, -1)) < 1e-6
        assert max(np.abs(views[..., i]).max() for i in (0, -1)) < 1e-6


def test_seconds_are_read_off_between_settings():
    per_pixel = np.array([1.0, 4, 16, 64])
    points = pd.DataFrame(
        {"rays_per_pixel": per_pixel, "seconds": per_pixel / 10, "error": 0.5 * per_pixel**-0.5}
    )
    assert rendering_report.measured_exponent(points) == pytest.approx(0.5)
    assert rendering_report.seconds_for(points, 0.1) == (pytest.approx(2.5), "")
    assert rendering_report.seconds_for(points, 0.9) == (0.1, "<")
    assert rendering_report.seconds_for(points, 0.01) == (pytest.approx(250), "~")
    flat = points.assign(error=0.3)
    assert math.isnan(rendering_report.seconds_for(flat, 0.1)[0])
    assert math.isnan(rendering_report.measured_exponent(points[:1]))


def test_all_methods_have_a_label_and_a_style():
    assert set(METHODS) == set(rendering_report.STYLES)
    assert sum(method.share for method in METHODS.values()) == pytest.approx(1)


def test_configurations_that_are_missing_are_named(tmp_path):
    with pytest.raises(InputError, match=r"none\.toml cannot be read"):
        study_scenes(tmp_path / "none.toml", tmp_path / "none.toml")
