"""Videos of light fields: what the steps find, gaps, and runs that were cut."""

import pickle
import re
from concurrent.futures import Executor, Future
from functools import partial

import numpy as np
import pytest
import zarr
from programs import run

from lf_flame import InputError, LightField, PlenopticCamera
from lf_flame.flame_video import find_steps, process_frames, processing
from lf_flame.flame_video.frames import write_flicker
from lf_flame.flame_video.steps import Frame
from lf_flame.refocus import shift_and_sum
from lf_flame.tomography import FrustumGrid, reconstruct

ROWS, COLUMNS, SLOPE = 24, 20, 1
TOPS = (5, 7, 6, 9, 8, 4)
CAMERA = PlenopticCamera(
    main_lens_focal_mm=150.0, focus_distance_mm=326.0, lenslet_focal_mm=0.4,
    lenslet_pitch_mm=0.112, views=3, lenslets=(ROWS, COLUMNS),
)  # fmt: skip
DEPTHS = (float(CAMERA.slope_to_depth(SLOPE)), 0.0)


def bar(top, rows=ROWS):
    """Views of a column of light from row `top` to 17, which moves by a pixel from view to view."""
    v, u, t, s = np.ogrid[-1:2, -1:2, :rows, :COLUMNS]
    y, x = t - SLOPE * v, s - SLOPE * u
    return ((y >= top) & (y < 18) & (x >= 7) & (x < 12)).astype(np.float32)


@pytest.fixture
def video(tmp_path):
    """Frames 1 to 7: the third is missing, the fifth damaged, the seventh of another size."""
    folder = tmp_path / "video"
    folder.mkdir()
    for number, top in zip((1, 2, 4, 6), TOPS, strict=False):
        np.save(folder / f"frame{number}.npy", bar(top))
    (folder / "frame5.npy").write_bytes((folder / "frame1.npy").read_bytes()[:300])
    np.save(folder / "frame7.npy", bar(5, rows=30))
    return folder


def files(folder):
    """Bytes of all files but the attributes, which hold a date."""
    found = {str(x.relative_to(folder)): x for x in folder.rglob("*") if x.is_file()}
    return {name: x.read_bytes() for name, x in found.items() if name != "zarr.json"}


@pytest.mark.slow
def test_heights_contours_and_gaps_with_named_axes(video, tmp_path):
    xarray = pytest.importorskip("xarray")
    out = tmp_path / "out.zarr"
    words = ["--frames-per-second", 100, "--workers", 1, "--out", out]
    done = run("process", video, "--steps", "refocus@1,height", *words)
    assert done.exit_code == 0, done.output
    assert "7 frames: 4 whole, 1 missing, 2 unusable" in done.output
    for said in ("frame 2 is missing", "frame5.npy cannot be read", "frame7.npy: it has the shape"):
        assert said in done.output
    found = xarray.open_zarr(out, consolidated=False, decode_times=False)
    sound = [0, 1, 3, 5]
    assert found["time"].values == pytest.approx(np.arange(7) / 100)
    assert found["refocus_1"].dims == ("time", "y", "x")
    # The level of a half lies midway between rows, above the first that is lit.
    truth = np.full(7, np.nan)
    truth[sound] = ROWS - np.array(TOPS[:4])
    assert found["height"].values == pytest.approx(truth, abs=1e-5, nan_ok=True)
    assert found["width"].values[sound] == pytest.approx(5, abs=1e-5)
    assert found["refocus_1"][3].values == pytest.approx(bar(TOPS[2])[1, 1], abs=1e-6)
    rows, columns = found["contour"].values[3].T
    assert (rows.min(), rows.max()) == pytest.approx((TOPS[2] - 0.5, 17.5), abs=0.2)
    assert (columns.min(), columns.max()) == pytest.approx((6.5, 11.5), abs=0.2)
    assert np.isnan(found["contour"].values[[2, 4, 6]]).all()
    assert np.isnan(found["refocus_1"].values[[2, 4, 6]]).all()
    assert found["state"].values.tolist() == [1, 1, 2, 1, 3, 1, 3]
    again = run("process", video, "--steps", "refocus@1,height", *words).output
    assert re.search("7 frames: 4 whole.*; made before, remove it", again)


@pytest.fixture
def two_together(monkeypatch):
    """Tasks of two frames each."""
    monkeypatch.setattr("lf_flame.flame_video.processing.LEAST_TOGETHER", 2)


@pytest.mark.slow
def test_a_run_that_was_cut_goes_on_to_the_same_bytes(tmp_path, two_together):
    paths = [tmp_path / f"{number}.npy" for number in range(6)]
    for number, path in enumerate(paths):
        np.save(path, bar(4 + number % 6))
    process = partial(process_frames, paths, times_s=np.arange(6) / 50)
    steps = find_steps("refocus@1,height")
    process(tmp_path / "whole", steps)

    def cut(done):
        if done.frame == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        process(tmp_path / "cut", steps, on_frame=cut)
    begun = zarr.open_group(tmp_path / "cut.part", mode="r")
    assert begun["state"][:].tolist() == [1, 1, 1, 1, 0, 0]
    with pytest.raises(InputError, match=r"cut\.part was made with other steps; remove it"):
        process(tmp_path / "cut", find_steps("refocus@0,height"))
    times = []
    process(tmp_path / "cut", steps, on_frame=lambda done: times.append(done.frame))
    assert times == [4, 5]
    assert files(tmp_path / "cut") == files(tmp_path / "whole")
    (tmp_path / "other").mkdir()
    for path in paths:
        np.save(tmp_path / "other" / path.name, bar(3))
    other = [tmp_path / "other" / path.name for path in paths]
    with pytest.raises(InputError, match=r"with other folders; .* back to \['\.\.'\], relative"):
        process_frames(other, tmp_path / "cut", steps, times_s=np.arange(6) / 50)


class Processes(Executor):
    """Carries out each task as a process of its own would: unpacked, on one thread, anew."""

    def submit(self, call, task):
        processing._load.cache_clear()
        done = Future()
        done.set_result(call(pickle.loads(pickle.dumps(task))))
        return done


@pytest.mark.slow
def test_processes_make_the_same_bytes(tmp_path, two_together):
    """The second of two tasks begins anew in the same process too; depths may be whole numbers."""
    paths = [tmp_path / f"{number}.npy" for number in range(4)]
    for number, path in enumerate(paths):
        np.save(path, bar(4 + number % 6))
    emission = {"camera": CAMERA, "depths_mm": [5, 0], "noise": 0.01, "strength": 0.1}
    steps = find_steps("refocus@1,height,emission", **emission)
    for name, executor in (("by one", None), ("by two", Processes())):
        process_frames(paths, tmp_path / name, steps, times_s=range(4), executor=executor)
    assert files(tmp_path / "by one") == files(tmp_path / "by two")
    assert repr(CAMERA) in repr(steps[-1])


def test_lengths_and_names_are_those_of_the_last_refocusing():
    steps = find_steps("refocus@10mm,refocus@-0.1234567,refocus@-0.1234568,height", camera=CAMERA)
    found = Frame(LightField(bar(5))).take(steps)
    assert [*found][:3] == ["refocus_10mm", "refocus_-0.1234567", "refocus_-0.1234568"]
    assert found["height"].attributes["units"] == "px"


def test_what_is_unknown_or_missing_is_left_out_or_refused(caplog):
    """Of frames, what refocusing warns of is kept: it is not said for each."""
    views, valid = bar(5), np.ones((3, 3, ROWS, COLUMNS), bool)
    views[1, 1, 8, 9], valid[1, 1, 8, 9] = 5, False
    frame = Frame(LightField(views, valid=valid))
    found = frame.take(find_steps("refocus@1"))["refocus_1"].values
    assert not caplog.text
    assert "lower bounds" in frame.warnings[0]
    np.testing.assert_array_equal(found, shift_and_sum(frame.light_field, 1.0))
    weights = np.arange(9).reshape(3, 3) != 4
    with pytest.raises(InputError, match="height without refocusing needs the view in row 1"):
        Frame(LightField(bar(5), weights=weights)).take(find_steps("height"))


@pytest.fixture
def made(tmp_path):
    np.save(tmp_path / "0.npy", bar(5))
    out = tmp_path / "made"
    process_frames([tmp_path / "0.npy"], out, find_steps("refocus@1,height"), times_s=[0.0])
    return out


@pytest.mark.slow
def test_emission_of_a_frame_is_that_of_its_light_field_alone():
    """A background of 0.2 is fitted; the second frame starts from the first."""
    camera, depths = CAMERA, DEPTHS
    options = {"noise": 0.01, "strength": 0.1, "background": "fit"}
    (step,) = find_steps("emission", camera=camera, depths_mm=depths, **options)
    before, noise = {}, 0.01 * np.random.default_rng(1).standard_normal((3, 3, ROWS, COLUMNS))
    grid = FrustumGrid(camera, depths)
    corners = np.eye(3)[::-1] < 1  # two views are missing, so that no fit before is a start
    for top, limit, weights in ((8, 0.0, None), (9, 0.02, None), (10, 0.0, corners)):
        light_field = LightField(0.2 + bar(top) + noise, weights=weights)
        found = step(Frame(light_field, before=before))
        alone = reconstruct(light_field, grid, **options)
        apart = np.abs(found["emission"].values - alone.emission).max()
        assert apart <= limit * alone.emission.max()
    assert before["emission"].background == pytest.approx(0.2, abs=0.01)
    assert len(pickle.dumps(step)) < 5000  # each process makes its own plan


def test_a_frame_that_is_away_for_a_moment_ends_the_run_which_resumes(tmp_path):
    arguments = tmp_path / "made", find_steps("decode")
    paths = [tmp_path / "0.npy", tmp_path / "1.npy"]
    np.save(paths[0], bar(5))
    with pytest.raises(InputError, match="1.npy is no longer there; the same command resumes"):
        process_frames(paths, *arguments, times_s=[0.0, 1.0])
    np.save(paths[1], bar(6))
    assert process_frames(paths, *arguments, times_s=[0.0, 1.0]).describe() == "2 frames: 2 whole"


def test_an_array_that_is_damaged_or_lost_is_named(made):
    chunk = made / "height" / "c" / "0"
    content = chunk.read_bytes()
    chunk.write_bytes(content[:-3] + bytes([content[-3] ^ 4]) + content[-2:])
    with pytest.raises(InputError, match="made/zarr.json cannot be read: .*or its array height is"):
        write_flicker(made, None)
    chunk.unlink()
    with pytest.raises(InputError, match="height cannot be read: 1 of its 1 chunk files"):
        write_flicker(made, None)


def test_decode_alone_keeps_the_views(tmp_path):
    weights = np.arange(9.0).reshape(3, 3)
    np.savez(tmp_path / "0.npz", views=bar(5), weights=weights)
    process_frames([tmp_path / "0.npz"], tmp_path / "kept", find_steps("decode"), times_s=[0.0])
    group = zarr.open_group(tmp_path / "kept", mode="r")
    assert group["views"].metadata.dimension_names == ("time", "v", "u", "t", "s")
    np.testing.assert_array_equal(group["views"][0], bar(5))
    np.testing.assert_array_equal(group["weights"][0], weights)
