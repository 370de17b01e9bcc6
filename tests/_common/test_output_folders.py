"""A folder of results appears as a whole; what is the user's is never replaced."""

import json
import os
import random
import shutil
import subprocess
import sys
import threading
import time
from contextlib import suppress

import pytest

from lf_flame._common.atomic_files import (
    exclusive,
    output_folder,
    recorded_path,
    refuse_folder,
    write_json,
    write_text,
)
from lf_flame.errors import InputError

RECORD = "work.json"


def fill(folder, text="new", overwrite=False, names=("a.txt", "b.txt")):
    with output_folder(folder, RECORD, overwrite=overwrite) as out:
        out.facts |= {"text": text, "source": os.fsdecode(b"flamm\xe9.npy")}  # not in UTF-8
        for name in names:
            write_text(out.path(name), text)
    return out


def contents(folder):
    return {path.name: path.read_text() for path in folder.iterdir() if path.name != RECORD}


def test_the_record_names_each_file_and_says_where_they_come_from(tmp_path):
    assert fill(tmp_path / "deep" / "out").files == ["a.txt", "b.txt"]
    record = json.loads((tmp_path / "deep" / "out" / RECORD).read_text())
    assert (record["files"], record["source"]) == (["a.txt", "b.txt"], "flamm?.npy")
    assert record.keys() >= {"text", "command", "date", "git_revision", "versions", "machine"}
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["out"]


def test_a_folder_is_replaced_as_a_whole(tmp_path):
    fill(tmp_path / "out", "old", names=("a.txt", "c.txt"))
    (tmp_path / "link").symlink_to("out")
    fill(tmp_path / "link", overwrite=True)
    assert contents(tmp_path / "out") == {"a.txt": "new", "b.txt": "new"}
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link", "out"]
    (tmp_path / "empty").mkdir()
    fill(tmp_path / "empty")
    assert contents(tmp_path / "empty") == {"a.txt": "new", "b.txt": "new"}


def folder_for_a_file(folder):
    (folder / "a.txt").unlink()
    (folder / "a.txt").mkdir()


REFUSED = {
    "it exists": (lambda folder: None, False, "out exists; .* replace it with --overwrite"),
    "a file is added": (lambda folder: (folder / "mine").touch(), True, "does not list mine"),
    "a file became a folder": (folder_for_a_file, True, "does not list a.txt"),
    "no record": (lambda folder: (folder / RECORD).unlink(), True, "not a result: .* No such file"),
    "no list of files": (lambda folder: write_json(folder / RECORD, {}), True, "work.json, files"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_may_not_be_replaced_is_refused_before_any_work(tmp_path, case):
    change, overwrite, message = REFUSED[case]
    fill(tmp_path / "out", "old")
    change(tmp_path / "out")
    before = sorted(path.name for path in (tmp_path / "out").iterdir())
    with (
        pytest.raises(InputError, match=message),
        output_folder(tmp_path / "out", RECORD, overwrite=overwrite),
    ):
        pytest.fail("work was begun")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == before
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_file_and_the_current_folder_are_no_output(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="file exists and is not a folder"):
        fill(tmp_path / "file", overwrite=True)
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    for name in (".", "new/.."):  # the second leads here although there is no folder new
        with pytest.raises(InputError, match="is the current folder"):
            fill(name)
    fill("out", "old")
    with pytest.raises(InputError, match="out exists; name another"):
        refuse_folder("new/../out", RECORD)


@pytest.mark.parametrize("error", [InputError("wrong"), OSError(28, "full"), KeyboardInterrupt()])
def test_a_call_that_fails_changes_nothing(tmp_path, error):
    fill(tmp_path / "out", "old")

    def fail(folder, overwrite):
        with output_folder(folder, RECORD, overwrite=overwrite) as out:
            write_text(out.path("a.txt"), "new")
            raise error

    for folder in ("out", "new/deep"):
        with pytest.raises(type(error)):
            fail(tmp_path / folder, folder == "out")
    assert contents(tmp_path / "out") == {"a.txt": "old", "b.txt": "old"}
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_what_is_put_there_during_the_work_stays(tmp_path):
    fill(tmp_path / "out", "old")

    def work():
        with output_folder(tmp_path / "out", RECORD, overwrite=True) as out:
            write_text(out.path("a.txt"), "new")
            (tmp_path / "out" / "mine").write_text("mine")

    with pytest.raises(InputError, match="does not list mine"):
        work()
    assert contents(tmp_path / "out") == {"a.txt": "old", "b.txt": "old", "mine": "mine"}


def test_a_second_writer_is_refused_in_a_sentence(tmp_path):
    with output_folder(tmp_path / "out", RECORD) as out:
        write_text(out.path("a.txt"), "first")
        with pytest.raises(InputError, match="out is being written by another process"):
            fill(tmp_path / "out", "second")
    assert contents(tmp_path / "out") == {"a.txt": "first"}


def test_never_two_at_once(tmp_path):
    """Locks are removed while others try to take them."""
    inside, most, turns = [], [], []

    def work():
        while len(turns) < 120:
            with suppress(InputError), exclusive(tmp_path / "out"):
                inside.append(1)
                most.append(len(inside))
                inside.pop()
                turns.append(1)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert max(most) == 1
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(InputError, match="/ is the root of all folders"), exclusive("/"):
        pass


FOR_EVER = """
import itertools, sys
from lf_flame._common.atomic_files import write_text
from lf_flame._common.atomic_files import output_folder
print("ready", flush=True)
for k in itertools.count():
    with output_folder(sys.argv[1], "work.json", overwrite=True) as out:
        for number in range(20):
            write_text(out.path(f"{number}.txt"), str(k % 10) * 1000)
"""


@pytest.mark.slow
def test_a_killed_writer_leaves_a_whole_folder(tmp_path):
    """The old one under its own name or a sibling's, until the new one has its name."""
    rng, out = random.Random(2), tmp_path / "out"
    fill(out, names=[f"{number}.txt" for number in range(20)])

    def is_whole(folder):
        record = json.loads((folder / RECORD).read_text())
        return len(record["files"]) == 20 and len(set(contents(folder).values())) == 1

    for _ in range(8):
        with subprocess.Popen(
            [sys.executable, "-c", FOR_EVER, out], stdout=subprocess.PIPE
        ) as process:
            process.stdout.readline()
            time.sleep(rng.uniform(0.05, 0.3))
            process.kill()
        siblings = list(tmp_path.glob("out.old-*"))
        assert is_whole(out) if out.exists() else any(map(is_whole, siblings))
        for left in siblings if out.exists() else ():
            shutil.rmtree(left)
    fill(out, overwrite=True)
    assert list(tmp_path.iterdir()) == [out]  # the next call removed what kills had left


@pytest.mark.parametrize("out", ["results/o", "results", "."])
def test_a_recorded_path_leads_back(tmp_path, monkeypatch, out):
    """Through links, which the system follows before it goes up."""
    (tmp_path / "deep" / "er" / "store").mkdir(parents=True)
    (tmp_path / "results").symlink_to("deep/er/store")
    (tmp_path / "lf.npy").touch()
    (tmp_path / "link.npy").symlink_to("lf.npy")
    monkeypatch.chdir(tmp_path)
    (tmp_path / out).mkdir(parents=True, exist_ok=True)
    for name in ("lf.npy", "link.npy"):
        recorded = recorded_path(name, out)
        assert not os.path.isabs(recorded)  # noqa: PTH117
        assert (tmp_path / out / recorded).samefile(tmp_path / "lf.npy")
