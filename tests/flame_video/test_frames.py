"""Frames of a video in order, their times, and reading them by what is found in the first."""

from pathlib import Path

import numpy as np
import pytest
from skimage.io import imsave

from lf_flame.flame_video.frames import FrameReader, find_frames, find_times
from lf_flame.formats import read_light_field


@pytest.mark.parametrize(
    "names",
    [
        ["a", "a2b9", "a2b10", "a010b1", "a10b2", "b1"],
        ["t_-12.5", "t_-3.0", "t_-0.5", "t_0.0", "t_2.5", "t_10.0"],
        ["x-10", "x-9", "x0", "x9", "x10"],
        ["view-9", "view-10", "view-100"],
        ["2023-12-31", "2024-01-05", "2024-02-15"],
        ["frame.0002", "frame.0010"],
        ["a.1.02.03", "a.1.02.10"],
        ["1.9", "1.10"],
        ["0", "0.50", "12.25"],
        ["y-5x-2", "y-4x-2", "y-4x+2"],
        [f"{10**19}", f"{10**19 + 1}"],
    ],
)
def test_frames_come_in_the_order_of_their_numbers(tmp_path, names):
    for name in names[::-1]:
        (tmp_path / f"{name}.npy").touch()
    assert [path.stem for path in find_frames([tmp_path])] == names


def times_of(*names):
    """Frames by name, None where one is missing, and notes; 100 frames a second."""
    rows, times, notes = find_times([Path(f"{name}.npy") for name in names], 100)
    assert times == pytest.approx(np.arange(len(rows)) / 100)
    return [row and row.stem for row in rows], notes


def test_where_numbers_are_missing_time_passes():
    found, notes = times_of("f0", "f2", "f3", "f4", "f6")
    assert found == ["f0", None, "f2", "f3", "f4", None, "f6"]
    assert "2 of the frames between" in notes[0]
    assert times_of("f08", "f09", "f10", "f11") == (["f08", "f09", "f10", "f11"], [])
    assert times_of("a-1", "a0", "a2")[0] == ["a-1", "a0", None, "a2"]
    assert times_of("a.008", "a.010", "a.011")[0] == ["a.008", None, "a.010", "a.011"]
    # One number that never changes counts nothing.
    assert times_of("run7_1", "run7_2", "run7_4")[0] == ["run7_1", "run7_2", None, "run7_4"]


@pytest.mark.parametrize(
    "names",
    [
        ["a", "b", "c"], ["r1_1", "r1_2", "r2_4"], ["f1", "g2", "h4"], ["f0", "f10", "f30"],
        ["f1", "f01", "f2"], ["f20261126", "f20261127", "f20270101"], ["t_0.00", "t_0.11"],
    ],
)  # fmt: skip
def test_numbers_that_count_no_frames_get_a_note(names):
    found, notes = times_of(*names)
    assert found == names
    assert "do not contain one number" in notes[0]


def test_other_files_and_an_own_white_image_are_no_frames(tmp_path):
    for name in ("1.npy", "2.npy", "3.png", "notes.txt", ".4.npy"):
        (tmp_path / name).touch()
    found = find_frames([tmp_path], [tmp_path / "3.png"])
    assert [path.name for path in found] == ["1.npy", "2.npy"]


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
    paths = find_frames([tmp_path], [tmp_path / "white.tif"])
    for path, frame in zip(paths, map(FrameReader(paths[0], options), paths), strict=True):
        assert frame.views == pytest.approx(read_light_field(path, **options).views, abs=1e-6)
