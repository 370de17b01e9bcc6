"""What is written is there whole or not at all, and nothing else is touched."""

import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from lf_flame._common.atomic_files import atomic_folder, atomic_write, together, write_text
from lf_flame.errors import InputError

KILLED = """
import signal, sys, time
from lf_flame._common.atomic_files import atomic_folder, atomic_write
signal.signal(signal.SIGINT, signal.default_int_handler)  # which a shell's "&" turns off
kind = {"file": atomic_write, "folder": atomic_folder}[sys.argv[1]]
with kind(sys.argv[2]) as aside:
    print(aside, flush=True)
    time.sleep(60)
"""


@pytest.fixture
def writer():
    """Start a process that writes something, and is in the middle of it."""
    started = []

    def start(kind, path):
        command = [sys.executable, "-c", KILLED, kind, str(path)]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        started.append(process)
        process.stdout.readline()
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


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


def test_a_file_gets_the_permissions_of_any_new_file(tmp_path):
    write_text(tmp_path / "a.txt", "new")
    (tmp_path / "b.txt").touch()
    assert (tmp_path / "a.txt").stat().st_mode == (tmp_path / "b.txt").stat().st_mode


@pytest.mark.parametrize("make", [os.mkdir, os.mkfifo])
def test_what_is_no_file_is_not_replaced_by_one(tmp_path, make):
    make(tmp_path / "a.txt")
    with pytest.raises(InputError, match="a.txt is .*, which a file cannot replace"):
        write_text(tmp_path / "a.txt", "new")
    with (
        pytest.raises(InputError, match="which a file cannot replace"),
        together(tmp_path) as aside,
    ):
        (aside / "a.txt").write_text("new")
    assert names(tmp_path) == ["a.txt"]


def test_writers_side_by_side_each_write_their_own(tmp_path):
    """The file is one of those written, and whole; no writer meets another's file aside."""
    contents = [str(k) * 100_000 for k in range(10)]
    with ThreadPoolExecutor(10) as pool:
        list(pool.map(lambda text: write_text(tmp_path / "a.txt", text), contents * 5))
    assert (tmp_path / "a.txt").read_text() in contents
    assert names(tmp_path) == ["a.txt"]


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_what_a_killed_writer_left_goes_with_the_next_write(tmp_path, writer, kind):
    writing, killed = writer(kind, tmp_path / "a"), writer(kind, tmp_path / "a")
    assert len(names(tmp_path)) == 2
    killed.send_signal(signal.SIGKILL)
    killed.wait()
    with (atomic_write if kind == "file" else atomic_folder)(tmp_path / "a"):
        pass
    left = [name for name in names(tmp_path) if name != "a"]
    assert len(left) == 1  # that of the writer who still writes
    writing.send_signal(signal.SIGINT)
    writing.wait()
    assert names(tmp_path) == ["a"]


def test_files_of_a_users_with_similar_names_stay(tmp_path):
    mine = [".a.part.txt", ".a.0123.part.txt", f".b.{'0' * 16}.part.txt", f"a.{'0' * 16}.part.txt"]
    for name in mine:
        (tmp_path / name).write_text("mine")
    write_text(tmp_path / "a.txt", "new")
    assert names(tmp_path) == sorted(["a.txt", *mine])


def test_files_appear_together(tmp_path):
    folder = tmp_path / "new" / "results"
    with together(folder, last="a.json") as aside:
        for name in ("a.json", "b.png", "c.csv"):
            write_text(aside / name, json.dumps(name))
        assert names(folder) == [aside.name]
        time.sleep(0.01)
    assert names(folder) == ["a.json", "b.png", "c.csv"]


@pytest.mark.parametrize("error", [OSError, KeyboardInterrupt])
def test_nothing_changes_where_one_of_the_files_fails(tmp_path, error):
    write_text(tmp_path / "results" / "a.txt", "old")

    def fail(folder):
        with together(folder) as aside:
            write_text(aside / "a.txt", "new")
            raise error

    for folder in (tmp_path / "results", tmp_path / "new" / "results"):
        with pytest.raises(error):
            fail(folder)
    assert (tmp_path / "results" / "a.txt").read_text() == "old"
    assert names(tmp_path / "results") == ["a.txt"]
    assert names(tmp_path) == ["results"]


def test_the_last_file_is_moved_last(tmp_path, monkeypatch):
    from pathlib import Path

    moved, replace = [], Path.replace
    monkeypatch.setattr(Path, "replace", lambda a, b: (moved.append(b.name), replace(a, b))[1])
    with together(tmp_path, last="a.json") as aside:
        for name in ("a.json", "b.png"):
            (aside / name).touch()
    assert moved == ["b.png", "a.json"]


def test_a_full_disk_in_the_middle_of_a_file_names_it(tmp_path):
    def fail():
        with atomic_write(tmp_path / "a.tif"):
            raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space left") as raised:
        fail()
    assert raised.value.filename == str(tmp_path / "a.tif")


def test_a_made_up_leftover_moves_nothing(tmp_path):
    left = tmp_path / f".outputs.{'0' * 16}.moving"
    left.mkdir()
    (left / "thesis.txt").write_text("theirs")
    (tmp_path / "thesis.txt").write_text("mine")
    with together(tmp_path, last="a.json") as aside:
        (aside / "a.json").touch()
    assert (tmp_path / "thesis.txt").read_text() == "mine"
    assert names(tmp_path) == ["a.json", "thesis.txt"]


def test_an_error_in_words_keeps_them_and_gets_the_file(tmp_path):
    """As NumPy's where the disk is full; without words it would read "[Errno None] None"."""
    with pytest.raises(OSError, match="90 requested") as caught, atomic_write(tmp_path / "file"):
        raise OSError("90 requested and 8 written")
    assert caught.value.strerror == "90 requested and 8 written"
    assert caught.value.filename == str(tmp_path / "file")
