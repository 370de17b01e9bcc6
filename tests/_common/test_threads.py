"""Compiled loops: every piece once, whoever calls, and what is kept of them on disk."""

import os
import platform
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numba
import numpy as np
import pytest

from lf_flame._common.threads import COMPILING, NOT_KEPT, one_thread, parallel

LOOP = """
import logging, os, sys, threading
import numpy as np
from factor import times
from lf_flame._common import threads

@threads.parallel(lambda values: values.size)
def fill(k, values):
    values[k] = times(k)

def filled(count=100):
    values = np.zeros(count)
    fill(values)
    return values

if __name__ == "__main__":
    logging.basicConfig(level="INFO", format="%(message)s")
    print(filled(3).tolist())
"""

compiled = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")


@parallel(lambda total: total.size)
def count(k, done, total):
    """Spend some time on each piece."""
    for _ in range(2000):
        total[k] = np.cos(total[k])
    done[k] += 1


def counted(size):
    done, total = np.zeros(size, np.int64), np.linspace(0, 1, size)
    count(done, total)
    return done, total


@pytest.mark.parametrize("size", [0, 1, 2, 33, 300])
def test_each_piece_is_done_once(size):
    np.testing.assert_array_equal(counted(size)[0], 1)


def test_eight_callers_at_once():
    expected = counted(300)
    with ThreadPoolExecutor(8) as callers:
        for found in callers.map(counted, [300] * 40):
            np.testing.assert_array_equal(found, expected)


@compiled
def test_one_thread_is_the_callers_own():
    @parallel(lambda who: who.size)
    def note(k, who):
        who[k] = numba.get_thread_id() + 1

    who = np.zeros(1000, np.int64)
    with one_thread():
        note(who)
    np.testing.assert_array_equal(who, 1)


@compiled
@pytest.mark.parametrize("bad", [0, 299])
def test_an_error_in_any_thread_is_an_error(bad):
    @parallel(lambda values: values.size)
    def invert(k, values):
        values[k] = 1 / values[k]

    values = np.ones(300)
    values[bad] = 0
    with pytest.raises(RuntimeError, match="division by 0"):
        invert(values)


@pytest.fixture
def loop(tmp_path):
    """Run a loop in a process of its own, from a file that calls a function of another."""
    (tmp_path / "loop.py").write_text(LOOP)

    def run(*command, factor=2, before=(), **environment):
        text = f"from numba import njit\n@njit\ndef times(k):\n    return {factor} * k\n"
        path = tmp_path / "factor.py"
        if not path.exists() or path.read_text() != text:  # a later date would compile it anew
            path.write_text(text)
        unset = ("XDG_CACHE_HOME", "NUMBA_CACHE_DIR", "NUMBA_THREADING_LAYER")
        kept = {name: value for name, value in os.environ.items() if name not in unset}
        return subprocess.run(
            [*before, sys.executable, "-B", *command],  # -B: Python keeps nothing itself
            capture_output=True,
            text=True,
            cwd=tmp_path,
            env={**kept, **environment},
            timeout=120,
        )

    return run


FORKED = """
import numba
from loop import *
def child():
    assert filled().sum() == 9900
def fork():
    number = os.fork()
    if number == 0:
        code = 1
        try:
            child()
            code = 0
        finally:
            os._exit(code)
    assert os.waitpid(number, 0)[1] == 0
def busy():
    while not ended.is_set():
        filled()
child()
fork()
ended = threading.Event()
callers = [threading.Thread(target=busy) for _ in range(8)]
for caller in callers:
    caller.start()
for _ in range(3):
    fork()
ended.set()
for caller in callers:
    caller.join()
child()
print("survived", numba.threading_layer())
"""


@pytest.mark.slow
@compiled
def test_forks_after_use_callers_at_once_and_a_late_thread_are_survived(loop):
    """With Numba's own `prange` alone, omp ends a forked process, and workqueue callers at once."""
    everywhere = (sys.platform, platform.machine()) == ("linux", "x86_64")
    for layer in ("tbb", "omp", "workqueue") if everywhere else ("workqueue",):
        chosen = {} if layer == "tbb" else {"NUMBA_THREADING_LAYER": layer}
        done = loop("-W", "ignore", "-c", FORKED, **chosen)
        assert done.returncode == 0, done.stderr
        assert done.stdout.splitlines()[-1] == f"survived {layer}"  # after words of tbb's own
    late = "import time; from loop import *\ndef late(): time.sleep(0.5); print(filled().sum())"
    done = loop("-c", f"{late}\nthreading.Thread(target=late).start()")
    assert (done.stdout, done.stderr) == ("9900.0\n", "")


@pytest.mark.slow
@compiled
def test_loops_are_kept_on_disk_and_files_that_do_not_fit_cost_a_compilation(loop, tmp_path):
    """Another file changed, at which Numba itself does not look; damage; a full disk."""

    def check(factor, compiles):
        done = loop("loop.py", factor=factor)
        assert done.stdout == f"[0.0, {factor}.0, {2 * factor}.0]\n"
        assert (COMPILING in done.stderr) == compiles

    check(2, True)
    check(2, False)
    check(3, True)
    for kind, content in (("nbi", b"\x80\x05\x95"), ("nbc", b"no pickle")):
        (path,) = tmp_path.rglob(f"*.{kind}")
        path.write_bytes(content)
        check(3, True)
    shutil.rmtree(tmp_path / "__pycache__")
    full = loop("-c", "import resource, loop; resource.setrlimit(resource.RLIMIT_FSIZE, (99, 99));"
                "print(loop.filled(3).tolist())", factor=3)  # fmt: skip
    assert full.stdout == "[0.0, 3.0, 6.0]\n", full.stderr
    assert not list(tmp_path.rglob("*.nbc"))


def unprivileged():
    """Give the words that let a command obey permissions, which root does not."""
    if os.geteuid() != 0:
        return []
    if shutil.which("setpriv") is None:
        pytest.skip("runs as root, and there is no setpriv")
    return ["setpriv", "--bounding-set=-all", "--inh-caps=-all"]


@compiled
@pytest.mark.slow
def test_without_a_folder_to_write_loops_are_compiled_at_each_start(loop, tmp_path):
    """In containers a package is often read-only, and HOME nowhere."""
    if not Path("/proc").is_dir():
        pytest.skip("there is no folder in which nobody can write")
    loop("-c", "")
    tmp_path.chmod(0o555)
    try:
        done = loop("loop.py", before=unprivileged(), HOME="/proc/nowhere")
    finally:
        tmp_path.chmod(0o755)
    assert (done.returncode, done.stdout) == (0, "[0.0, 2.0, 4.0]\n"), done.stderr
    assert NOT_KEPT in done.stderr.splitlines()
    assert {path.name for path in tmp_path.iterdir()} == {"loop.py", "factor.py"}
