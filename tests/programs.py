"""The programs as a user runs them, in this process: a new one takes seconds to load Keras."""

import io
import re
import shlex
import sys
import warnings
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

import pytest
from click.testing import CliRunner

from lf_flame.commands import cli

ROOT = Path(__file__).parents[1]

HIDDEN = (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning)
"""Warnings that Python does not show a user."""


@contextmanager
def warnings_as_python_shows_them(errors):
    """Write warnings to a stream, instead of what pytest makes of them."""
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        for kind in HIDDEN:
            warnings.simplefilter("ignore", kind)
        warnings.showwarning = lambda message, kind, *_: errors.write(
            f"{kind.__name__}: {message}\n"
        )
        yield


@contextmanager
def without_graphs():
    """Let TensorFlow do each operation as it comes: to draw its graphs takes longer than few steps.

    For networks that are trained to be used in a test.
    """
    import tensorflow as tf

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*does not apply to tf.data functions")
        tf.config.run_functions_eagerly(True)
        yield
        tf.config.run_functions_eagerly(False)


def run(*words):
    """Call a command of ``lf-flame``; its result holds what it printed and raised."""
    return CliRunner().invoke(cli.commands, [str(word) for word in words])


def run_or_raise(*words):
    """Call a command as `run` does, but raise what it raised, as an InputError."""
    result = run(*words)
    if result.exception is not None:
        raise result.exception
    return result


def run_here(*words, cwd=ROOT, program="lf_flame"):
    """Run a program as ``python -m PROGRAM WORDS`` does: its exit status, output and errors."""
    from experiments import __main__
    from lf_flame.commands import program as programs

    commands = {"lf_flame": cli.commands, "experiments": __main__.commands}[program]
    out, errors = io.StringIO(), io.StringIO()
    with (
        chdir(cwd), redirect_stdout(out), redirect_stderr(errors),
        warnings_as_python_shows_them(errors),
        patch.object(sys, "argv", [program, *map(str, words)]),
        patch.object(sys, "unraisablehook", sys.unraisablehook), pytest.raises(SystemExit) as ended,
    ):  # fmt: skip
        programs.run(commands, program)
    return SimpleNamespace(
        returncode=ended.value.code, stdout=out.getvalue(), stderr=errors.getvalue()
    )


def code_blocks(text, language):
    """Blocks of code of a language in a text."""
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def run_lines(block, cwd):
    """Run each line of a block of commands as a user would: what they gave; none may fail."""
    results = []
    for line in block.splitlines():
        program, *arguments = shlex.split(line, comments=True)
        assert program == "lf-flame"
        results.append(run_here(*arguments, cwd=cwd))
        assert results[-1].returncode == 0, results[-1].stderr
    return results
