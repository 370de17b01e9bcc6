"""NumPy's files are weighed before they are read, and damage is told in a sentence."""

import zipfile

import numpy as np
import pytest
from sentences import sentence_of

from lf_flame import InputError
from lf_flame._common.arrays_in_files import ArrayFile


@pytest.fixture
def arrays(rng):
    return {"a": rng.uniform(size=(3, 4)), "b/c": np.arange(5, dtype=np.int16), "d": np.array(True)}


def read_all(path):
    file = ArrayFile(path)
    return dict(zip(file.names, file.read(file.names), strict=True))


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_an_archive_is_read_as_numpy_reads_it(tmp_path, arrays, save):
    save(tmp_path / "a.npz", **arrays)
    found = read_all(tmp_path / "a.npz")
    assert found.keys() == arrays.keys()
    for name, values in arrays.items():
        np.testing.assert_array_equal(found[name], values)
        assert found[name].dtype == values.dtype
    header = ArrayFile(tmp_path / "a.npz").header("a")
    assert (header.shape, header.dtype, header.nbytes) == ((3, 4), np.float64, 96)


@pytest.mark.parametrize("order", ["C", "F"])
def test_a_single_array_is_told_by_what_is_in_it(tmp_path, rng, order):
    values = np.asarray(rng.uniform(size=(3, 4)), order=order)
    with (tmp_path / "a.npz").open("wb") as file:
        np.save(file, values)
    np.testing.assert_array_equal(read_all(tmp_path / "a.npz")[""], values)


def test_members_that_are_no_arrays_are_named(tmp_path, arrays):
    np.savez(tmp_path / "a.npz", **arrays)
    with zipfile.ZipFile(tmp_path / "a.npz", "a") as archive:
        archive.writestr("text.npy", "no array")
        archive.writestr("readme.txt", "left aside")
    file = ArrayFile(tmp_path / "a.npz")
    assert file.names == ["a", "b/c", "d", "text"]
    assert len(file.read(["a", "d"])) == 2
    with pytest.raises(InputError, match=r"a\.npz cannot be read.*not a NumPy file of plain"):
        file.header("text")
    with pytest.raises(InputError, match=r"a\.npz cannot be read"):
        file.header("none")


def test_a_header_of_another_version_is_refused(tmp_path):
    with (tmp_path / "a.npy").open("wb") as file:
        np.lib.format.write_array(file, np.ones(3), version=(3, 0))
    with pytest.raises(InputError, match=r"a\.npy cannot be read.*not a NumPy file of plain"):
        read_all(tmp_path / "a.npy")


def test_packings_that_zipfile_unpacks_without_a_bound_are_refused(tmp_path, arrays):
    np.save(tmp_path / "a.npy", arrays["a"])
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_BZIP2) as archive:
        archive.write(tmp_path / "a.npy", "a.npy")
    with pytest.raises(InputError, match="a is compressed by method 12"):
        read_all(tmp_path / "a.npz")


@pytest.mark.parametrize(
    "values", [np.array([{}]), np.array(["text"]), np.zeros(3, [("x", "f4"), ("y", "i2")])]
)
def test_only_numbers_are_read(tmp_path, values):
    np.save(tmp_path / "a.npy", values)
    with pytest.raises(InputError, match="its content is not a plain array of numbers"):
        read_all(tmp_path / "a.npy")


@pytest.mark.parametrize("kind", ["npy", "npz", "packed.npz"])
def test_damage_is_one_sentence(tmp_path, arrays, rng, kind):
    """Files that are cut anywhere, and files with some other bits."""
    path = tmp_path / f"a.{kind}"
    if kind == "npy":
        np.save(path, arrays["a"])
    else:
        (np.savez if kind == "npz" else np.savez_compressed)(path, **arrays)
    whole = path.read_bytes()
    refused = 0
    for trial in range(300):
        content = bytearray(whole)
        if trial % 3 == 0:
            content = content[: rng.integers(len(content))]
        else:
            for place in rng.integers(len(content), size=1 + trial % 5):
                content[place] ^= 1 << rng.integers(8)
        path.write_bytes(content)
        told = sentence_of(read_all, path)
        refused += bool(told)
        assert not told or (str(path) in told and "\n" not in told)
    assert refused > (60 if kind == "npy" else 200)
