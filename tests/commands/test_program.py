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


STOPPED = "show: Stopped."

ENDS = {
    "our end of a file is no interruption": ("raise EOFError('ours')", 1, "EOFError: ours"),
    "our mistakes are shown": ("raise TypeError('ours')", 1, "TypeError: ours"),
    "errors that are each other's cause": ("""
    one, other = ValueError("one"), ValueError("other")
    one.__cause__, other.__cause__ = other, one
    raise one
""", 1, "ValueError: one"),
    "Ctrl-C while NumPy compares dtypes": ("""
    try:
        raise KeyboardInterrupt
    except KeyboardInterrupt as error:
        raise TypeError("Cannot compare structured arrays") from error
""", 130, STOPPED),
    "Ctrl-C in a reader is no damage": ("""
    from lf_flame._common.input_files import readable
    with readable(__import__("sys").executable, (TypeError,)):
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as error:
            raise TypeError("Cannot compare structured arrays") from error
""", 130, STOPPED),
    "tasks that are pending": ("""
    import asyncio

    loop = asyncio.new_event_loop()
    task = loop.create_task(asyncio.sleep(60))
    loop.call_later(0.1, loop.stop)
    loop.run_forever()
    loop.close()
    del task, loop
    raise click.Abort
""", 130, STOPPED),
    "coroutines that never ran": (
        "import click\n    async def never(): pass\n    never()\n    raise click.Abort",
        130, STOPPED,
    ),
    "a process that is prepared twice": (
        "import logging; program.prepare_process(); program.prepare_process(); "
        "logging.getLogger('lf_flame.anything').info('It takes a while.')", 0, "It takes a while."
    ),
}  # fmt: skip


@pytest.mark.parametrize(("code", "status", "said"), ENDS.values(), ids=ENDS)
def test_how_a_program_ends(code, status, said):
    """With what it says on standard error: one line, but for a mistake of ours."""
    result = ended(code)
    assert result.returncode == status
    assert said in result.stderr
    assert status == 1 or result.stderr.count("\n") == 1


@pytest.mark.slow
@pytest.mark.parametrize("date", ["x", ""])
def test_a_date_that_numpy_cannot_read_does_no_harm(date):
    result = ended("import numpy.f2py", SOURCE_DATE_EPOCH=date)
    assert (result.returncode, result.stderr) == (0, "")


@pytest.mark.slow
def test_a_backend_for_screens_is_not_asked_for():
    result = ended("from lf_flame._common import figures; figures.subplots()", MPLBACKEND="bogus")
    assert (result.returncode, result.stderr) == (0, "")


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


def test_a_message_is_one_line_of_bounded_length():
    told = printable("a\nb\x1b[31m\u202e " + "c" * 200_000 + " 1 to 5.", LONGEST)
    assert told.startswith("a b?[31m? ccc")
    assert told.endswith("ccc 1 to 5.")
    assert len(told.encode()) < 1000


def test_the_first_help_fits_a_terminal():
    assert max(map(len, CliRunner().invoke(commands, ["--help"]).output.splitlines())) <= 80
