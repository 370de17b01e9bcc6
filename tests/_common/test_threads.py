"""Pieces of a compiled loop: each done once, whoever is there to do it."""

import multiprocessing
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


def test_an_error_in_a_helper_is_not_lost(two_threads):
    def fail(*_):
        if threading.current_thread() is not threading.main_thread():
            raise ValueError("mine")
        time.sleep(0.5)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(count, "compiled", fail)
        with pytest.raises(ValueError, match="mine"):
            count(np.zeros(10, np.int64), np.zeros(10))
