"""Real processes: started, limited, killed, and looked for afterwards."""

import os
import resource
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from campaigning.verdicts import Outcome

ROOT = Path(__file__).parents[2]
MARK = "LF_FLAME_CAMPAIGN"
"""Variable of the environment by which a process and its children are found."""

LIMIT_S = 180.0
"""After which a process counts as hanging."""

END_S = 8.0
"""After which what a process has started must have ended too."""


PIPE = 1 << 20
"""Bytes that a program may print before it has to wait for us."""


def surroundings() -> dict[str, str]:
    """Environment of a program: one thread, and nothing that leads elsewhere."""
    return os.environ | {
        "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests")]),
        "PYTHONDONTWRITEBYTECODE": "1",
        "NUMBA_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
        "TF_NUM_INTRAOP_THREADS": "1",
        "TF_NUM_INTEROP_THREADS": "1",
        "TF_CPP_MIN_LOG_LEVEL": "3",
    }


class Process:
    """A program that runs in a folder of its own.

    Parameters
    ----------
    words : list of str
        Module behind ``python -m``, and its arguments.
    home : Path
        Where it is called.
    largest_file : int, optional
        Bytes; what would be longer fails, as on a full disk.
    environment : dict of str, optional
        More of it.
    """

    def __init__(
        self, words: list[str], home: Path, largest_file: int | None = None,
        environment: dict[str, str] | None = None,
    ):  # fmt: skip
        self.mark = secrets.token_hex(8)
        self.started = time.monotonic()
        self._process = subprocess.Popen(
            [sys.executable, "-m", *words], cwd=home, stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, pipesize=PIPE, start_new_session=True,
            env=surroundings() | (environment or {}) | {MARK: self.mark},
        )  # fmt: skip
        if largest_file is not None:
            limits = (largest_file, largest_file)
            resource.prlimit(self._process.pid, resource.RLIMIT_FSIZE, limits)

    @property
    def runs(self) -> bool:
        """Whether it has not ended."""
        return self._process.poll() is None

    def kill(self) -> None:
        """Kill it alone, and not what it has started."""
        self._process.kill()

    def interrupt(self) -> None:
        """Interrupt it and what it has started, as Ctrl-C in a terminal does."""
        if self.runs:
            os.killpg(self._process.pid, signal.SIGINT)

    def wait(self, limit_s: float = LIMIT_S) -> Outcome:
        """Wait for its end; what hangs is killed with all that it has started."""
        try:
            status = self._process.wait(limit_s)
        except subprocess.TimeoutExpired:
            status = None
        seconds = time.monotonic() - self.started
        if status is None:
            self.end()
        out, err = (_read(pipe) for pipe in (self._process.stdout, self._process.stderr))
        return Outcome(status, out, err, seconds)

    def survivors(self, wait_s: float = END_S) -> int:
        """Count the processes that it has left behind, when they have had time to end."""
        end = time.monotonic() + wait_s
        while (left := len(self._marked())) and time.monotonic() < end:
            time.sleep(0.05)
        return left

    def end(self) -> None:
        """Kill it and all that it has started."""
        for pid in self._marked():
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                continue
        self._process.wait()

    def _marked(self) -> list[int]:
        mark, found = f"{MARK}={self.mark}".encode(), []
        for path in Path("/proc").glob("[0-9]*/environ"):
            try:
                if mark in path.read_bytes().split(b"\0"):
                    found.append(int(path.parent.name))
            except OSError:  # it has ended, or is another user's
                continue
        return found


def _read(pipe) -> str:
    """Read what is in a pipe, whoever holds it open still."""
    os.set_blocking(pipe.fileno(), False)
    with pipe:
        return (pipe.read() or b"").decode("utf-8", errors="replace")


def call(words: list[str], home: Path, limit_s: float = LIMIT_S, **options) -> Outcome:
    """Run a program to its end."""
    process = Process(words, home, **options)
    try:
        return process.wait(limit_s)
    finally:
        process.end()


class Changes:
    """Counts how often something has changed in a folder, as far as looking now and then shows.

    Parameters
    ----------
    home : Path
    """

    def __init__(self, home: Path):
        self._home, self._inputs = home, {entry.name for entry in os.scandir(home)}
        self._seen = self._look(home)
        self.count = 0

    def look(self) -> int:
        """Look again."""
        now = self._look(self._home)
        self.count += now != self._seen
        self._seen = now
        return self.count

    def _look(self, folder: Path) -> set[tuple[str, int]]:
        found = set()
        with suppress(OSError), os.scandir(folder) as entries:  # it may change under our eyes
            for entry in entries:
                if folder is self._home and entry.name in self._inputs:
                    continue
                inside = entry.is_dir(follow_symlinks=False)
                found.add((entry.path, 0 if inside else entry.stat(follow_symlinks=False).st_size))
                if inside:
                    found |= self._look(Path(entry.path))
        return found


def watch(process: Process, home: Path, stop: Callable[[int, float], bool]) -> int:
    """Look at a folder while a process runs, until ``stop(changes, seconds)`` or its end.

    Returns
    -------
    int
        How often something has changed.
    """
    changes = Changes(home)
    while process.runs:
        seconds = time.monotonic() - process.started
        if stop(changes.look(), seconds) or seconds > LIMIT_S:
            break
        time.sleep(0.001)
    return changes.look()
