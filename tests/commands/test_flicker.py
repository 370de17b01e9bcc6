"""lf-flame flicker: a video of light fields, and the frames of one."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from builders import camera_toml
from programs import run
from skimage.io import imread, imsave

from lf_flame import PAPER_CAMERA, Layer, Scene, render
from lf_flame.flame_video.flame_shape import DOUBTS
from lf_flame.scenes.flames import flame_texture

CAMERA = camera_toml(5, (48, 40))
LENS = replace(PAPER_CAMERA, views=5, lenslets=(48, 40))
DEPTH_MM, FOOT_MM, CELL_MM = 6.0, 2.7, 0.04
FRAMES, RATE_HZ, FLICKER_HZ = 24, 60.0, 11.6


def heights_of_textures():
    """From burner to tip, of flames that flicker."""
    return 4.0 + 0.6 * np.sin(2 * np.pi * FLICKER_HZ * np.arange(FRAMES) / RATE_HZ)


def flame(height_mm):
    """A flame that stands on FOOT_MM, with y running down, and its tip at half the peak."""
    texture = flame_texture(height_mm, 0.7, cell_mm=CELL_MM)
    layer = Layer(texture, DEPTH_MM, (height_mm, 4.48), (FOOT_MM - height_mm / 2, 0.1))
    above = np.flatnonzero(texture.max(axis=1) > 0.5)[0]
    tip_mm = FOOT_MM - height_mm + above * height_mm / len(texture)
    return render(Scene([layer]), LENS), tip_mm


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    """Frames whose names count without leading zeros, and the true heights of their contours."""
    folder = tmp_path_factory.mktemp("made") / "video"
    folder.mkdir()
    tips = []
    for number, height in enumerate(heights_of_textures()):
        light_field, tip = flame(height)
        rng = np.random.default_rng(number)
        noise = 0.01 * rng.standard_normal(light_field.views.shape, np.float32)
        np.save(folder / f"frame{number + 1}.npy", light_field.views + noise)
        tips.append(tip)
    return folder, LENS.field_mm(DEPTH_MM)[0] / 2 - np.array(tips)


@pytest.fixture
def camera_file(tmp_path):
    (tmp_path / "camera.toml").write_text(CAMERA)
    return tmp_path / "camera.toml"


def rows_of(folder):
    return list(csv.DictReader((folder / "flame.csv").read_text().splitlines()))


def record_of(folder):
    return json.loads((folder / "flicker.json").read_text())


@pytest.mark.slow
def test_height_and_frequency_of_flames_that_flicker(video, camera_file, tmp_path, drawn):
    folder, truth = video
    words = ["--frames-per-second", RATE_HZ, "--camera", camera_file, "--depth-mm", DEPTH_MM]
    out = tmp_path / "out"
    result = run("flicker", folder, *words, "--out", out)
    assert result.exit_code == 0, result.output
    assert "The flame flickers at 11." in result.output
    assert "Warning" not in result.output
    rows, lenslet_mm = rows_of(out), LENS.field_mm(DEPTH_MM)[0] / 48
    assert [float(row["height_mm"]) for row in rows] == pytest.approx(truth, abs=lenslet_mm)
    assert [row["source"] for row in rows] == [f"frame{n + 1}.npy" for n in range(FRAMES)]
    assert [float(row["time_s"]) for row in rows] == pytest.approx(np.arange(FRAMES) / RATE_HZ)
    row = rows[5]
    assert row["frame"] == "5"
    assert (47.5 - float(row["tip_row"])) * lenslet_mm == pytest.approx(float(row["height_mm"]))
    assert 1 < float(row["width_mm"]) < 2
    assert float(row["area_mm2"]) < float(row["width_mm"]) * float(row["height_mm"])
    record = record_of(out)
    found = record["flicker"]
    assert found["resolution_hz"] == pytest.approx(RATE_HZ / (FRAMES - 1))
    assert found["frequency_hz"] == pytest.approx(FLICKER_HZ, abs=0.1 * found["resolution_hz"])
    assert found["false_alarm"] < 1e-6
    assert record["pixel_mm"] == pytest.approx(lenslet_mm)
    assert record["depth_mm"] == DEPTH_MM
    assert record["mean_height"] == pytest.approx(truth.mean(), abs=lenslet_mm / 2)
    assert set(record["files"]) == {"flame.csv", "flicker.png"}
    assert imread(out / "flicker.png").shape[0] > 500


def small_flame(height_px):
    """A rectangle of light whose tip lies between rows, in 3 x 3 views of 40 x 16 pixels."""
    picture = np.zeros((40, 16), np.float32)
    whole = int(height_px)
    picture[40 - whole :, 5:11] = 1
    picture[39 - whole, 5:11] = height_px - whole
    return np.broadcast_to(picture, (3, 3, 40, 16))


def write_pictures(folder, heights, numbers=None, suffix="png"):
    """Ordinary 16-bit pictures of 40 x 16 pixels, of flames that end between rows."""
    folder.mkdir()
    for number, height in zip(numbers or range(len(heights)), heights, strict=True):
        picture = (30000 * small_flame(height)[0, 0]).astype(np.uint16)
        path = folder / f"f{number:03d}.{suffix}"
        np.save(path, picture) if suffix == "npy" else imsave(path, picture, check_contrast=False)


@pytest.mark.parametrize("suffix", ["png", "npy"])
def test_ordinary_pictures_are_the_default_and_too_few_periods_are_named(tmp_path, suffix):
    """30 pictures at 200 a second of a flame at 12.5 Hz: 1.8 periods."""
    heights = 20 + 8 * np.sin(2 * np.pi * 12.5 * np.arange(30) / 200)
    write_pictures(tmp_path / "video", heights, suffix=suffix)
    words = ["--frames-per-second", 200, "--out", tmp_path / "out"]
    done = run("flicker", tmp_path / "video", *words)
    assert done.exit_code == 0, done.output
    assert "Pictures of 40 x 16 pixels" in done.output
    assert "Hz, has 1.8 periods in these frames; at least 3 (0.24 s) are needed" in done.output
    record = record_of(tmp_path / "out")
    assert record["flicker"]["peak_hz"] == pytest.approx(12.5, abs=0.3)
    assert record["flicker"]["frequency_hz"] is None
    found = [float(row["height_px"]) for row in rows_of(tmp_path / "out")]
    assert found == pytest.approx(heights, abs=0.2)


@pytest.mark.slow
def test_what_process_wrote_is_read(tmp_path):
    """Two frames are missing, and one is dark; frames are counted."""
    numbers = [*range(20), *range(22, 60)]
    heights = 20 + 5 * np.sin(2 * np.pi * 12.5 * np.array(numbers) / 100)
    write_pictures(tmp_path / "video", heights, numbers)
    dark = np.zeros((40, 16), np.uint16)
    imsave(tmp_path / "video" / "f030.png", dark, check_contrast=False)
    out, words = tmp_path / "flame.zarr", ["--steps", "height", "--workers", 1]
    measures = ["--level", 0.4, "--pixel-mm", 0.5]
    done = run("process", tmp_path / "video", *words, *measures, "--out", out)
    assert done.exit_code == 0, done.output
    done = run("flicker", out, "--frames-per-second", 100, "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    assert "The flame flickers at 12.5 Hz" in done.output
    assert f"1 of 60 frames, first f030.png: {DOUBTS['dark']}" in done.output
    rows = rows_of(tmp_path / "out")
    assert [n for n, row in enumerate(rows) if row["height_mm"] == "nan"] == [20, 21, 30]
    assert record_of(tmp_path / "out")["level"] == 0.4
    assert float(rows[25]["time_s"]) == pytest.approx(0.25)
    found = [float(row["height_mm"]) for n, row in enumerate(rows) if n not in (20, 21, 30)]
    assert found == pytest.approx(0.5 * np.delete(heights, 28), abs=0.15)
    for refused, said in (
        (["--frames-per-second", 100, "--slope", 1], "is already processed: only"),
        ([], "counts frames: state --frames-per-second"),
    ):
        done = run("flicker", out, *refused, "--out", tmp_path / "other")
        assert said in str(done.exception)
