"""Scenes whose slopes are known, scores, and the record of slope maps beside them."""

import json

import numpy as np
import pandas as pd
import pytest
from scipy.ndimage import map_coordinates, maximum_filter, minimum_filter

from experiments.slope_maps import scenes, tabletop
from experiments.slope_maps.measuring import METHODS, measure, score, write
from experiments.slope_maps.scenes import Kind, Surface, curved, make_sample, planes

PICTURE = np.add.outer(np.sin(np.arange(200) / 3), np.cos(np.arange(180) / 4)) / 4 + 0.5


@pytest.fixture(autouse=True)
def small(monkeypatch):
    monkeypatch.setattr(scenes, "SIZE", (48, 64))


@pytest.mark.parametrize("draw", [planes, curved])
def test_views_moved_by_the_true_slopes_are_the_central_view(draw):
    """What a corner view shows at p + d(p) (v, u), read here by SciPy, away from outlines."""
    views, slopes = make_sample(Kind(draw, views=3, noise=0.0), 3, [PICTURE])
    inside = maximum_filter(slopes, 9) - minimum_filter(slopes, 9) < 0.15
    inside[[0, 1, 2, -3, -2, -1]] = inside[:, [0, 1, 2, -3, -2, -1]] = False
    t, s = np.indices(slopes.shape)
    middle, corner = (views[n, n].astype(float) for n in (1, 2))
    errors = [
        np.median(np.abs(map_coordinates(corner, [t + d, s + d], order=3) - middle)[inside])
        for d in (slopes, slopes + 0.1, -slopes)
    ]
    assert inside.mean() > 0.3
    assert errors[0] < 0.5 < 2 * errors[0] + 0.5 < min(errors[1:])


@pytest.mark.parametrize("bumps", [(), [(0.3, 5.0, -4.0, 60.0)]])
def test_a_place_is_seen_where_its_slope_moves_it(bumps):
    surface = Surface(PICTURE, 0.7, gradient=(0.02, -0.03), bumps=bumps)
    y, x = np.mgrid[-20:20:5, -30:30:5].astype(float)
    places = surface.places(y, x, 2.0, -1.0)
    np.testing.assert_allclose(places[0] + 2 * surface.slope(*places), y, atol=1e-4)
    np.testing.assert_allclose(places[1] - surface.slope(*places), x, atol=1e-4)


def test_the_nearest_surface_is_seen():
    """A bright bar at slope -1 before a dark wall at 1, in the central view and one step aside."""
    wall = Surface(np.full((9, 9), 0.2), 1.0)
    bar = Surface(np.full((9, 9), 0.8), -1.0, shape=("bar", 0.0, 0.0, 5.0, 8.0, 0.0))
    truth = np.full((48, 64), 1.0)
    truth[19:29, 24:40] = -1.0
    np.testing.assert_array_equal(scenes.true_slopes([bar, wall]), truth)
    aside = scenes.render_view([bar, wall], 0.0, 1.0)
    assert aside[19:29, 23:39] == pytest.approx(0.8)
    assert aside.sum() == pytest.approx(0.2 * 48 * 64 + 0.6 * 160)


@pytest.mark.slow
def test_a_table_top_moves_by_its_true_slopes(monkeypatch):
    """The right view at p + d(p) shows what the central one shows at p, away from outlines."""
    monkeypatch.setattr(tabletop, "SIZE", (36, 48))
    monkeypatch.setattr(tabletop, "LENGTH", 62.0)
    views, slopes = tabletop.make_tabletop(3, views=3)
    inside = maximum_filter(slopes, 7) - minimum_filter(slopes, 7) < 0.2
    inside[[0, 1, 2, -3, -2, -1]] = inside[:, [0, 1, 2, -3, -2, -1]] = False
    t, s = np.indices(slopes.shape)
    middle, corner = (views[n, n].astype(float) for n in (1, 2))
    right, wrong = (
        np.mean(np.abs(map_coordinates(corner, [t + d, s + d], order=1) - middle)[inside])
        for d in (slopes, -slopes)
    )
    assert inside.mean() > 0.2
    assert right < 0.6 * wrong


def test_scores_of_a_map_with_known_errors():
    truth = np.zeros((10, 10))
    slope, confidence = truth.copy(), np.zeros((10, 10))
    slope[0], slope[1] = 0.2, -0.06  # ten off by more than 0.07, twenty by more than 0.03
    confidence[:2, :5] = confidence[2] = 0.9
    confidence[3:6] = 0.1
    assert score(slope, confidence, truth) == pytest.approx({
        "bad_07": 10.0,
        "bad_03": 20.0,
        "bad_01": 20.0,
        "mse_x100": 10 * 0.2**2 + 10 * 0.06**2,
        "certain_percent": 20.0,
        "bad_07_of_certain": 25.0,
        "bad_07_of_half": 10.0,
    })  # fmt: skip
    assert np.isnan(score(slope, 0 * truth, truth)["bad_07_of_certain"])
    assert np.isnan(score(slope, confidence, np.nan * truth)["bad_07"])


@pytest.mark.slow
def test_the_record_has_a_row_for_each_map_and_scene(tmp_path):
    kinds = {"slanted planes": Kind(planes, views=7)}
    record, shown = measure(tmp_path, tables=(), kinds=kinds, seeds=(1,))
    table = pd.DataFrame(record["rows"])
    assert len(table) == len(METHODS)
    path = write(tmp_path, record, shown)
    assert all(f"| {name} " in path.read_text() for name in METHODS)
    assert len(json.loads((tmp_path / "slope_maps.json").read_text())["rows"]) == len(table)
    assert (tmp_path / "slope_maps.png").stat().st_size > 1000
    bad = table.set_index("map")["bad_07"]
    assert bad["library"] < bad.drop("library").min()
