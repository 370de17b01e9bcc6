import os
import subprocess
import sys

import pytest

from lf_flame._common.input_files import printable
from lf_flame.commands.program import LONGEST


def ended(code, **environment):
    """Run a program of one command that holds some lines of code."""
    lines = "import click\nfrom lf_flame.commands import program\n@click.command()\ndef show():\n"
    code = f"{lines}    {code}\nprogram.run(show, 'show')"
    known = {k: v for k, v in os.environ.items() if k != "NUMBA_NUM_THREADS"} | environment
    return subprocess.run([sys.executable, "-c", code], env=known, capture_output=True, text=True)


@pytest.mark.parametrize("threads", ["100000", ""])
def test_a_number_of_threads_that_numba_cannot_start_is_one_sentence(threads):
    result = ended("import numba", NUMBA_NUM_THREADS=threads)
    assert result.returncode == 2
    said = f"NUMBA_NUM_THREADS must be a whole number from 1 to 1024, got {threads!r}.\n"
    assert result.stderr == f"show: {said}"


ENDS = {
    "our mistakes are shown": ("raise TypeError('ours')", 1, "TypeError: ours"),
    "Ctrl-C while NumPy compares dtypes": ("""
    try:
        raise KeyboardInterrupt
    except KeyboardInterrupt as error:
        raise TypeError("Cannot compare structured arrays") from error
""", 130, "show: Stopped."),
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
def test_a_date_that_numpy_cannot_read_and_a_backend_for_screens_do_no_harm():
    code = "import numpy.f2py; from lf_flame._common import figures; figures.subplots()"
    result = ended(code, SOURCE_DATE_EPOCH="x", MPLBACKEND="bogus")
    assert (result.returncode, result.stderr) == (0, "")


def test_a_message_is_one_line_of_bounded_length():
    told = printable("a\nb\x1b[31m\u202e " + "c" * 200_000 + " 1 to 5.", LONGEST)
    assert told.startswith("a b?[31m? ccc")
    assert told.endswith("ccc 1 to 5.")
    assert len(told.encode()) < 1000
