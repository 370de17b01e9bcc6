"""Worker processes end with the one that started them, whatever ends that."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from lf_flame._common.workers import worker_pool

PROGRAM = """
import os, sys, time
from lf_flame._common.workers import worker_pool

def work(seconds):
    os.write(1, f"{os.getpid()}\\n".encode())  # whole: two of them write to one pipe
    time.sleep(seconds)

if __name__ == "__main__":
    with worker_pool(2) as pool:
        list(pool.map(work, [60, 60]))
"""


def alive(process):
    """Whether a process runs; one that ended and waits to be asked for its status does not."""
    try:
        status = Path(f"/proc/{process}/stat").read_text()
    except FileNotFoundError:
        return False
    return status.rpartition(")")[2].split()[0] != "Z"


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="asks /proc which processes run")
def test_workers_end_with_their_parent(tmp_path):
    (tmp_path / "program.py").write_text(PROGRAM)
    command = [sys.executable, tmp_path / "program.py"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as parent:
        workers = [int(parent.stdout.readline()) for _ in range(2)]
        assert all(map(alive, workers))
        parent.kill()
        parent.wait(10)
    end = time.monotonic() + 10
    while any(map(alive, workers)) and time.monotonic() < end:
        time.sleep(0.05)
    assert not any(map(alive, workers))


INTERRUPTED = """
import os, signal, sys, time
from tqdm import tqdm
from lf_flame._common.workers import worker_pool

def work(seconds):
    with tqdm(disable=True):
        os.write(1, b"working\\n")
        time.sleep(seconds)

if __name__ == "__mp_main__":  # imported by a worker that starts
    os.write(1, f"{os.getpid()}\\n".encode())
    time.sleep(0.5)

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with worker_pool(2) as pool:
            list(pool.map(work, [60, 60]))
    except KeyboardInterrupt:
        sys.exit(130)
"""


@pytest.mark.slow
def test_workers_say_nothing_at_ctrl_c_while_they_start_or_work(tmp_path):
    """A terminal sends it to all processes of a command."""
    (tmp_path / "program.py").write_text(INTERRUPTED)
    command = [sys.executable, tmp_path / "program.py"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, **pipes, start_new_session=True) as parent:
        for _ in range(2):
            os.kill(int(parent.stdout.readline()), signal.SIGINT)
        assert [parent.stdout.readline() for _ in range(2)] == ["working\n"] * 2
        os.killpg(parent.pid, signal.SIGINT)
        _, said = parent.communicate(timeout=30)
    assert (parent.returncode, said) == (130, "")


def _end(_):
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.slow
def test_a_worker_that_is_killed_is_one_sentence():
    words = "was killed, .*finished work is kept"
    with pytest.raises(ChildProcessError, match=words), worker_pool(1) as pool:
        list(pool.map(_end, range(3)))
