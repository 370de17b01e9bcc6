import os
import re
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

from lf_flame import InputError
from lf_flame._common.memory import LIMIT, check_memory, memory_limit
from lf_flame.formats import read_light_field


def test_half_of_the_machine_unless_the_environment_says_otherwise(monkeypatch):
    monkeypatch.delenv(LIMIT, raising=False)
    stated = Path("/proc/meminfo").read_text()
    kilobytes = int(re.search(r"MemTotal: *(\d+) kB", stated)[1])
    assert memory_limit() == pytest.approx(kilobytes * 1024 / 2, rel=1e-6)
    monkeypatch.setenv(LIMIT, "2.5")
    assert memory_limit() == 2.5e9
    check_memory(2_500_000_000, "here")
    with pytest.raises(InputError, match=r"here would need 2\.51 GB .* 2\.5 GB are allowed; LF_"):
        check_memory(2_510_000_000, "here")


@pytest.mark.parametrize("stated", ["", "much", "-1", "0", "nan"])
def test_a_limit_is_a_number(monkeypatch, stated):
    monkeypatch.setenv(LIMIT, stated)
    with pytest.raises(InputError, match="LF_FLAME_MEMORY_GB must be a number"):
        memory_limit()


def write_png(path):
    Image.new("L", (2000, 1000)).save(path)


def write_tiff(path):
    tifffile.imwrite(path, np.zeros((1000, 2000), np.uint8), compression="zlib")


def write_pages(path):
    tifffile.imwrite(
        path, np.zeros((4, 500, 1000), np.uint8), compression="zlib", photometric="minisblack"
    )


def write_npy(path):
    np.save(path, np.zeros((2, 2, 500, 1000), np.float32))


def write_npz(path):
    np.savez_compressed(path, views=np.zeros((2, 2, 500, 1000), np.float32))


def write_folder(path):
    path.mkdir()
    for view in range(4):
        Image.new("L", (1000, 500)).save(path / f"view_{view}.png")


@pytest.mark.parametrize(
    ("name", "write", "megabytes"),
    [
        ("a.png", write_png, 16),
        ("a.tif", write_tiff, 10),
        ("pages.tif", write_pages, 10),
        ("a.npy", write_npy, 16),
        ("a.npz", write_npz, 16),
        ("folder", write_folder, 8),
    ],
)
def test_what_a_light_field_needs_is_known_before_it_is_taken(
    tmp_path, monkeypatch, name, write, megabytes
):
    """Two million pixels; the limit lies just below what they need, and just above."""
    write(tmp_path / name)
    monkeypatch.setenv(LIMIT, str(0.9 * megabytes / 1000))
    with pytest.raises(InputError, match=rf"{name} would need 0\.0\d+ GB of memory.*{LIMIT}"):
        read_light_field(tmp_path / name, views=1 if name in ("a.png", "a.tif") else None)
    monkeypatch.setenv(LIMIT, str(1.1 * megabytes / 1000))
    read_light_field(tmp_path / name, views=1 if name in ("a.png", "a.tif") else None)


def test_a_header_alone_takes_no_memory(tmp_path):
    """A file of some bytes that says it holds ten terabytes."""
    header = b"\x93NUMPY\x01\x00"
    text = "{'descr': '<f4', 'fortran_order': False, 'shape': (9, 9, 200000, 160000), }"
    text = text.ljust(117) + "\n"
    (tmp_path / "a.npy").write_bytes(header + len(text).to_bytes(2, "little") + text.encode())
    before = os.times()
    with pytest.raises(InputError, match=r"would need 2\.07e\+04 GB"):
        read_light_field(tmp_path / "a.npy")
    assert os.times().user - before.user < 5
