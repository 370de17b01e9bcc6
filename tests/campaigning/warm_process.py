"""A process that has loaded everything, and calls commands one after another, each in a folder."""

import contextlib
import json
import os
import re
import resource
import subprocess
import sys
import threading
import time
import traceback
from pathlib import Path

from campaigning.processes import surroundings
from campaigning.verdicts import Outcome

ROOM = 5 << 30
"""Bytes that a command may take beyond what is loaded, before there is no memory for it."""

START_S = 180.0


class WarmProcess:
    """Calls commands in a process that is started when it is needed, and anew when it has died.

    Parameters
    ----------
    folder : Path
        For what is printed.
    learning : bool
        Whether to load TensorFlow at the start.
    """

    def __init__(self, folder: Path, learning: bool = True):
        self._folder, self._learning = folder, learning
        self._process: subprocess.Popen | None = None

    def call(self, words: list[str], home: Path, limit_s: float) -> Outcome:
        """Call a command in a folder; what hangs is killed, and the process with it."""
        process = self._process or self._start()
        started = time.monotonic()
        answer = self._ask({"words": words, "home": str(home)}, limit_s)
        seconds = time.monotonic() - started
        out, err = (
            (self._folder / name).read_text(encoding="utf-8", errors="replace")
            for name in ("out", "err")
        )
        if answer is not None:
            return Outcome(answer["status"], out, err, seconds, answer["grown"])
        status = None if seconds >= limit_s else process.wait()
        self.end()
        return Outcome(status, out, err, seconds)

    def _start(self) -> subprocess.Popen:
        self._folder.mkdir(exist_ok=True)
        command = [sys.executable, "-m", "campaigning.warm_process", str(self._folder)]
        self._process = subprocess.Popen(
            [*command, "learning"] if self._learning else command, env=surroundings(),
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True, text=True,
        )  # fmt: skip
        if self._ask({}, START_S) is None:
            raise RuntimeError("The process that calls commands does not start.")
        return self._process

    def _ask(self, job: dict, limit_s: float) -> dict | None:
        """Wait for the answer to a job; none if the process dies, or is killed as it hangs."""
        process = self._process
        alarm = threading.Timer(limit_s, process.kill)
        alarm.start()
        try:
            process.stdin.write(json.dumps(job) + "\n")
            process.stdin.flush()
            line = process.stdout.readline()
        except OSError:
            line = ""
        finally:
            alarm.cancel()
        return json.loads(line) if line else None

    def end(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process.stdin.close()
            self._process.stdout.close()
            self._process = None


def _serve(folder: Path, learning: bool) -> None:
    """Call what is asked for until nothing is asked any more."""
    asked, answers = os.fdopen(os.dup(0)), os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    programs = _load(learning)
    taken = _memory("VmSize")
    resource.setrlimit(resource.RLIMIT_AS, (taken + ROOM, taken + ROOM))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for line in asked:
        job = json.loads(line)
        answer = _call(programs, job["words"], job["home"], folder) if job else {}
        print(json.dumps(answer), file=answers, flush=True)


def _load(learning: bool) -> dict:
    """Import what takes time, and give the programs by their modules."""
    import scipy.fft  # noqa: F401

    import lf_flame.formats.reading
    import lf_flame.simulation.rendering  # noqa: F401
    from experiments import __main__ as experiments
    from lf_flame.commands import cli

    if learning:
        from lf_flame.learning.keras_loading import load_keras

        load_keras()
        import keras  # noqa: F401

        import lf_flame.learning.training
        import lf_flame.systems.training  # noqa: F401
    return {
        "lf_flame": (cli.commands, "lf-flame"),
        "experiments": (experiments.commands, "python -m experiments"),
    }


def _call(programs: dict, words: list[str], home: str, folder: Path) -> dict:
    commands, name = programs[words[0]]
    os.chdir(home)
    sys.argv = [name, *words[1:]]
    before = _memory("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")  # forgets the peak
    with _redirected(folder):
        status = _run(commands, name)
    return {"status": status, "grown": max(_memory("VmHWM") - before, 0)}


def _run(commands, name: str) -> int:
    from lf_flame.commands import program

    try:
        program.run(commands, name)
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        traceback.print_exc()
        return 1
    return 0


@contextlib.contextmanager
def _redirected(folder: Path):
    """Let all that is printed go to files."""
    kept = [os.dup(number) for number in (1, 2)]
    try:
        for number, name in ((1, "out"), (2, "err")):
            file = os.open(folder / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(file, number)
            os.close(file)
        yield
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        for number, before in zip((1, 2), kept, strict=True):
            os.dup2(before, number)
            os.close(before)


def _memory(name: str) -> int:
    """Read a size of this process, in bytes."""
    text = Path("/proc/self/status").read_text(encoding="utf-8")
    return 1024 * int(re.search(rf"{name}:\s+(\d+)", text)[1])


if __name__ == "__main__":
    _serve(Path(sys.argv[1]), "learning" in sys.argv[2:])
