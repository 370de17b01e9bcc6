"""The program `lf-flame calibrate`: from pictures of a target to files that give mm."""

import json
import re

import numpy as np
import pytest
from checkerboards import Bench
from programs import run
from skimage.io import imread

from lf_flame import write_light_field
from lf_flame.calibration import fit_targets, measure_target, read_lens
from lf_flame.calibration.output import notes, target_facts
from lf_flame.scenes import read_camera

BENCH = Bench(views=3, lenslets=(36, 44))
ZERO = 410.0
DEPTHS = (-25.0, -8.0, 6.0, 25.0)


@pytest.fixture(scope="module")
def boards(tmp_path_factory):
    """Pictures of a checkerboard at four depths, and what `calibrate` makes of them."""
    folder = tmp_path_factory.mktemp("boards")
    placed = []
    for depth in DEPTHS:
        path = folder / f"b{depth:g}.npz"
        write_light_field(BENCH.picture(depth + ZERO, 5.0, noise=0.005, seed=2, fine=4), path)
        placed.append(f"{path}@{depth:g}")
    out = folder / "out"
    done = run("calibrate", *placed, "--square-mm", 5, "--lenslet-mm", 0.1, "--out", out)
    assert done.exit_code == 0, done.output
    return placed, out, done.output


@pytest.mark.slow
def test_tilt_is_told_with_the_error_of_lengths_that_it_makes():
    """Squares shrink by cos(tilt) along one axis, and in the mean of both by its root."""
    tilted = [BENCH.picture(z + ZERO, 5.0, tilt=np.radians(20), fine=4) for z in DEPTHS]
    targets = [measure_target(one) for one in tilted]
    fit = fit_targets(DEPTHS, targets, square_mm=5.0)
    too_large = np.cos(np.radians(20)) ** -0.5 - 1
    assert fit.law.mm_per_lenslet(0.0) == pytest.approx(
        (1 + too_large) * BENCH.scale(ZERO), rel=1e-3
    )
    (said,) = (one for one in notes(fit, target_facts(fit, targets)) if "tilted" in one)
    degrees, error = re.search(r"by ([0-9.]+) degrees.* are ([0-9.]+) % too large", said).groups()
    assert float(degrees) == pytest.approx(20, abs=1)
    assert float(error) == pytest.approx(100 * too_large, abs=0.3)


@pytest.mark.slow
def test_files_and_table_of_a_calibration(boards):
    placed, out, said = boards
    law = read_lens(out / "calibration.toml")
    assert law.depth_to_slope(0.0) == pytest.approx(BENCH.slope(ZERO), abs=1e-3)
    assert law.mm_per_lenslet(0.0) == pytest.approx(BENCH.scale(ZERO), rel=3e-4)
    camera = read_camera(out / "camera.toml")
    assert camera.main_lens_focal_mm == pytest.approx(50, rel=0.01)
    assert camera.focus_distance_mm == pytest.approx(400, rel=0.01)
    assert read_lens(out / "calibration.json") == law
    record = json.loads((out / "calibration.json").read_text())
    assert record["files"] == ["calibration.png", "calibration.toml", "camera.toml"]
    assert [one["depth_mm"] for one in record["targets"]] == list(DEPTHS)
    assert max(abs(one["depth_residual_mm"]) for one in record["targets"]) < 1.0
    assert record["targets"][0]["slope"] == pytest.approx(BENCH.slope(ZERO - 25), abs=2e-3)
    assert "focal plane at z = -10.0" in said or "focal plane at z = -9.9" in said


@pytest.mark.slow
def test_a_picture_is_refocused_at_a_depth_by_the_calibration(boards, tmp_path):
    """And its slope map becomes mm from the user's zero."""
    placed, out, _ = boards
    source, law = placed[0].rpartition("@")[0], out / "calibration.toml"
    words = ("--camera", law, "--depth-mm", -25, "--map", -0.3, 0.1)
    done = run("refocus", source, *words, "--out", tmp_path / "r")
    assert done.exit_code == 0, done.output
    record = json.loads((tmp_path / "r" / "refocus.json").read_text())
    assert record["slopes"][0] == pytest.approx(BENCH.slope(ZERO - 25), abs=2e-3)
    depths, slopes = (imread(tmp_path / "r" / f"{name}_map.tif") for name in ("depth", "slope"))
    near, far = BENCH.slope(ZERO - 37.5), BENCH.slope(ZERO + 37.5)
    known = (slopes > near + 2e-3) & (slopes < far - 2e-3)
    assert BENCH.slope(ZERO + depths[known]) == pytest.approx(slopes[known], abs=2e-3)
    assert known.mean() > 0.5
    assert np.isnan(depths[(slopes < near - 2e-3) | (slopes > far + 2e-3)]).all()


@pytest.mark.slow
def test_targets_at_equal_steps_tell_their_distance(boards, tmp_path):
    """The views meet as far before the first as the lens is, within the stated error."""
    folder = tmp_path / "steps"
    folder.mkdir()
    for number, distance in enumerate((380.0, 400.0, 420.0, 440.0)):
        picture = BENCH.picture(distance, 5.0, noise=0.005, seed=number, fine=4)
        write_light_field(picture, folder / f"b{number}.npz")
    words = ("--square-mm", 5, "--step-mm", 20, "--out", tmp_path / "out")
    done = run("calibrate", *sorted(folder.iterdir()), *words)
    assert done.exit_code == 0, done.output
    law = read_lens(tmp_path / "out" / "calibration.toml")
    error = 3 * law.standard_deviations["centre_mm"]
    assert law.centre_mm == pytest.approx(-380, abs=error)
    assert error < 6
    assert f"views meet at z = {law.centre_mm:.2f} +-" in done.output
    assert law.depth_to_slope(30.0) == pytest.approx(BENCH.slope(410.0), abs=1e-3)


@pytest.mark.slow
def test_a_file_and_a_calibration_say_what_mm_they_give(boards, tmp_path):
    placed, out, _ = boards
    source, law = placed[0].rpartition("@")[0], out / "calibration.toml"
    done = run("info", source, "--camera", law)
    assert done.exit_code == 0, done.output
    said = {line[2:16].strip(): line[16:] for line in done.output.splitlines()}
    assert said["focal plane"].startswith("at -10")
    assert float(said["pixel there"].split()[0]) == pytest.approx(BENCH.scale(400), rel=1e-3)
    # Two view steps move a point by a lenslet at slopes of a half: 1/Z = 1/400 -+ slope / B.
    per_slope = BENCH.pitch / BENCH.image / BENCH.step
    near, far = (1 / (1 / 400 + sign * per_slope / 2) - ZERO for sign in (1, -1))
    assert near < -37.5 < 37.5 < far
    assert "beyond the targets (-37.5 mm) to beyond the targets (37.5 mm)" in said["in focus"]
    angle = 3 * BENCH.step / 400
    assert f"over {2 * BENCH.scale(400) / angle:.2g} mm of depth" in said["depth"]
    camera = out / "camera.toml"
    (near, far) = (depth - (400 - ZERO) for depth in (near, far))
    assert f"{near:.2g}"[:3] in run("info", source, "--camera", camera).output
