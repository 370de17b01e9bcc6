import os
import subprocess
import sys

import pytest
from click.testing import CliRunner

from lf_flame._common.printable import printable
from lf_flame.commands.cli import commands
from lf_flame.commands.program import LONGEST


def ended(code, **environment):
    """Run a program of one command that holds some lines of code."""
    lines = "import click\nfrom lf_flame.commands import program\n@click.command()\ndef show():\n"
    code = f"{lines}    {code}\nprogram.run(show, 'show')"
    known = {k: v for k, v in os.environ.items() if k != "NUMBA_NUM_THREADS"} | environment
    return subprocess.run([sys.executable, "-c", code], env=known, capture_output=True, text=True)


@pytest.mark.parametrize("threads", ["0", "100000", "two", ""])
def test_a_number_of_threads_that_numba_cannot_start_is_one_sentence(threads):
    result = ended("import numba", NUMBA_NUM_THREADS=threads)
    assert result.returncode == 2
    told = f"NUMBA_NUM_THREADS must be a whole number from 1 to 1024, got {threads!r}.\n"
    assert result.stderr == f"show: {told}"


@pytest.mark.parametrize("date", ["x", ""])
def test_a_date_that_numpy_cannot_read_does_no_harm(date):
    result = ended("import numpy.f2py", SOURCE_DATE_EPOCH=date)
    assert (result.returncode, result.stderr) == (0, "")


@pytest.mark.slow
def test_a_backend_for_screens_is_not_asked_for():
    result = ended("from lf_flame._common import figures; figures.subplots()", MPLBACKEND="bogus")
    assert (result.returncode, result.stderr) == (0, "")


def test_an_end_of_file_in_our_own_work_is_no_interruption():
    result = ended("raise EOFError('ours')")
    assert result.returncode == 1
    assert "EOFError: ours" in result.stderr


def test_an_interruption_that_a_library_made_an_error_of_is_one_still():
    """As NumPy does where Ctrl-C meets it while it compares dtypes."""
    result = ended("""
    try:
        raise KeyboardInterrupt
    except KeyboardInterrupt as error:
        raise TypeError("Cannot compare structured arrays") from error
""")
    assert result.returncode == 130
    assert result.stderr.startswith("show: Stopped.")


def test_an_interruption_is_no_damage():
    """A reader takes what NumPy made of Ctrl-C for a damaged file, and says to remove it."""
    result = ended("""
    from lf_flame._common.input_files import readable
    with readable(__import__("sys").executable, (TypeError,)):
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as error:
            raise TypeError("Cannot compare structured arrays") from error
""")
    assert (result.returncode, result.stderr[:13]) == (130, "show: Stopped")


@pytest.mark.slow
def test_an_interruption_in_a_destructor_is_not_lost():
    result = ended("""
    import signal, time

    signal.signal(signal.SIGINT, signal.default_int_handler)  # tests may run in the background

    class Ended:
        def __del__(self):
            raise KeyboardInterrupt

    Ended()
    time.sleep(5)
    print("went on")
""")
    assert (result.returncode, result.stdout) == (130, "")
    assert result.stderr.lstrip().startswith("show: Stopped.")
    assert result.stderr.strip().count("\n") == 0


def test_tasks_that_an_interruption_left_pending_are_no_news():
    result = ended("""
    import asyncio

    loop = asyncio.new_event_loop()
    task = loop.create_task(asyncio.sleep(60))
    loop.call_later(0.1, loop.stop)
    loop.run_forever()
    loop.close()
    del task, loop
    raise click.Abort
""")
    assert (result.returncode, result.stderr.count("\n")) == (130, 1)


def test_errors_that_are_each_others_cause_end():
    result = ended("""
    one, other = ValueError("one"), ValueError("other")
    one.__cause__, other.__cause__ = other, one
    raise one
""")
    assert result.returncode == 1


def test_a_mistake_of_ours_is_shown():
    result = ended("raise TypeError('ours')")
    assert result.returncode == 1
    assert "TypeError: ours" in result.stderr


def test_coroutines_that_an_interruption_left_are_no_news():
    code = "import click\n    async def never(): pass\n    never()\n    raise click.Abort"
    result = ended(code)
    assert (result.returncode, result.stderr.count("\n")) == (130, 1)


def test_a_message_is_one_line_of_bounded_length():
    told = printable("a\nb\x1b[31m\u202e " + "c" * 200_000 + " 1 to 5.", LONGEST)
    assert told.startswith("a b?[31m? ccc")
    assert told.endswith("ccc 1 to 5.")
    assert len(told.encode()) < 1000


def test_what_the_package_says_is_told_once_however_often_a_process_is_prepared():
    result = ended(
        "import logging; program.prepare_process(); program.prepare_process(); "
        "logging.getLogger('lf_flame.anything').info('It takes a while.')"
    )
    assert (result.returncode, result.stderr) == (0, "It takes a while.\n")


def test_the_first_help_fits_a_terminal():
    assert max(map(len, CliRunner().invoke(commands, ["--help"]).output.splitlines())) <= 80
