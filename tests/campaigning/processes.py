"""Programs as processes: started, limited, killed, and judged by how they end."""

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
from dataclasses import dataclass
from multiprocessing import forkserver
from pathlib import Path
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


@dataclass(frozen=True)
class Outcome:
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


FOLDERS = ("commands", "formats", "optics", "refocus", "scenes", "simulation", "tomography")
PATHS = [path for x in FOLDERS for path in sorted((ROOT / "lf_flame" / x).glob("[!_]*.py"))]
PATHS += sorted(ROOT.glob("experiments/*/commands.py"))
LOADED = [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in PATHS]
"""Modules that each program finds loaded, as loading takes most of a small call's time."""


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
    """A program, as words behind ``python -m``, that runs in a folder on one thread.

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

    def helpers(self) -> list[int]:
        """Other processes of its session that have not ended."""
        found = []
        for pid in (int(x.name) for x in Path("/proc").iterdir() if x.name.isdigit()):
            with suppress(ProcessLookupError):
                if pid != self.pid and os.getsid(pid) == self.pid:
                    found.append(pid)
        return found

    def left_behind(self) -> int:
        """Number of helpers that live on, when they have had time to end."""
        end = time.monotonic() + END_S
        while (left := len(self.helpers())) and time.monotonic() < end:
            time.sleep(0.05)
        return left

    def end(self) -> None:
        """Kill it and its helpers."""
        for pid in (self.pid, *self.helpers()):
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self._process.join()


def call(words: list[str], folder: Path, limit_s: float = LIMIT_S, **options) -> Outcome:
    """Run a program to its end."""
    process = Process(words, folder, **options)
    try:
        return process.wait(limit_s)
    finally:
        process.end()


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
                path = f"{place}/{name}"
                found.add((path, os.lstat(path).st_size))
    return found
