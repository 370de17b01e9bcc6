"""Programs that run in a folder, on one thread, and how they end."""

import fcntl
import functools
import multiprocessing
import os
import re
import resource
import runpy
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing import forkserver
from pathlib import Path
from typing import NamedTuple
from unittest import mock

ROOT = Path(__file__).parents[2]
LIMIT_S = 180.0  # after which a process counts as hanging
END_S = 8.0  # within which the helpers of a killed program must end too
MOST_MEMORY = 16 << 30  # bytes of address space, half of which TensorFlow reserves
PIPE = 1 << 20  # bytes that a program may print before it has to wait for us
LONGEST_SENTENCE = 1000
SENTENCE = re.compile(r"(lf-flame|python -m experiments|Error): ")
ENVIRONMENT = {
    "NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "TF_NUM_INTEROP_THREADS": "1",
    "TF_NUM_INTRAOP_THREADS": "1", "TF_CPP_MIN_LOG_LEVEL": "3", "LF_FLAME_MEMORY_GB": "2",
    "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests")]),
}  # fmt: skip
FOLDERS = "commands", "formats", "optics", "refocus", "scenes", "simulation", "tomography"
PATHS = [path for x in FOLDERS for path in sorted((ROOT / "lf_flame" / x).glob("[!_]*.py"))]
PATHS += sorted(ROOT.glob("experiments/**/commands.py"))
LOADED = [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in PATHS]
"""Modules that each program finds loaded, as loading takes most of a small call's time."""


class Outcome(NamedTuple):
    """How a program ended: its status, None if it did not end in time, and what it printed."""

    status: int | None
    out: str
    err: str


def fault(outcome: Outcome, *allowed: int) -> str:
    """Say what is wrong with how a program ended, by default with 0 or 2; nothing if all is right.

    A status of 2 comes with one sentence.
    """
    err = outcome.err.strip()
    if outcome.status is None:
        return "did not end in time"
    if "Traceback" in outcome.out + err:
        return f"traceback: {err[-300:]}"
    if outcome.status not in (allowed or (0, 2)):
        return f"status {outcome.status}: {err[-300:]}"
    said = [line for line in re.split(r"[\r\n]", err) if SENTENCE.match(line)]
    if outcome.status == 2 and (len(said) != 1 or len(said[0]) > LONGEST_SENTENCE):
        return f"not one sentence: {err[-300:]}"
    return ""


@functools.cache
def _server() -> multiprocessing.context.ForkServerContext:
    """Start a process that has loaded `LOADED` and forks for each program."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(LOADED)
    with mock.patch.dict(os.environ, ENVIRONMENT):
        forkserver.ensure_running()
    return context


def _run(words: list[str], folder: Path, largest_file: int, out, err) -> None:
    """Run a program in a process of its own, as ``python -m`` does."""
    os.setsid()
    os.chdir(folder)
    for number, end in enumerate((Path(os.devnull).open(), out, err)):  # noqa: SIM115
        os.dup2(end.fileno(), number)
    resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, MOST_MEMORY))
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest_file, largest_file))
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.argv, sys.path[:0] = words, [str(folder)]
    runpy.run_module(words[0], run_name="__main__", alter_sys=True)


class Process:
    """A program, as words behind ``python -m``; with its helpers it ends where its context ends.

    What would be longer than ``largest_file`` bytes fails, as on a full disk.
    """

    def __init__(self, words: list[str], folder: Path, largest_file: int = resource.RLIM_INFINITY):
        context, self._folder = _server(), folder
        self._pipes, ends = zip(*(context.Pipe(duplex=False) for _ in range(2)), strict=True)
        for end in ends:
            fcntl.fcntl(end.fileno(), fcntl.F_SETPIPE_SZ, PIPE)
        self._process = context.Process(target=_run, args=(words, folder, largest_file, *ends))
        self._start = time.monotonic()
        self._process.start()
        for end in ends:
            end.close()
        self.pid = self._process.pid

    def __enter__(self) -> "Process":
        return self

    def __exit__(self, *_) -> None:
        self.end()

    @property
    def seconds(self) -> float:
        """Seconds since its start."""
        return time.monotonic() - self._start

    def watch(self, is_due: Callable[[int, float], bool] = lambda changes, seconds: False) -> int:
        """Look at its folder until ``is_due(changes, seconds)`` or its end; count the changes."""
        changes, seen = 0, _look(self._folder)
        while self._process.exitcode is None and self.seconds < LIMIT_S:
            now = _look(self._folder)
            changes, seen = changes + (now != seen), now
            if is_due(changes, self.seconds):
                break
            time.sleep(0.001)
        return changes

    def send(self, number: int) -> None:
        """Kill it alone; send any other signal to its helpers too, as a terminal does."""
        if self._process.exitcode is None:
            (os.kill if number == signal.SIGKILL else os.killpg)(self.pid, number)

    def wait(self, limit_s: float = LIMIT_S) -> Outcome:
        """Wait for its end; what hangs is killed with all its helpers."""
        self._process.join(limit_s)
        status = self._process.exitcode
        if status is None:
            self.end()
        return Outcome(status, *map(_read, self._pipes))

    def leaves_helpers(self, limit_s: float = END_S) -> bool:
        """Whether helpers live on behind its end, when they have had time to end."""
        end = time.monotonic() + limit_s
        with suppress(ProcessLookupError):  # its group has no process any more
            while time.monotonic() < end:
                os.killpg(self.pid, 0)
                time.sleep(0.05)
            return True
        return False

    def end(self) -> None:
        """Kill it and its helpers."""
        for kill in (os.kill, os.killpg):  # it may not have a group yet, or have left only that
            with suppress(ProcessLookupError):
                kill(self.pid, signal.SIGKILL)
        self._process.join()


def _read(pipe) -> str:
    """Read what is in a pipe, whoever still holds it open."""
    os.set_blocking(pipe.fileno(), False)
    with suppress(BlockingIOError), pipe:
        return os.read(pipe.fileno(), PIPE).decode("utf-8", errors="replace")
    return ""


def _look(folder: Path) -> set[tuple[str, int]]:
    """Paths and sizes of what a folder holds, while it may change."""
    found = set()
    for place, _, names in os.walk(folder):
        found.add((place, 0))
        for name in names:
            with suppress(OSError):
                found.add((f"{place}/{name}", os.lstat(f"{place}/{name}").st_size))
    return found
