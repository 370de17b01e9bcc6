"""Frames of a video in order, their times, and reading them by what is found in the first."""

from pathlib import Path

import numpy as np
import pytest
from skimage.io import imsave

from lf_flame.flame_video.frames import FrameReader, find_frames, read_timestamps, times_by_names
from lf_flame.formats import read_light_field


@pytest.mark.parametrize(
    "names",
    [
        ["a", "a2b9", "a2b10", "a010b1", "a10b2", "b1"],
        ["t_-12.5", "t_-3.0", "t_-0.5", "t_0.0", "t_2.5", "t_10.0"],
        ["x-10", "x-9", "x0", "x9", "x10"],
        ["view-9", "view-10", "view-100"],
    ],
)
def test_frames_come_in_the_order_of_their_numbers(tmp_path, names):
    for name in names[::-1]:
        (tmp_path / f"{name}.npy").touch()
    assert [path.stem for path in find_frames([tmp_path])] == names


def seconds(*names, rate=100):
    return times_by_names([Path(f"{name}.npy") for name in names], rate)


def test_where_numbers_are_missing_time_passes():
    found, notes = seconds("f0", "f2", "f3", "f4", "f7")
    assert found == pytest.approx([0, 0.02, 0.03, 0.04, 0.07])
    assert "3 are missing" in notes[0]
    assert seconds("f08", "f09", "f10", "f11")[1] == []
    assert seconds("a-1", "a0", "a2")[0] == pytest.approx([0, 0.01, 0.03])
    # One number that never changes counts nothing.
    assert seconds("run7_1", "run7_2", "run7_4")[0] == pytest.approx([0, 0.01, 0.03])


def test_numbers_that_may_be_no_counts_get_a_note():
    found, notes = seconds("f0", "f10", "f30")
    assert found == pytest.approx([0, 0.1, 0.3])
    assert "rise by 10 or multiples" in notes[0]
    assert "1 are missing" in notes[1]
    for names in (["a", "b", "c"], ["r1_1", "r1_2", "r2_4"], ["f1", "g2", "h4"]):
        found, notes = seconds(*names)
        assert found == pytest.approx([0, 0.01, 0.02])
        assert "do not hold one number" in notes[0]


@pytest.mark.parametrize(
    "text",
    ["1.5\n2\n\n4e0\n", "\ufeffseconds\r\n1.5\r\n2\r\n4\r\n", "frame,time_s\n7,1.5\n8,2\n9,4"],
)
def test_times_from_a_file(tmp_path, text):
    (tmp_path / "times.csv").write_text(text, encoding="utf-8")
    assert read_timestamps(tmp_path / "times.csv", 3).tolist() == [1.5, 2, 4]


def test_other_files_and_an_own_white_image_are_no_frames(tmp_path):
    for name in ("1.npy", "2.npy", "3.png", "notes.txt", ".4.npy"):
        (tmp_path / name).touch()
    found = find_frames([tmp_path], [tmp_path / "3.png"])
    assert [path.name for path in found] == ["1.npy", "2.npy"]
    assert find_frames([tmp_path / "[12].npy"]) == found


def test_raw_images_are_decoded_by_the_lenslets_of_the_first(tmp_path):
    """As each would be decoded by itself, where nothing else is different."""
    rows, columns = np.indices((90, 108))
    white = 0.1 + 0.9 * np.clip(4.5 - np.hypot(rows % 9 - 4, columns % 9 - 4), 0, 1)
    imsave(tmp_path / "white.tif", (60000 * white).astype(np.uint16), check_contrast=False)
    for number in range(3):
        raw = white * (0.3 + 0.1 * number + 0.2 * np.sin(rows / 30))
        raw = (60000 * raw).astype(np.uint16)
        imsave(tmp_path / f"raw{number}.tif", raw, check_contrast=False)
    options = {"white": tmp_path / "white.tif", "pitch": 9.0}
    paths = find_frames([tmp_path / "raw*.tif"])
    for path, frame in zip(paths, map(FrameReader(paths[0], options), paths), strict=True):
        assert frame.views == pytest.approx(read_light_field(path, **options).views, abs=1e-6)
