"""What is written is there whole or not at all, and nothing else is touched."""

import os
import resource
from concurrent.futures import ThreadPoolExecutor

import pytest

from lf_flame._common.atomic_files import atomic_folder, atomic_write, remove_leftovers, write_text
from lf_flame.errors import InputError


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_what_was_there_stays_until_the_end(tmp_path):
    write_text(tmp_path / "a.txt", "old")

    def fail():
        with atomic_write(tmp_path / "a.txt") as aside:
            aside.write_text("new")
            assert (tmp_path / "a.txt").read_text() == "old"
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert (tmp_path / "a.txt").read_text() == "old"
    assert names(tmp_path) == ["a.txt"]


def test_a_link_is_replaced_and_what_it_leads_to_stays(tmp_path):
    (tmp_path / "thesis.txt").write_text("mine")
    (tmp_path / "a.txt").symlink_to("thesis.txt")
    write_text(tmp_path / "a.txt", "new")
    assert (tmp_path / "thesis.txt").read_text() == "mine"
    assert (tmp_path / "a.txt").read_text() == "new"
    assert not (tmp_path / "a.txt").is_symlink()


@pytest.mark.parametrize("make", [os.mkdir, os.mkfifo])
def test_what_is_no_file_is_not_replaced_by_one(tmp_path, make):
    make(tmp_path / "a.txt")
    with pytest.raises(InputError, match="a.txt is not a file, and is not replaced by one"):
        write_text(tmp_path / "a.txt", "new")
    assert names(tmp_path) == ["a.txt"]


def test_writers_side_by_side_each_write_their_own(tmp_path):
    """The file is one of those written, and whole; no writer meets another's file aside."""
    contents = [str(k) * 100_000 for k in range(10)]
    with ThreadPoolExecutor(10) as pool:
        list(pool.map(lambda text: write_text(tmp_path / "a.txt", text), contents * 5))
    assert (tmp_path / "a.txt").read_text() in contents
    assert names(tmp_path) == ["a.txt"]


def test_numpys_error_of_a_full_disk_keeps_its_text(tmp_path):
    """It has no number; the error names the final folder."""
    with pytest.raises(OSError, match="8 written") as caught, atomic_folder(tmp_path / "a"):
        raise OSError("90 requested and 8 written")
    assert caught.value.filename == str(tmp_path / "a")
    assert names(tmp_path) == []


def test_only_our_temporary_folders_are_removed(tmp_path):
    ours = tmp_path / f".a.{'0' * 16}.part"
    mine = [".a.part", ".a.0123.part", f".b.{'0' * 16}.part", f"a.{'0' * 16}.part"]
    for path in (ours, *(tmp_path / name for name in mine)):
        path.mkdir()
    remove_leftovers(tmp_path / "a")
    assert names(tmp_path) == sorted(mine)


def test_a_full_disk_names_the_file_and_keeps_what_was_there(tmp_path):
    """A limit on the size of files takes the place of the full disk."""
    write_text(tmp_path / "out", "old")
    _, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, hard))
        with pytest.raises(OSError, match="too large") as caught:
            write_text(tmp_path / "out", "new" * 10_000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
    assert caught.value.filename == str(tmp_path / "out")
    assert [path.read_text() for path in tmp_path.iterdir()] == ["old"]
