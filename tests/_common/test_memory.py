"""Memory: what an input needs is known before it is taken."""

import re
import tracemalloc
import zlib
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from h5py import File
from PIL import Image
from scipy.io import savemat
from tifffile import imwrite

from lf_flame import InputError
from lf_flame._common.input_files import LIMIT, check_memory, memory_limit
from lf_flame.formats import read_light_field
from lf_flame.scenes.scene_files import read_scene


def test_half_of_the_machine_unless_the_environment_says_otherwise(monkeypatch):
    monkeypatch.delenv(LIMIT, raising=False)
    stated = Path("/proc/meminfo").read_text()
    kilobytes = int(re.search(r"MemTotal: *(\d+) kB", stated)[1])
    assert memory_limit() == pytest.approx(kilobytes * 1024 / 2, rel=1e-6)
    monkeypatch.setenv(LIMIT, "2.5")
    check_memory(2_500_000_000, "here")
    with pytest.raises(InputError, match=r"here would need 2\.51 GB .* 2\.5 GB are allowed; LF_"):
        check_memory(2_510_000_000, "here")
    for wrong in ("", "much", "-1", "0", "nan"):
        monkeypatch.setenv(LIMIT, wrong)
        with pytest.raises(InputError, match="LF_FLAME_MEMORY_GB must be a number"):
            memory_limit()


def write_folder(path):
    path.mkdir()
    for view in range(4):
        Image.new("L", (1000, 500)).save(path / f"view_{view}.png")


def write_hdf5(path):
    with File(path, "w") as file:
        file.create_dataset("LF", data=VIEWS, compression="gzip")


VIEWS = np.zeros((2, 2, 500, 1000), np.float32)

SEARCH = 240 * 0.5 + 32 * 0.5
"""Megabytes that the search for the order of views of half a million pixels takes, the most."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "write", "megabytes", "stated"),
    [
        ("a.png", Image.new("L", (2000, 1000)).save, 18, {"views": 1}),
        ("a.tif", partial(imwrite, data=np.zeros((1000, 2000), np.uint8)), 18, {"views": 1}),
        (
            "pages.tif",
            partial(imwrite, data=np.zeros((4, 500, 1000), np.uint8), photometric="minisblack"),
            SEARCH,
            {"grid": "2x2"},
        ),
        ("a.npy", partial(np.save, arr=VIEWS), 16, {}),
        ("a.npz", partial(np.savez_compressed, views=VIEWS), 16, {}),
        ("folder", write_folder, SEARCH, {"grid": "2x2"}),
        ("a.h5", write_hdf5, 16, {}),
        ("a.mat", partial(savemat, mdict={"LF": VIEWS}, do_compression=True), 24, {}),
    ],
)
def test_what_a_light_field_needs_is_known_before_it_is_taken(
    tmp_path, monkeypatch, name, write, megabytes, stated
):
    """Two million pixels; the limit lies just below what they need, and just above."""
    write(tmp_path / name)
    monkeypatch.setenv(LIMIT, str(0.9 * megabytes / 1000))
    with pytest.raises(InputError, match=rf"({name}|order of the views) would need .*{LIMIT}"):
        read_light_field(tmp_path / name, **stated)
    monkeypatch.setenv(LIMIT, str(1.1 * megabytes / 1000))
    read_light_field(tmp_path / name, **stated)


def stated_need(tmp_path, monkeypatch, read):
    """Bytes that a reader says it needs, and those that it takes at most."""
    monkeypatch.setenv(LIMIT, "1e-6")
    with pytest.raises(InputError, match="would need") as refused:
        read()
    monkeypatch.setenv(LIMIT, "1")
    read()  # what is imported at the first call is no part of its need
    tracemalloc.start()
    read()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return 1e9 * float(re.search(r"need (\S+) GB", str(refused.value))[1]), peak


@pytest.mark.parametrize("mode", ["L", "LA", "RGB", "RGBA"])
def test_an_image_of_a_layer_takes_no_more_than_is_said(tmp_path, monkeypatch, mode):
    Image.new(mode, (700, 500)).save(tmp_path / "a.png")
    layer = '[[layers]]\nimage = "a.png"\ndepth_mm = 1.0\nsize_mm = [5.0, 7.0]\nopaque = true\n'
    (tmp_path / "a.toml").write_text(layer)
    said, peak = stated_need(tmp_path, monkeypatch, lambda: read_scene(tmp_path / "a.toml"))
    assert 0.5 * said < peak < said
    (tmp_path / "a.toml").write_text(3 * layer)
    monkeypatch.setenv(LIMIT, str(2.5e-9 * said))
    with pytest.raises(InputError, match="layer 3: what the scene shows up to here would need"):
        read_scene(tmp_path / "a.toml")


def test_large_views_are_refused_before_one_is_decoded(tmp_path, monkeypatch):
    """Four pictures that say they are of 30,000 x 30,000 pixels, and hold none."""
    Image.new("L", (1, 1)).save(tmp_path / "0_0.png")
    whole = (tmp_path / "0_0.png").read_bytes()
    head = b"IHDR" + (30000).to_bytes(4) * 2 + whole[24:29]
    claim = whole[:12] + head + zlib.crc32(head).to_bytes(4) + whole[33:]
    for name in ("0_0", "0_1", "1_0", "1_1"):
        (tmp_path / f"{name}.png").write_bytes(claim)
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", None)
    monkeypatch.setenv(LIMIT, "12")
    tracemalloc.start()
    with pytest.raises(InputError, match=r"would need \d+(\.\d)? GB"):
        read_light_field(tmp_path)
    assert tracemalloc.get_traced_memory()[1] < 2e6
    tracemalloc.stop()


def test_a_header_alone_takes_no_memory(tmp_path):
    """A file of some bytes that says it holds ten terabytes."""
    text = "{'descr': '<f4', 'fortran_order': False, 'shape': (9, 9, 200000, 160000), }"
    header = f"{text.ljust(117)}\n".encode()
    size = len(header).to_bytes(2, "little")
    (tmp_path / "a.npy").write_bytes(b"\x93NUMPY\x01\x00" + size + header)
    with pytest.raises(InputError, match=r"would need 2\.07e\+04 GB"):
        read_light_field(tmp_path / "a.npy")
