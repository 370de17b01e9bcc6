"""Programs as processes: started, limited, killed, and judged by how they end."""

import os
import re
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
LIMIT_S = 180.0
"""Seconds after which a process counts as hanging."""
END_S = 8.0
"""Seconds within which the helpers of a killed program must end too."""
MOST_MEMORY = 16 << 30
"""Bytes of address space, half of which TensorFlow reserves."""
PIPE = 1 << 20
"""Bytes that a program may print before it has to wait for us."""
LONGEST_SENTENCE = 1000
SENTENCE = re.compile(r"(lf-flame|python -m experiments|Error): ")
ENVIRONMENT = {
    "NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "TF_NUM_INTEROP_THREADS": "1",
    "TF_NUM_INTRAOP_THREADS": "1", "TF_CPP_MIN_LOG_LEVEL": "3", "LF_FLAME_MEMORY_GB": "2",
    "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
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


class Process:
    """A program that runs in a folder, on one thread.

    Parameters
    ----------
    words : list of str
        Module behind ``python -m``, and its arguments.
    folder : Path
        Working directory.
    largest_file : int, optional
        Bytes; what would be longer fails, as on a full disk.
    """

    def __init__(self, words: list[str], folder: Path, largest_file: int | None = None):
        self._start, self._folder = time.monotonic(), folder
        self._popen = subprocess.Popen(
            [sys.executable, "-m", *words], cwd=folder, env=os.environ | ENVIRONMENT,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            pipesize=PIPE, start_new_session=True,
        )  # fmt: skip
        self.pid = self._popen.pid
        resource.prlimit(self.pid, resource.RLIMIT_AS, (MOST_MEMORY, MOST_MEMORY))
        if largest_file is not None:
            resource.prlimit(self.pid, resource.RLIMIT_FSIZE, (largest_file, largest_file))

    @property
    def seconds(self) -> float:
        """Seconds since its start."""
        return time.monotonic() - self._start

    def watch(self, is_due: Callable[[int, float], bool] = lambda changes, seconds: False) -> int:
        """Look at its folder until ``is_due(changes, seconds)`` or its end; count the changes."""
        changes, seen = 0, _look(self._folder)
        while self._popen.poll() is None and self.seconds < LIMIT_S:
            now = _look(self._folder)
            changes, seen = changes + (now != seen), now
            if is_due(changes, self.seconds):
                break
            time.sleep(0.001)
        return changes

    def send(self, number: int) -> None:
        """Kill it alone; send any other signal to its helpers too, as a terminal does."""
        if self._popen.poll() is None:
            (os.kill if number == signal.SIGKILL else os.killpg)(self.pid, number)

    def wait(self, limit_s: float = LIMIT_S) -> Outcome:
        """Wait for its end; what hangs is killed with all its helpers."""
        status = None
        with suppress(subprocess.TimeoutExpired):
            status = self._popen.wait(limit_s)
        if status is None:
            self.end()
        return Outcome(status, _read(self._popen.stdout), _read(self._popen.stderr))

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
        self._popen.wait()


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
    with pipe:
        return (pipe.read() or b"").decode("utf-8", errors="replace")


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
