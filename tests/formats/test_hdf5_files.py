"""HDF5 and MATLAB files: axes and weights, and what such files may not do."""

import os
import struct
import tracemalloc
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import loadmat, savemat

from lf_flame import InputError, read_light_field
from lf_flame._common.input_files import LIMIT

SHAPE = (3, 4, 20, 25)


def element(kind, data):
    """One element of a MATLAB file of version 5 (MAT-File Format, 1-5)."""
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def matrix(array, of_class):
    """A matrix LF of class double (6) or uint8 (9), stored as bytes, columns first."""
    parts = [
        element(6, struct.pack("<II", of_class, 0)),
        element(5, struct.pack(f"<{array.ndim}i", *array.shape)),
        element(1, b"LF"),
        element(2, array.astype("u1").tobytes(order="F")),
    ]
    return element(14, b"".join(parts))


def write_mat5(path, matrix):
    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM"
    packed = zlib.compress(matrix)
    path.write_bytes(head + struct.pack("<II", 15, len(packed)) + packed)


def write_mat73(path, arrays, **options):
    """As MATLAB does: HDF5 behind a block of text, the axes of its arrays in reverse."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, array in arrays.items():
            file.create_dataset(name, data=array.transpose(), **options)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM")
    return path


def numbered(dtype, channels=()):
    """Each pixel has another value: the place of its view, row, column and channel."""
    count = np.arange(np.prod(SHAPE + channels)).reshape(SHAPE + channels)
    return (count % 251 if dtype == np.uint8 else count).astype(dtype)


@pytest.mark.parametrize(
    ("kind", "channels"), [("uint8", ()), ("single", ()), ("uint16", (3,)), ("double", (3,))]
)
def test_axes_of_matlab_are_those_that_matlab_shows(tmp_path, kind, channels):
    dtype = {"single": np.float32, "double": np.float64}.get(kind, kind)
    array = numbered(dtype, channels)
    white = np.float32(np.iinfo(dtype).max if "uint" in kind else 1)
    other = np.ones((2, 3))
    savemat(tmp_path / "scipy.mat", {"LF": array, "K": other, "text": "words", "s": {"a": 1}})
    savemat(tmp_path / "packed.mat", {"mine": array}, do_compression=True)
    write_mat73(tmp_path / "new.mat", {"K": other, "LF": array})
    write_mat73(tmp_path / "gzip.mat", {"LF": array}, compression="gzip", shuffle=True,
                fletcher32=True)  # fmt: skip
    with h5py.File(tmp_path / "plain.h5", "w") as file:
        file["group/deeper/light_field"] = array
    for path in tmp_path.iterdir():
        views = read_light_field(path).views
        assert views.shape == array.shape
        at = (2, 1, 17, 3, *([2] if channels else []))  # one pixel, and then all
        assert views[at] == np.float32(array[at]) / white
        np.testing.assert_array_equal(views, array.astype(np.float32) / white, err_msg=path.name)


def test_whole_numbers_of_class_double_are_no_levels(tmp_path):
    """MATLAB stores them as bytes to save room."""
    array = numbered(np.uint8)
    write_mat5(tmp_path / "a.mat", matrix(array, 6))
    np.testing.assert_array_equal(read_light_field(tmp_path / "a.mat").views, array)


def test_a_file_of_matlab_itself_holds_what_scipy_reads():
    path = Path(__file__).parents[3] / "shared/lightfields/lytro_f01_raw/image_cords.mat"
    if not path.exists():
        pytest.skip("the example file image_cords.mat is not beside the checkout")
    found = read_light_field(path, array="image_cords", axes="tsc", views=1).views[0, 0]
    np.testing.assert_array_equal(found, loadmat(path)["image_cords"].astype(np.float32))


@pytest.mark.parametrize("version", [5, 73])
def test_the_fourth_channel_of_the_toolbox_is_a_weight(tmp_path, version):
    array = numbered(np.uint16, (4,))
    array[..., 3] = 1000 * np.arange(1, 13).reshape(3, 4, 1, 1)
    array[0, 0, ..., 3] = 0
    array[2, 3, :, ::5, 3] = 0  # four fifths of 12000 are left
    path = tmp_path / "LF.mat"
    if version == 5:
        savemat(path, {"LF": array})
    else:
        write_mat73(path, {"LF": array})
    found = read_light_field(path)
    np.testing.assert_array_equal(found.views, array[..., :3] / np.float32(65535))
    weights = np.arange(1, 13).reshape(3, 4) / 11
    weights[0, 0], weights[2, 3] = 0, 9.6 / 11
    np.testing.assert_allclose(found.weights, weights, rtol=1e-6)
    np.testing.assert_array_equal(found.valid[2, 3], array[2, 3, ..., 3] > 0)
    assert np.count_nonzero(~found.valid) == np.count_nonzero(~found.valid[2, 3])
    assert read_light_field(path, axes="vutsc").views.shape == (*SHAPE, 4)
    array[..., 3] = 0
    write_mat73(path, {"LF": array})
    with pytest.raises(InputError, match="weights must be finite and 0 or above"):
        read_light_field(path)


def test_the_array_is_named_where_there_are_several(tmp_path):
    left, right = numbered(np.uint8), numbered(np.uint8) // 2
    savemat(tmp_path / "a.mat", {"left": left, "right": right})
    write_mat73(tmp_path / "b.mat", {"left": left, "right": right})
    with h5py.File(tmp_path / "c.h5", "w") as file:
        file["left"], file["right"], file["scene"] = left, right, np.ones(3)
    np.savez(tmp_path / "d.npz", left=left, right=right)
    dark = {"left": left // 9, "right": right // 9}
    savemat(tmp_path / "dark.mat", dark)
    for name in ("a.mat", "b.mat", "c.h5", "d.npz"):
        with pytest.raises(InputError, match=r"got left \(3, 4, 20, 25\), right .*convert --array"):
            read_light_field(tmp_path / name)
        with pytest.raises(InputError, match="array of numbers named LF, got left"):
            read_light_field(tmp_path / name, array="LF")
        found = read_light_field(tmp_path / name, array="right", dark=tmp_path / "dark.mat")
        expected = (right.astype(float) - dark["right"]) / 255
        np.testing.assert_allclose(found.views, expected, atol=1e-6)
    turned = read_light_field(tmp_path / "c.h5", array="left", axes="tsvu", dark=None)
    np.testing.assert_array_equal(turned.views, left.transpose(2, 3, 0, 1) / np.float32(255))


def test_nothing_but_the_file_itself_is_opened(tmp_path):
    """A pipe in the place of another file: whoever opens it waits for ever."""
    os.mkfifo(tmp_path / "pipe.h5")
    (tmp_path / "secret.raw").write_bytes(bytes(6000))
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["outer"] = h5py.ExternalLink("pipe.h5", "LF")
        file["soft"] = h5py.SoftLink("/outer")
        file["loop/again"] = h5py.SoftLink("/loop")
        file["loop"]["itself"] = file["loop"]
        file.create_dataset("raw", SHAPE, "u1", external=[("secret.raw", 0, 6000)])
        layout = h5py.VirtualLayout((4, *SHAPE[1:]), "u1", maxshape=(None, *SHAPE[1:]))
        source = h5py.VirtualSource("pipe.h5", "LF", SHAPE, maxshape=(None, *SHAPE[1:]))
        everything = (slice(0, h5py.h5s.UNLIMITED), slice(None), slice(None), slice(None))
        layout[everything] = source[everything]
        file.create_virtual_dataset("virtual", layout)
        file.create_dataset("references", SHAPE, h5py.ref_dtype)
        file.create_dataset("objects", SHAPE, h5py.string_dtype())
        file.create_dataset("records", SHAPE, np.dtype([("a", "u1")]))
    with pytest.raises(InputError, match="numbers named views, got none"):
        read_light_field(path)
    for name in ("outer", "soft", "raw", "virtual", "references", "objects", "records"):
        with pytest.raises(InputError, match=f"array of numbers named {name}, got none"):
            read_light_field(path, array=name)


def test_no_filter_is_loaded(tmp_path):
    """The library would look for a program of this number in HDF5_PLUGIN_PATH."""
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        made = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        made.set_chunk(SHAPE)
        made.set_filter(32004, h5py.h5z.FLAG_OPTIONAL, ())
        space = h5py.h5s.create_simple(SHAPE)
        array = h5py.h5d.create(file.id, b"LF", h5py.h5t.STD_U8LE, space, made)
        array.write_direct_chunk((0, 0, 0, 0), bytes(6000))
    with pytest.raises(
        InputError, match=r"LF is compressed by filters \[32004\] of HDF5, for which no program"
    ):
        read_light_field(path)


@pytest.mark.slow
def test_bombs_are_found_before_they_are_unpacked(tmp_path, monkeypatch):
    """A part that should hold 6,000 bytes, and holds 30 million; an element that holds as many."""
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        array = file.create_dataset("LF", SHAPE, "u1", chunks=SHAPE, compression="gzip")
        array.id.write_direct_chunk((0, 0, 0, 0), zlib.compress(bytes(30_000_000)))
    monkeypatch.setenv(LIMIT, "0.02")
    with pytest.raises(InputError, match="a part of it contains more than the 6,000 bytes"):
        read_light_field(path)
    large = b"".join(element(kind, data) for kind, data in (
        (6, struct.pack("<II", 9, 0)), (5, struct.pack("<4i", *SHAPE)), (1, bytes(30_000_000)),
    ))  # fmt: skip
    write_mat5(tmp_path / "a.mat", element(14, large))
    with pytest.raises(InputError, match=r"a\.mat cannot be read: it is damaged"):
        read_light_field(tmp_path / "a.mat")
    array = matrix(numbered(np.uint8), 9)
    write_mat5(tmp_path / "a.mat", array + bytes(30_000_000))
    tracemalloc.start()
    assert read_light_field(tmp_path / "a.mat").views.shape == SHAPE
    assert tracemalloc.get_traced_memory()[1] < 1e6
    tracemalloc.stop()
    huge = (2000, 2000, 20, 25)
    with h5py.File(path, "w") as file:
        file.create_dataset("LF", huge, "u1")
        file.create_dataset("tiny", SHAPE, "u1", chunks=(100, 100, 200, 200),
                            maxshape=(None,) * 4, compression="gzip")  # fmt: skip
    for name in ("LF", "tiny"):
        with pytest.raises(InputError, match=r"a\.h5 would need \S+ GB"):
            read_light_field(path, array=name)


def write_small(path, rng):
    """Write a small file of the kind that its name says."""
    array = rng.integers(0, 255, (2, 2, 6, 7), np.uint8)
    if path.name.startswith("5"):
        savemat(path, {"LF": array}, do_compression=path.name == "5.mat")
    elif path.name == "73.mat":
        write_mat73(path, {"LF": array}, compression="gzip")
    else:
        with h5py.File(path, "w") as file:
            file.create_dataset("LF", data=array, compression="gzip")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["5.mat", "5plain.mat", "73.mat", "a.h5"])
def test_damaged_files_are_refused_in_a_sentence(tmp_path, rng, name):
    path = tmp_path / name
    write_small(path, rng)
    whole = path.read_bytes()
    refused = 0
    for cut in np.linspace(0, len(whole) - 1, 12).astype(int):
        path.write_bytes(whole[:cut])
        with pytest.raises(InputError) as error:
            read_light_field(path)
        assert name in str(error.value)
    for place in rng.integers(0, len(whole), 60):
        changed = bytearray(whole)
        changed[place] ^= 1 << rng.integers(8)
        path.write_bytes(changed)
        try:
            read_light_field(path)
        except InputError as error:
            refused += len(str(error)) < 1000
    assert refused > 0
