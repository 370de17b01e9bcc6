"""The law of a camera from targets, against thin lenses of the tests' own."""

from dataclasses import replace

import numpy as np
import pytest
from checkerboards import Bench
from scipy.stats import t

from lf_flame import InputError, LightField
from lf_flame.calibration import CameraLaw, fit_targets, measure_target, read_lens, thin_lens
from lf_flame.calibration.fit import Measurements, fit_law
from lf_flame.calibration.output import _camera_toml, notes
from lf_flame.scenes import read_camera

ZERO = 410.0
"""Distance from the lens to the zero of depths: anywhere."""

DEPTHS = np.array([-30.0, -14.0, 0.0, 12.0, 30.0])
FLAT = [{"depth_mm": 0.0, "tilt_deg": 0.1, "tilt_error_deg": 0.1}]


def measured(rng=None, *, depths=DEPTHS, moved=0.0):
    """Slopes and scales of a thin lens, with noise."""
    distance, errors = depths + ZERO, (2e-4, 3e-5)
    off = np.zeros((2, len(depths))) if rng is None else rng.normal(size=(2, len(depths)))
    return Measurements(
        depths + moved,
        Bench().slope(distance) + off[0] * errors[0],
        np.full(len(depths), errors[0]),
        Bench().scale(distance) + off[1] * errors[1],
        np.full(len(depths), errors[1]),
    )


def fit(*args, **options):
    return fit_law(measured(*args, **options), views=5, lenslets=(44, 52))


def test_the_law_of_a_thin_lens_is_found_exactly():
    law = fit().law
    distance = np.linspace(370, 450, 9)
    assert law.depth_to_slope(distance - ZERO) == pytest.approx(Bench().slope(distance), abs=1e-9)
    assert law.slope_to_depth(Bench().slope(distance)) == pytest.approx(distance - ZERO, abs=1e-6)
    assert law.mm_per_lenslet(distance - ZERO) == pytest.approx(Bench().scale(distance), rel=1e-9)
    assert law.focal_plane_mm == pytest.approx(400 - ZERO, abs=1e-6)
    assert law.focus_distance_mm == pytest.approx(400, abs=1e-6)


def test_slopes_that_fall_with_depth_are_those_of_turned_views():
    """With the views turned round a point moves the other way, and its scale stays."""
    upright = measured()
    turned = fit_law(upright._replace(slopes=-upright.slopes), views=5, lenslets=(44, 52))
    assert "views are stored in reverse" in notes(turned, FLAT)[0]
    assert not notes(fit(), FLAT)
    assert turned.law.slope_to_depth(-Bench().slope(425.0)) == pytest.approx(425.0 - ZERO, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("depths", "moved_mm"), [(DEPTHS, 0), (DEPTHS[::2], 0), (DEPTHS, 0.2)])
def test_stated_errors_of_depth_and_scale_cover_the_truth(depths, moved_mm):
    """In 85 to 90 % of 100 draws of noise and of positions, and not by being far too large."""
    away = []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        found = fit(rng, depths=depths, moved=rng.normal(0, moved_mm, len(depths)))
        depth = found.law.slope_to_depth(Bench().slope(425.0)) - (425.0 - ZERO)
        scale = found.law.mm_per_lenslet(425.0 - ZERO) - Bench().scale(425.0)
        away.append((depth / found.depth_error_mm(15.0), scale / found.scale_error(15.0)))
        assert found.coverage == pytest.approx(t.ppf(0.975, 2 * len(depths) - 4))
    assert np.all(np.mean(np.abs(away) < found.coverage, axis=0) >= (0.85 if moved_mm else 0.9))
    assert np.all(np.std(away, axis=0) > 0.5)


@pytest.mark.slow
def test_from_pictures_with_noise_to_a_depth():
    """Depth within 0.1 % of the distance and scale within 0.05 %."""
    bench = Bench(turn=0.01, pitch_error=0.01, pupil=(0.6, -0.9))
    depths = [-30.0, -10.0, 8.0, 30.0]
    pictures = [bench.picture(z + ZERO, 5.0, noise=0.01, seed=3, fine=4) for z in depths]
    found = fit_targets(depths, [measure_target(one) for one in pictures], square_mm=5.0)
    for distance in (372.0, 400.0, 433.0):
        depth = found.law.slope_to_depth(bench.slope(distance))
        assert depth == pytest.approx(distance - ZERO, abs=0.001 * distance)
        assert abs(depth - (distance - ZERO)) < 4 * found.depth_error_mm(depth)
        size = found.law.mm_per_lenslet(distance - ZERO)
        assert size == pytest.approx(bench.scale(distance), rel=5e-4)


def test_errors_of_the_positions_are_found_and_told():
    moved = np.random.default_rng(5).normal(0, 0.1, 8)
    depths = np.linspace(-30, 30, 8)
    found = fit(np.random.default_rng(1), depths=depths, moved=moved)
    assert 0.05 < found.misfit_mm < 0.2
    assert "positions of the targets" in notes(found, FLAT)[0]
    assert fit(np.random.default_rng(1), depths=depths).misfit_mm == 0


def test_the_thin_lens_of_a_law_is_the_camera_on_the_bench():
    camera = thin_lens(fit().law, 0.1)
    assert camera.main_lens_focal_mm == pytest.approx(50, rel=1e-6)
    assert camera.focus_distance_mm == pytest.approx(400, rel=1e-6)
    assert camera.view_step_mm == pytest.approx(1.7, rel=1e-6)
    # The pupil of five views is 8.5 mm wide: i0 / f of a lenslet less one.
    image = Bench().image
    assert camera.lenslet_focal_mm == pytest.approx(image / (8.5 / 0.1 - 1), rel=1e-6)


@pytest.mark.parametrize("rows", [1.0, 0.75**0.5])
@pytest.mark.parametrize("exit_mm", [40.0, 57.142857, 90.0])
def test_the_exit_pupil_follows_from_where_the_views_meet(exit_mm, rows, tmp_path):
    """The entrance pupil is the stop's other image, by the lens equation written out here."""
    focal, focus, pitch, views, step = 50.0, 400.0, 0.1, 5, 1.7
    image = 1 / (1 / focal - 1 / focus)
    behind = image - exit_mm  # of the exit pupil behind the lens; its object is the entrance pupil
    entrance = 1 / (1 / behind - 1 / focal) if abs(behind) > 1e-6 else 0.0
    distance, seen = focus + entrance, rows * pitch * focus / image  # rows of a hexagonal array
    law = CameraLaw(
        slope_at_infinity=step / seen, slope_mm=-step * distance / seen,
        centre_mm=-distance, scale=seen / distance,
        depth_range_mm=(-50.0, 50.0), views=views, lenslets=(44, 52),
    )  # fmt: skip
    thin = thin_lens(law, pitch, focal_mm=focal, hexagonal=rows < 1)
    (tmp_path / "camera.toml").write_text(_camera_toml(thin, 0.0))
    camera = read_camera(tmp_path / "camera.toml")
    assert camera.exit_pupil_mm == pytest.approx(exit_mm, rel=1e-6)
    assert camera.focus_distance_mm == pytest.approx(focus)
    # A view's part of the exit pupil is a pixel seen from a lenslet, as far away.
    step_behind = step * (behind / entrance if entrance else 1.0)
    width = views * step_behind
    assert camera.lenslet_focal_mm == pytest.approx(pitch * exit_mm / (width - pitch), rel=1e-6)
    depths = np.array([-30.0, 10.0, 40.0])
    assert camera.depth_to_slope(depths) == pytest.approx(law.depth_to_slope(depths), rel=1e-6)


def test_outside_its_range_a_law_gives_no_depth():
    law = fit().law
    assert law.depth_range_mm == pytest.approx((-45, 45))
    with pytest.raises(InputError, match="from -45 to 45 mm"):
        law.depth_to_slope(50.0)
    with pytest.raises(InputError, match="from -45 to 45 mm"):
        law.mm_per_lenslet(-50.0)
    with pytest.raises(InputError, match="from -45 to 45 mm"):
        law.slope_to_depth(law.slope_at_infinity)
    depths = law.slope_to_real_depth(Bench().slope(np.array([300.0, 400.0, 1e9])))
    assert np.isnan(depths).tolist() == [True, False, True]


def test_a_law_survives_its_file_and_is_not_taken_for_a_camera(tmp_path):
    law, path = fit().law, tmp_path / "calibration.toml"
    path.write_text(law.to_toml())
    assert read_lens(path) == law
    with pytest.raises(InputError, match="is a measured calibration"):
        read_camera(path)


@pytest.mark.slow
def test_views_of_unlike_brightness_are_written_and_brought_to_one(tmp_path):
    bench = Bench(views=3, lenslets=(30, 34))
    fall = np.array([[0.8, 0.9, 0.82], [0.9, 1.0, 0.91], [0.3, 0.9, 0.79]])
    depths = [-20.0, 0.0, 20.0]
    boards = [bench.picture(z + ZERO, 4.3, fine=4).views for z in depths]
    shown = [[LightField(one * f[..., None, None]) for one in boards] for f in (fall, fall**0)]
    fits = [
        fit_targets(depths, [measure_target(one) for one in some], square_mm=4.3) for some in shown
    ]
    assert fits[1].law.fall_off is None
    path = tmp_path / "calibration.toml"
    path.write_text(fits[0].law.to_toml())
    law = read_lens(path)
    assert np.array(law.fall_off) == pytest.approx(fall, abs=3e-3)
    even = replace(law, distortion=0.0).corrected(shown[0][1])
    assert even.weights.tolist() == (fall > 0.5).tolist()
    np.testing.assert_allclose(even.views[:2], boards[1][:2], rtol=5e-3)
    assert law.with_views(1).fall_off == ((1.0,),)


@pytest.mark.slow
def test_the_distortion_of_a_lens_is_undone_in_all_views():
    """Then corners and slopes are those of the lens without it, over the whole image."""
    k, depths = 2e-5, [-20.0, 0.0, 20.0]
    bent, straight = Bench(distortion=k, views=3), Bench(views=3)
    pictures = [bent.picture(z + ZERO, 5.0, fine=4) for z in depths]
    law = fit_targets(depths, [measure_target(one) for one in pictures], square_mm=5.0).law
    assert law.distortion == pytest.approx(k, rel=0.05)
    target = measure_target(law.corrected(pictures[2]))
    lattice = target.squares_per_lenslet(None)
    assert abs(lattice.distortion) < 0.05 * k
    assert 5.0 * lattice.scale == pytest.approx(straight.scale(ZERO + 20), rel=5e-4)
    assert target.slope == pytest.approx(straight.slope(ZERO + 20), rel=3e-3)
    whole = pictures[0].views
    cut = LightField(whole[:, :, :-2])
    with pytest.raises(InputError, match="views of 44 x 52 pixels about their centre"):
        law.corrected(cut)
    for folding in (-5e-4, -2e-4, -1.4e-4):  # from -4/27 of 1 / 33.4^2 on
        with pytest.raises(InputError, match="folds the corners"):
            replace(law, distortion=folding).corrected(pictures[0])
    # Colours alike, channel by channel.
    coloured = law.corrected(LightField(np.stack([whole, 2 * whole], axis=-1)))
    grey = law.corrected(pictures[0]).views
    np.testing.assert_allclose(coloured.views, np.stack([grey, 2 * grey], axis=-1), atol=1e-6)
