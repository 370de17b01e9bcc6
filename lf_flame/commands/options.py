"""Options and arguments that several commands share, and the help of all commands."""

import errno
import math
import stat
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Executor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import cloup

from lf_flame._common import progress
from lf_flame._common.input_files import printable
from lf_flame._common.provenance import cpu_count
from lf_flame.errors import InputError

if TYPE_CHECKING:
    from lf_flame._common.atomic_files import OutputFolder
    from lf_flame.optics.lens import Lens


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
            self.fail(f"{value!r} is not a finite number.", param, ctx)
        return number


class PlacedFile(click.ParamType):
    """A file and a number that belongs to it, as ``board.npz@-20``.

    `what` and `example` are for messages; the number may be missing, and is None then, if
    `optional`.
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
        if self._optional and not at:
            self.fail(f"There is no {value!r}.", param, ctx)
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        if not at or not path or not math.isfinite(number):
            self.fail(f"{value!r} must be {self._what}, such as {self._example}.", param, ctx)
        if "\0" in path or not Path(path).exists():
            self.fail(f"{value!r}: there is no {path!r}.", param, ctx)
        return Path(path), number


COUNT = click.IntRange(min=0)
SEED = COUNT
ABOVE_0 = FiniteRange(min=0, min_open=True)
FILE = UsablePath(exists=True, dir_okay=False, path_type=Path)
FOLDER = UsablePath(file_okay=False, path_type=Path)
RUN = UsablePath(exists=True, file_okay=False, path_type=Path)
PATH = UsablePath(path_type=Path)
EXISTING = UsablePath(exists=True, path_type=Path)


def option(name: str, help: str, type: Any = None, *, rare: bool = False, **more: Any) -> Callable:
    """Option of a command; a `rare` one is shown by ``--help-all`` only."""
    names = name.split()
    return cloup.option(*names, type=type, help=help, hidden=rare, **more)


def flag(name: str, help: str, **more: Any) -> Callable:
    """Option without a value."""
    return option(name, help, is_flag=True, **more)


class Command(cloup.Command):
    """A command whose ``--help`` fits on one screen.

    ``--help-all`` also shows the options that are `rare`, and the text of the docstring after a
    form feed.
    """

    def __init__(self, *args, help: str = "", **options):
        super().__init__(*args, help=help.partition("\f")[0], **options)
        self.whole_help = help.replace("\f\n", "")
        option = cloup.Option(
            ["--help-all"], is_flag=True, expose_value=False, is_eager=True,
            callback=self._show_all, help="Show rare options and details, too.",
        )  # fmt: skip
        self.params.append(option)
        self.ungrouped_options.append(option)

    def _rare(self) -> Iterable[cloup.Option]:
        return (x for x in self.params if isinstance(x, cloup.Option) and x.hidden and x.help)

    def _show_all(self, ctx: click.Context, _option, given: bool) -> None:
        if given and not ctx.resilient_parsing:
            click.echo(self.get_whole_help(ctx))
            ctx.exit()

    def get_whole_help(self, ctx: click.Context) -> str:
        """Give the help with all options."""
        rare, help = [*self._rare()], self.help
        groups = {group for one in rare if (group := getattr(one, "group", None)) and group.hidden}
        self.help = self.whole_help
        for one in (*rare, *groups):
            one.hidden = False
        try:
            return self.get_help(ctx)
        finally:
            self.help = help
            for one in (*rare, *groups):
                one.hidden = True


command = partial(cloup.command, cls=Command)
"""Decorator of each command."""


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


HELP = {"help_option_names": ["-h", "--help"], "max_content_width": 100, "show_default": True}
"""Settings of the outermost group of a program."""


OVERWRITE = flag("--overwrite", "Replace the folder of an earlier run.")


def out_options(default: str) -> Callable:
    """Options --out and --overwrite of a command that makes a folder of results."""
    out = option("--out", f"Folder for the files; default {default}.", FOLDER)
    return lambda command: out(OVERWRITE(command))


def result_name(source: Path) -> str:
    """Name the results of a file or folder by default: as the source, without a known ending."""
    # A point in a folder's name is no ending, and "." has no name itself.
    return source.resolve().name.removesuffix(".zarr") if source.is_dir() else source.stem


def camera_option(purpose: str = "", *, required: bool = False) -> Callable:
    """Option --camera; `purpose` ends the sentence of its help."""
    kinds = "Camera or calibration (.toml), or simulation.json"
    return option("--camera", f"{kinds}{purpose}.", FILE, required=required)


def open_lens(path: Path | None) -> "Lens | None":
    """Read the camera of `camera_option`; None without one."""
    from lf_flame.calibration import read_lens

    return read_lens(path) if path else None


def pick(kind: Any, options: dict[str, Any]) -> Any:
    """Make a record of options, taking those out of a command's options that belong to it."""
    names = [name for name in kind.__dataclass_fields__ if name in options]
    return kind(**{name: options.pop(name) for name in names})


def report(words: str) -> None:
    """Print a line to standard error, above the progress bars that are shown."""
    from tqdm import tqdm

    with tqdm.external_write_mode(file=sys.stderr):
        click.echo(printable(words, 900), err=True)


def print_notes(kind: str, sentences: Iterable[str]) -> None:
    """Print notes or warnings, as ``Warning: ...``, a line each."""
    for sentence in sentences:
        report(f"{kind}: {sentence}")


def print_files(folder: "OutputFolder", before: str = "") -> None:
    """Print which files were written, after what was found."""
    click.echo(f"{before}{', '.join(folder.files)} written to {printable(folder.folder)}")


START_S = 30
"""Longest time in seconds to wait for a scheduler, and then for its first worker."""

WORKERS = cloup.option_group(
    "Where it is computed",
    option("--workers", "Number of processes; 0: one per core.", int, default=0),
    option("--scheduler", "Dask scheduler to use: tcp://HOST:PORT.", rare=True),
)


@dataclass(frozen=True)
class WorkerOptions:
    """Options of the group `WORKERS`, checked."""

    workers: int = 0
    scheduler: str | None = None

    def __post_init__(self):
        if self.workers < 0:
            raise InputError(f"workers must be 0 (one per core) or more, got {self.workers}.")

    @property
    def processes(self) -> int:
        """Number of processes without a cluster."""
        return self.workers or cpu_count()

    @contextmanager
    def executor(self) -> Iterator[Executor | None]:
        """Connect to the cluster; None without one.

        Dask gives the tasks of a worker that dies to other workers.
        """
        if not self.scheduler:
            yield None
            return
        from distributed import Client, KilledWorker

        with progress.stage("Connecting to the cluster"):
            try:
                client = Client(self.scheduler, timeout=START_S)
            except (OSError, ValueError) as error:
                raise InputError(
                    f"The scheduler {self.scheduler} does not answer: {error}."
                ) from None
        with client:
            try:
                client.wait_for_workers(1, timeout=START_S)
            except TimeoutError:
                raise InputError(
                    f"The scheduler {self.scheduler} has no workers: start some with `dask worker "
                    f"{self.scheduler}`."
                ) from None
            try:
                yield client.get_executor()
            except (CancelledError, KilledWorker):
                raise ChildProcessError(
                    "The cluster's scheduler has ended, or a task killed worker after worker; what "
                    "is finished is kept, and the same command resumes from there"
                ) from None
