"""Running a click program so that any failure is one sentence and an exit status."""

import logging
import os
import sys
import warnings
from typing import NoReturn

import click
from PIL import Image

from lf_flame._common import progress
from lf_flame._common.input_files import printable
from lf_flame.commands.options import report
from lf_flame.errors import InputError


def run(commands: click.Group, name: str) -> None:
    """Run a program: bad input ends with status 2, an interruption with 130, never a traceback.

    Parameters
    ----------
    commands : click.Group
    name : str
        Name of the program, printed before a message.
    """
    try:
        prepare_process()
        status = commands.main(prog_name=name, standalone_mode=False)
    except Exception as error:
        _end(name, error)
    sys.exit(status or 0)


STOPPED = "Stopped. Finished files are kept; for long work, the same command resumes."


def _end(name: str, error: Exception) -> NoReturn:
    """End a program after an error; a bug of ours keeps its traceback."""
    if isinstance(error, click.exceptions.Abort) or _was_interrupted(error):
        _fail(name, STOPPED, 130)
    if isinstance(error, click.ClickException):
        error.show()
        sys.exit(2)
    if isinstance(error, InputError):
        _fail(name, str(error), 2)
    if isinstance(error, MemoryError):
        _fail(name, f"There is not enough memory for this input: {error}.", 2)
    if isinstance(error, ModuleNotFoundError) and error.name in OPTIONAL:
        _fail(name, f"{OPTIONAL[error.name]} (there is no module {error.name}).", 2)
    if isinstance(error, OSError):
        place = f" ({error.filename})" if error.filename else ""
        reason = error.strerror or " ".join(map(str, error.args)) or "It cannot be written or read"
        _fail(name, f"{reason}{place}. Nothing that was there before is lost.", 2)
    raise error


def _was_interrupted(error: BaseException | None) -> bool:
    """Whether Ctrl-C caused an error: NumPy raises TypeError for it where it compares dtypes."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def prepare_process() -> None:
    """Set up the whole process, as a program may and a library must not.

    Figures go to files, so no screen backend is needed. `check_memory`, with a limit that can be
    raised, decides whether an image is too large, and not Pillow. Messages of tifffile on damaged
    files say less than the error, and those of Zarr's coroutines after Ctrl-C nothing.
    """
    os.environ["MPLBACKEND"] = "agg"
    if not os.environ.get("SOURCE_DATE_EPOCH", "0").isdecimal():  # NumPy's f2py ends at others
        del os.environ["SOURCE_DATE_EPOCH"]
    Image.MAX_IMAGE_PIXELS = None
    logging.getLogger("tifffile").setLevel(logging.CRITICAL)
    logging.getLogger("asyncio").setLevel(logging.CRITICAL)
    ours = logging.getLogger("lf_flame")
    ours.setLevel(logging.INFO)
    ours.handlers = [_ToStandardError()]  # one, however often a process is prepared
    progress.show()
    warnings.filterwarnings("ignore", "coroutine .* was never awaited", RuntimeWarning)
    threads = os.environ.get("NUMBA_NUM_THREADS", "1")
    if not (threads.isascii() and threads.isdigit() and 1 <= int(threads) <= MOST_THREADS):
        raise InputError(
            f"NUMBA_NUM_THREADS must be a whole number from 1 to {MOST_THREADS}, got {threads!r}."
        )


class _ToStandardError(logging.Handler):
    """Writes the messages of the package to the current standard error."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write a record's message alone."""
        report(record.getMessage())


MOST_THREADS = 1024
"""Largest number of Numba's threads; it starts safely with these, and crashes with 100,000."""

LEARNING = "This needs further packages: pip install '.[learn]'"
OPTIONAL = {
    **dict.fromkeys(("keras", "tensorflow", "pandas"), LEARNING),
    "zarr": "This needs further packages: pip install '.[video]', or for training '.[learn]'",
    "h5py": "HDF5 and MATLAB 7.3 files need h5py: pip install '.[hdf5]'",
    **dict.fromkeys(("dask", "distributed"), "This needs Dask: pip install '.[dask]'"),
    "anywidget": "This needs a notebook's parts: pip install '.[jupyter]'",
    "jax": "This needs JAX: pip install '.[gpu]'",
    "torch": "Networks need KERAS_BACKEND=tensorflow or jax",
}
"""Messages for packages that a light installation lacks."""


LONGEST = 900
"""Length of a message, in characters, at most: a file may contain names of any length."""


def _fail(name: str, message: str, status: int) -> NoReturn:
    click.echo(f"{name}: {printable(message, LONGEST)}", err=True)
    sys.exit(status)
