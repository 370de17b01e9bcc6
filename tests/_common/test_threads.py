"""Pieces of a compiled loop: each done once, whoever is there to do it."""

import multiprocessing
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np
import pytest
from numba import njit

from lf_flame._common import threads
from lf_flame._common.threads import pieces, shared


@njit
def slowly(value):
    """Spend some time on a number."""
    for _ in range(2000):
        value = np.sin(value)
    return value


def _count(queue, done, total):
    for k in pieces(queue, done.size):
        total[k] = slowly(float(k))
        done[k] += 1


count = shared(_count)


@pytest.fixture
def two_threads():
    if numba.config.NUMBA_NUM_THREADS < 2 or numba.config.DISABLE_JIT:
        pytest.skip("needs two cores, and compiled loops")
    before = numba.get_num_threads()
    numba.set_num_threads(2)
    yield
    numba.set_num_threads(before)


@pytest.mark.parametrize("size", [0, 1, 2, 1000])
def test_each_piece_is_done_once(size):
    done, total = np.zeros(size, np.int64), np.zeros(size)
    count(done, total)
    np.testing.assert_array_equal(done, 1)


def test_the_caller_can_do_all_alone(monkeypatch):
    monkeypatch.setattr(threads, "_helpers", None)
    done = np.zeros(10, np.int64)
    count.alone(done, np.zeros(10))
    np.testing.assert_array_equal(done, 1)


def test_many_callers_at_once():
    def call(_):
        done = np.zeros(300, np.int64)
        count(done, np.zeros(300))
        return done

    with ThreadPoolExecutor(8) as callers:
        for done in callers.map(call, range(40)):
            np.testing.assert_array_equal(done, 1)


@pytest.mark.slow
@pytest.mark.jit
def test_helpers_help(two_threads):
    """Two threads take part: a loop in which each piece notes who does it."""
    seen = set()
    original = count.compiled

    def noted(*arguments):
        seen.add(threading.get_ident())
        original(*arguments)

    for _ in range(50):  # a helper may be late now and then
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(count, "compiled", noted)
            count(np.zeros(5000, np.int64), np.zeros(5000))
        if len(seen) == 2:
            break
    assert len(seen) == 2


def test_nobody_waits_for_a_helper_that_is_held_up(two_threads):
    done, held = np.zeros(100, np.int64), threading.Event()
    count(done, np.zeros(100))  # compiles
    pool = threads._helpers(threads.os.getpid())
    jobs = [pool.submit(held.wait, 60) for _ in range(pool._max_workers)]
    started = time.monotonic()
    try:
        count(done, np.zeros(100))
    finally:
        held.set()
    assert time.monotonic() - started < 30
    np.testing.assert_array_equal(done, 2)
    assert all(job.result() for job in jobs)


def _in_child(connection):
    done = np.zeros(1000, np.int64)
    count(done, np.zeros(1000))
    connection.send(done.tolist())


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_process_has_helpers_of_its_own(two_threads):
    count(np.zeros(10, np.int64), np.zeros(10))
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe()
    child = context.Process(target=_in_child, args=(there,))
    child.start()
    assert here.poll(60)
    assert here.recv() == [1] * 1000
    child.join(10)
    assert child.exitcode == 0


def test_nobody_works_on_behind_a_call_that_was_interrupted(two_threads):
    """As Ctrl-C between handing work to a helper and beginning oneself."""
    done = np.zeros(200_000, np.int64)
    count(np.zeros(1, np.int64), np.zeros(1))  # compiles
    submit = ThreadPoolExecutor.submit

    def interrupted(*arguments):
        submit(*arguments)
        time.sleep(0.001)
        raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ThreadPoolExecutor, "submit", interrupted)
        with pytest.raises(KeyboardInterrupt):
            count(done, np.zeros(done.size))
    time.sleep(0.5)  # a helper finishes what it has in hand
    left = done.copy()
    time.sleep(0.5)
    np.testing.assert_array_equal(done, left)
    assert done.sum() < done.size


@pytest.mark.slow
def test_a_thread_that_outlives_the_program_does_without_helpers(tmp_path):
    """The pool takes no work then."""
    (tmp_path / "late.py").write_text(
        "import threading, time, numpy as np\n"
        "from lf_flame.refocus import shift_and_sum\n"
        "def late():\n"
        "    time.sleep(0.5)\n"
        "    print(shift_and_sum(np.ones((3, 3, 8, 8), np.float32), 0.5).mean())\n"
        "threading.Thread(target=late).start()\n"
    )
    done = subprocess.run(
        [sys.executable, tmp_path / "late.py"], capture_output=True, text=True, check=True
    )
    assert (done.stdout.strip(), done.stderr) == ("1.0", "")


@pytest.mark.slow
@pytest.mark.jit
def test_loops_kept_on_disk_are_those_of_all_files_they_are_compiled_from(tmp_path):
    """Numba itself looks at the loop's own file alone."""
    (tmp_path / "loop.py").write_text(
        "import numpy as np\n"
        "from factor import times\n"
        "from lf_flame._common.threads import pieces, shared\n"
        "def _fill(queue, values):\n"
        "    for k in pieces(queue, values.size):\n"
        "        values[k] = times(k)\n"
        "fill = shared(_fill)\n"
        "values = np.zeros(3)\n"
        "fill(values)\n"
        "print(values, sum(fill.compiled.stats.cache_hits.values()))\n"
    )
    for factor, kept in ((2, 0), (2, 1), (3, 0)):
        (tmp_path / "factor.py").write_text(
            f"from numba import njit\n@njit\ndef times(k):\n    return {factor} * k\n"
        )
        run = [sys.executable, "-B", "-c", "import loop"]  # -B: Python keeps nothing itself
        done = subprocess.run(run, capture_output=True, text=True, check=True, cwd=tmp_path)
        assert done.stdout.strip() == f"[0. {factor}. {2 * factor}.] {kept}"


def test_an_error_in_a_helper_is_not_lost(two_threads):
    def fail(*_):
        if threading.current_thread() is not threading.main_thread():
            raise ValueError("mine")
        time.sleep(0.5)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(count, "compiled", fail)
        with pytest.raises(ValueError, match="mine"):
            count(np.zeros(10, np.int64), np.zeros(10))
