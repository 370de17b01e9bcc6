"""Options and arguments that several commands share."""

import errno
import math
import stat
import sys
import threading
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import click
import cloup

from lf_flame._common import progress


class UsablePath(click.Path):
    """A path that can be followed: not a link that leads back to itself."""

    def convert(self, value, param, ctx):
        """Refuse a path that the system cannot follow; click checks the rest."""
        try:
            found = Path(value).stat().st_mode
            if not self.file_okay and not stat.S_ISDIR(found):  # click lets devices pass
                self.fail(f"{str(value)[:200]!r} must be a folder.", param, ctx)
        except FileNotFoundError:
            if self.exists and not Path(value).is_absolute():
                named = f"{self.name.title()} {str(value)[:200]!r}"
                self.fail(f"{named} does not exist in the folder {Path.cwd()}.", param, ctx)
        except OSError as error:
            if error.errno in (errno.ELOOP, errno.ENAMETOOLONG):
                self.fail(f"{str(value)[:200]!r} cannot be used: {error.strerror}.", param, ctx)
        except ValueError:
            self.fail(f"{value!r} cannot be used: no file has such a name.", param, ctx)
        return super().convert(value, param, ctx)


class FiniteRange(click.FloatRange):
    """A range of finite numbers; click lets NaN and infinity pass."""

    def convert(self, value, param, ctx):
        """Refuse a number that is not finite; click checks the rest."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is no finite number.", param, ctx)
        return number


class PlacedFile(click.ParamType):
    """A file and a number that belongs to it, as ``board.npz@-20``.

    Parameters
    ----------
    what : str
        Meaning of file and number, for messages.
    example : str
    optional : bool, optional
        Whether the number may be missing; it is None then.
    """

    name = "file@number"

    def __init__(self, what: str, example: str, *, optional: bool = False):
        self._what, self._example, self._optional = what, example, optional

    def convert(self, value, param, ctx):
        """Split the path from the number, at the last @."""
        if isinstance(value, tuple):
            return value
        if self._optional and "\0" not in value and Path(value).exists():
            return Path(value), None
        path, at, text = value.rpartition("@")
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        if not at or not path or not math.isfinite(number):
            self.fail(f"{value!r} must be {self._what}, as {self._example}.", param, ctx)
        if "\0" in path or not Path(path).exists():
            self.fail(f"{value!r}: there is no {path!r}.", param, ctx)
        return Path(path), number


def pick(kind: Any, options: dict[str, Any]) -> Any:
    """Take those of a command's options that belong to a record of options, and make the record."""
    names = [name for name in kind.__dataclass_fields__ if name in options]
    return kind(**{name: options.pop(name) for name in names})


def tell(words: str) -> None:
    """Print a line to standard error, above the progress bars that are shown."""
    from tqdm import tqdm

    with tqdm.external_write_mode(file=sys.stderr):
        click.echo(words, err=True)


def tell_all(kind: str, sentences: Iterable[str]) -> None:
    """Print notes or warnings, as ``Warning: ...``, a line each."""
    for sentence in sentences:
        tell(f"{kind}: {sentence}")


SEED = click.IntRange(min=0)
FILE = UsablePath(exists=True, dir_okay=False, path_type=Path)
FOLDER = UsablePath(file_okay=False, path_type=Path)
RUN = UsablePath(exists=True, file_okay=False, path_type=Path)
PATH = UsablePath(path_type=Path)

OVERWRITE = click.option(
    "--overwrite",
    is_flag=True,
    help="Replace the folder if an earlier call of this command made it, and nothing was added.",
)
"""Option of every command that makes a folder of results."""


def camera_option(purpose: str = "", *, required: bool = False):
    """Option --camera; `purpose` ends the sentence of its help."""
    kinds = "Calibration by `lf-flame calibrate`, TOML file with a [camera] table, or"
    help = f"{kinds} simulation.json{purpose}."
    return cloup.option("--camera", type=FILE, required=required, help=help)


class Program(cloup.Group):
    """A program that lists each of its commands with the whole first sentence of its help."""

    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        for command in self.commands.values():
            # Click's own list cuts each line at the width of the terminal, in the middle of a word.
            command.short_help = " ".join((command.help or "").partition("\n\n")[0].split())

    def invoke(self, ctx: click.Context):
        """Run a command, with a message if its imports take long."""
        with progress.stage("Loading what this command needs", only_if=_is_importing):
            return super().invoke(ctx)


def _is_importing() -> bool:
    """Whether the main thread is in the middle of an import."""
    frame = sys._current_frames().get(threading.main_thread().ident or 0)
    while frame and frame.f_code.co_filename != "<frozen importlib._bootstrap>":
        frame = frame.f_back
    return frame is not None


HELP = {"help_option_names": ["-h", "--help"], "max_content_width": 100}
"""Settings of the outermost group of a program."""
