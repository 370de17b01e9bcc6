"""Slope and scale of a flat target, against pinholes of the tests' own."""

from dataclasses import replace

import numpy as np
import pytest
from checkerboards import Bench

from lf_flame import LightField
from lf_flame.calibration import measure_target
from lf_flame.calibration.corners import find_lattice

BENCH = Bench()
TURNED = Bench(turn=0.01, pitch_error=0.01, pupil=(0.6, -0.9))


@pytest.mark.parametrize("dots", [False, True])
@pytest.mark.parametrize("distance", [375.0, 430.0])
def test_slope_and_scale_of_a_camera_with_all_its_errors(distance, dots):
    """Rotation, pitch error, an off-axis pupil and noise of 1 %; bounds are three times what is."""
    square = 6.5 if dots else 5.0
    picture = TURNED.picture(distance, square, dots=dots, noise=0.01, seed=1)
    target = measure_target(picture, dots=dots)
    slope, error, _ = target.slope_at_centre()
    assert slope == pytest.approx(TURNED.slope(distance), abs=0.002)
    assert abs(slope - TURNED.slope(distance)) < 4 * error
    assert square * target.squares_per_lenslet().scale == pytest.approx(
        TURNED.scale(distance), rel=2e-4
    )


@pytest.mark.slow
def test_stated_errors_cover_the_truth():
    """Within two in at least 85 of 100 draws of noise and pose, and not by being far too large."""
    square = 4.3
    bench = replace(TURNED, lenslets=(30, 34), views=3)
    slopes, scales = [], []
    for seed in range(12):
        turn, distance = np.random.default_rng(seed).uniform([0.0, 405.0], [0.7, 430.0])
        picture = bench.picture(distance, square, turn=turn, noise=0.01, seed=seed, fine=4)
        target = measure_target(picture)
        slope, error, _ = target.slope_at_centre()
        lattice = target.squares_per_lenslet()
        slopes.append((slope - bench.slope(distance)) / error)
        scales.append(
            (square * lattice.scale - bench.scale(distance)) / lattice.scale_error / square
        )
    for found in (slopes, scales):
        assert np.mean(np.abs(found) < 2) >= 0.85
        assert np.std(found) > 0.45


def test_radial_distortion_is_found_and_taken_out_of_slope_and_scale():
    bench = Bench(distortion=2e-5)
    target = measure_target(bench.picture(430.0, 5.0))
    lattice = target.squares_per_lenslet(None)
    assert lattice.distortion == pytest.approx(2e-5, rel=0.03)
    assert 5.0 * lattice.scale == pytest.approx(bench.scale(430.0), rel=3e-4)
    # Without it the slope is low by the mean of 2 k r^2.
    assert target.slope == pytest.approx(bench.slope(430.0) * 0.99, rel=6e-3)
    assert target.slope_at_centre(2e-5)[0] == pytest.approx(bench.slope(430.0), rel=2e-3)


@pytest.mark.slow
def test_a_tilted_target_is_measured_at_the_centre_of_the_image():
    """And its slope changes along the row as the distance does."""
    flat = measure_target(BENCH.picture(430.0, 5.0))
    tilted = measure_target(BENCH.picture(430.0, 5.0, tilt=0.15))
    assert tilted.slope == pytest.approx(BENCH.slope(430.0), abs=0.002)
    gradient = tilted.slope_at_centre()[2]
    # Z changes by tan(tilt) mm per mm across; a lenslet covers scale(Z) there.
    per_mm = BENCH.slope(430.5) - BENCH.slope(429.5)
    assert gradient[1] == pytest.approx(np.tan(0.15) * BENCH.scale(430.0) * per_mm, rel=0.05)
    assert np.abs(flat.slope_at_centre()[2]).max() < 0.1 * abs(gradient[1])


def test_corners_are_where_they_are_on_the_board():
    """Positions from the centre of the image, in mm on the board, lie on its lines."""
    target = measure_target(BENCH.picture(430.0, 5.0, turn=0.1))
    y, x = target.points.T * BENCH.scale(430.0) / 5.0
    down = np.cos(0.1) * y + np.sin(0.1) * x + 0.17
    right = np.cos(0.1) * x - np.sin(0.1) * y + 0.41
    for line in (down, right):
        assert np.abs(line - np.round(line)).max() < 0.02  # a seventh of a lenslet
    steps = np.column_stack([np.round(down), np.round(right)]) - target.indices
    assert np.ptp(steps, axis=0).max() == 0


def test_views_without_weight_do_not_count():
    picture = BENCH.picture(430.0, 5.0)
    weights = np.ones((5, 5))
    weights[0], weights[:, 4] = 0, 0
    spoilt = np.array(picture.views)
    spoilt[weights == 0] = np.random.default_rng(1).uniform(size=spoilt.shape[2:])
    target = measure_target(LightField(spoilt, weights=weights))
    assert target.slope == pytest.approx(BENCH.slope(430.0), abs=0.002)


@pytest.mark.parametrize("turn", [0.0, 0.4, 0.75, 1.3])
def test_lattice_of_a_turned_board_that_the_borders_cut_off(turn):
    picture = Bench(views=1, lenslets=(60, 72)).picture(400.0, 6.0, turn=turn)
    indices, points = find_lattice(picture.views[0, 0])
    assert len({tuple(index) for index in indices}) == len(indices) > 30
    # Neighbours on the lattice are one square apart in the picture: 6 mm.
    design = np.column_stack([indices, np.ones(len(indices))])
    steps, _, _, _ = np.linalg.lstsq(design, points, rcond=None)
    side = 6.0 / BENCH.scale(400.0)
    assert np.hypot(*steps[:2].T) == pytest.approx([side, side], rel=0.02)
    assert abs(steps[0] @ steps[1]) < 0.03 * side**2


def test_a_board_with_a_white_margin_has_only_its_inner_corners():
    y, x = np.indices((50, 58))
    board = ((y // 7 + x // 7) % 2).astype(float)
    board[(y < 7) | (y >= 42) | (x < 7) | (x >= 49)] = 1.0
    indices, _ = find_lattice(board)
    assert [len(np.unique(column)) for column in indices.T] == [4, 5]


@pytest.mark.slow
def test_the_fall_off_of_the_views_is_measured_from_the_board():
    """A fall towards the corners, by views that each see the board alike but darker."""
    steps = np.hypot(*np.mgrid[-2:3, -2:3])
    fall = 1 - 0.06 * steps**2
    light_field = BENCH.picture(425.0, 5.0, noise=0.005)
    darker = LightField(light_field.views * fall[..., None, None])
    assert measure_target(darker).levels == pytest.approx(fall, abs=3e-3)
    assert measure_target(light_field).levels == pytest.approx(1, abs=3e-3)
