"""Processes are killed at random moments, run in pairs, or stopped by a full disk."""

import json
import random
import shutil
import signal
import subprocess
import sys
import time

import pytest

FILE = """
from lf_flame._common.atomic_files import write_text
def write(place, text):
    write_text(place, text * 300_000)
"""

FOLDER = """
from lf_flame._common.atomic_files import write_text
from lf_flame._common.output_folders import output_folder
def write(place, text):
    with output_folder(place, "work.json", overwrite=True) as out:
        for k in range(20):
            write_text(out.path(f"{k}.txt"), text * 1000)
"""

FOR_EVER = """
import itertools, sys
print("ready", flush=True)
for k in itertools.count():
    write(sys.argv[1], str(k % 10))
"""

ONCE = FOLDER + "import sys\nprint('ready', flush=True)\nwrite(sys.argv[1], 'x')"


def start(code, *arguments):
    command = [sys.executable, "-c", code, *map(str, arguments)]
    pipe = subprocess.PIPE
    process = subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True)
    assert process.stdout.readline() == "ready\n"
    return process


def kill_later(process, seconds):
    time.sleep(seconds)
    process.send_signal(signal.SIGKILL)
    process.communicate()


def is_whole(folder):
    """Whether a folder holds all files of its record, of one call."""
    record = json.loads((folder / "work.json").read_text())
    texts = {(folder / name).read_text() for name in record["files"]}
    return len(record["files"]) == 20 and len(texts) == 1


@pytest.mark.slow
def test_a_killed_writer_leaves_a_whole_file(tmp_path):
    rng, out = random.Random(1), tmp_path / "out"
    out.write_text("0" * 300_000)
    for _ in range(8):
        kill_later(start(FILE + FOR_EVER, out), rng.uniform(0, 0.2))
        text = out.read_text()
        assert text == text[0] * 300_000


@pytest.mark.slow
def test_a_killed_writer_leaves_a_whole_folder(tmp_path):
    """The old one under its own name or a sibling's, until the new one has its name."""
    rng, out = random.Random(2), tmp_path / "out"
    start(ONCE, out).communicate()
    for _ in range(10):
        kill_later(start(FOLDER + FOR_EVER, out), rng.uniform(0.05, 0.3))
        siblings = list(tmp_path.glob("out.old-*"))
        assert is_whole(out) if out.exists() else any(map(is_whole, siblings))
        for left in siblings if out.exists() else ():
            shutil.rmtree(left)
    start(ONCE, out).communicate()
    assert is_whole(out)
    assert list(tmp_path.iterdir()) == [out]  # the next call removed what kills had left


@pytest.mark.slow
def test_of_two_writers_at_once_one_is_refused_until_the_other_ends(tmp_path):
    slow = FOLDER.replace("    with", "    import time\n    with").replace(
        "        for", "        print('ready', flush=True)\n        time.sleep(60)\n        for"
    )
    first = start(slow + "import sys\nwrite(sys.argv[1], 'a')", tmp_path / "out")
    _, told = start(ONCE, tmp_path / "out").communicate()
    assert "InputError: " in told
    assert "out is being written by another process" in told
    kill_later(first, 0)
    start(ONCE, tmp_path / "out").communicate()
    assert is_whole(tmp_path / "out")
