"""Scenes whose slopes are known, scores, and the record of slope maps beside them."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.ndimage import maximum_filter, minimum_filter

from experiments.slope_maps import measuring, report
from experiments.slope_maps.measuring import measure, score
from experiments.slope_maps.rivals import WAYS
from experiments.slope_maps.scenes import CAMERA, KINDS, NOISE, Kind, make_sample, with_noise
from lf_flame.refocus import refocus_surface

SMALL = replace(CAMERA, lenslets=(48, 64))


def test_the_true_slopes_bring_the_views_together():
    """Truth comes from the geometry, views from the renderer: off by 0.3 they fit worse."""
    sample = make_sample(Kind(3, (0.1, 0.2)), 3, SMALL)
    assert len(np.unique(sample.slopes)) > 2
    inside = maximum_filter(sample.slopes, 9) == minimum_filter(sample.slopes, 9)
    corner = np.zeros((9, 9))
    corner[0, 0] = 1.0
    errors = []
    for off in (0.0, -0.3, 0.3):
        image = refocus_surface(
            sample.views, sample.slopes + off, interpolation="cubic", weights=corner
        )
        errors.append(np.median(np.abs(image - sample.views[4, 4])[inside]))
    assert 1.5 * errors[0] < min(errors[1:])


def test_scenes_are_the_same_each_time_and_noise_is_as_stated():
    kind = KINDS["faint"]
    one, same, other = (make_sample(kind, seed, SMALL) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.views, same.views)
    assert np.any(one.slopes != other.slopes)
    noisy = with_noise(one, NOISE, 1)
    np.testing.assert_array_equal(noisy.views * 255, np.rint(noisy.views * 255))
    assert (noisy.views - one.views).std() == pytest.approx(NOISE, rel=0.03)


def test_scores_of_a_map_with_known_errors():
    truth = np.zeros((10, 10))
    slope, certain = truth.copy(), np.zeros((10, 10), bool)
    slope[0], slope[1] = 0.2, -0.06  # ten wrong, ten off by less than counts
    certain[:2, :5] = certain[2] = True
    assert score(slope, certain, truth) == pytest.approx({
        "mse_x100": 10 * 0.2**2 + 10 * 0.06**2,
        "wrong_percent": 10.0,
        "certain_percent": 20.0,
        "wrong_of_certain_percent": 25.0,
    })  # fmt: skip
    assert np.isnan(score(slope, np.zeros((10, 10), bool), truth)["wrong_of_certain_percent"])


@pytest.mark.slow
def test_the_record_has_a_row_for_each_map_and_scene(tmp_path):
    kinds = {"textured": KINDS["textured"]}
    record, sample = measure(kinds=kinds, seeds=(1,), camera=SMALL)
    table = pd.DataFrame(record["rows"])
    assert len(table) == 3 * len(WAYS)
    assert set(table["map"]) == set(WAYS)
    path = report.write(tmp_path, record, sample)
    assert all(f"| {name} " in path.read_text() for name in WAYS)
    made = json.loads((tmp_path / "slope_maps.json").read_text())
    assert made["seeds"] == [1]
    assert len(made["rows"]) == len(table)
    assert (tmp_path / "slope_maps.png").stat().st_size > 1000
    ours = table[(table["map"] == "library") & (table["noise"] == "0")].iloc[0]
    theirs = table[(table["map"] == "all views") & (table["noise"] == "0")].iloc[0]
    assert ours["wrong_percent"] < theirs["wrong_percent"]
    assert measuring.WRONG == 0.07
