"""Processing of a video that is killed at random moments, and what the same command makes then."""

import os
import random
import signal
import time
from pathlib import Path
from shutil import copytree
from typing import NamedTuple

import numpy as np
import pytest
from PIL import Image

from campaigning.contents import contents, differences
from campaigning.processes import Process, fault
from lf_flame.errors import InputError
from lf_flame.flame_video import look_at

FRAMES, TASKS, SIDE = 160, 20, 600
LINE = "lf_flame process frames --views 3 --steps refocus@0,height,contour --out out"
ONE, POOL, CLUSTER = "--workers 1", "--workers 2", "--local-cluster 2"
PROGRAM, WORKER = "program", "worker"
KILLS = [(POOL, PROGRAM)] * 16 + [(POOL, WORKER), (CLUSTER, PROGRAM)] + [(CLUSTER, WORKER)] * 2
"""Where the frames are processed, and what is killed."""


class Whole(NamedTuple):
    """What undisturbed calls make, and their seconds by where the frames are processed."""

    contents: dict[str, str]
    seconds: dict[str, float]


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    """Lenslet images of 3 x 3 views of a column of light whose height changes."""
    folder = tmp_path_factory.mktemp("video")
    (folder / "frames").mkdir()
    y, x = np.indices((SIDE, SIDE))
    for k in range(FRAMES):
        lit = (abs(x / SIDE - 0.5) < 0.2) & (y / SIDE > 0.33 + 0.14 * np.sin(k))
        picture = Image.fromarray(np.where(lit, 200, 0).astype(np.uint8))
        picture.save(folder / f"frames/{k:03d}.png")
    return folder


@pytest.fixture(scope="module")
def whole(video, tmp_path_factory):
    """Undisturbed calls of all kinds, which make the same."""
    found, seconds = {}, {}
    for way in (ONE, POOL, CLUSTER):
        folder = Path(copytree(video, tmp_path_factory.mktemp("whole") / "a"))
        with Process(f"{LINE} {way}".split(), folder) as process:
            outcome = process.wait()
            seconds[way] = process.seconds
        assert not fault(outcome, 0), fault(outcome, 0)
        found[way] = contents(folder)
        assert not differences(found[way], found[ONE]), way
    return Whole(found[ONE], seconds)


@pytest.mark.parametrize("draw", range(len(KILLS)))
def test_killed_videos(video, whole, tmp_path, draw, request, record_property):
    """The same command goes on after a kill, and makes the same bytes."""
    rng = random.Random(f"{request.config.getoption('seed')}:{draw}")
    (way, what), folder = KILLS[draw], Path(copytree(video, tmp_path / "a"))
    words = f"{LINE} {way}".split()
    with Process(words, folder) as process:
        # Most at any task but the last ones, which would end before the kill; some at any time.
        due, tasks = rng.random() * whole.seconds[way], rng.randrange(1, TASKS - 2)
        if what == PROGRAM and draw % 4 == 0:
            process.watch(lambda changes, seconds: seconds >= due)
        else:
            ended = folder / "out.part/state/c"
            process.watch(lambda changes, seconds: sum(1 for _ in ended.glob("*")) >= tasks)
        seconds, done = process.seconds, count_done(folder / "out")
        if what == PROGRAM:
            process.send(signal.SIGKILL)
        else:
            os.kill(rng.choice(workers_of(process.pid)), signal.SIGKILL)
        outcome = process.wait()
        assert not process.leaves_helpers()
    if (way, what) == (CLUSTER, WORKER):  # another worker takes over
        assert not fault(outcome, 0)
    again = time.monotonic()
    with Process(words, folder) as process:
        assert not fault(process.wait(), 0)
    again = time.monotonic() - again
    record_property("kind", "kills of videos")
    record_property("command", "process")
    record_property("row", {
        "processed by": f"`{way}`", "killed": what, "after (s)": f"{seconds:.1f}",
        "undisturbed (s)": f"{whole.seconds[way]:.1f}", "frames done": f"{done} of {FRAMES}",
        "status": str(outcome.status), "again (s)": f"{again:.1f}",
        "bytes": differences(contents(folder), whole.contents) or "the same",
    })  # fmt: skip
    assert not differences(contents(folder), whole.contents)


def count_done(out: Path) -> int:
    """Count the frames that are done, in a folder that may not be there yet."""
    try:
        return FRAMES - look_at(out).counts["to_do"]
    except InputError:
        return 0


def workers_of(program: int) -> list[int]:
    """Numbers of the worker processes of a program, which Python started anew."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            mine = os.getpgid(int(folder.name)) == program
            if mine and b"spawn_main" in (folder / "cmdline").read_bytes():
                found.append(int(folder.name))
        except OSError:  # it has ended
            continue
    return found
