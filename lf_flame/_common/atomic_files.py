"""Writing files and folders so that none is ever half there, and nothing of the user's is lost.

What is written goes aside first, under a name that nobody else has, in the folder where it is to
be; then it is renamed. The system keeps a lock on it for the process that writes it, so that what
a killed one left is told from what is being written, and the next write of the same output
removes it.
"""

import fcntl
import json
import math
import os
import re
import secrets
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from lf_flame.errors import InputError

TOKEN = "[0-9a-f]{16}"
"""What a name aside has that no name of a user's has by chance."""

MOVING = ".moving"
"""Ending of a folder aside whose files are being moved to their place."""


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Give a path beside the wanted one; rename it when the block ends well, else remove it.

    Parameters
    ----------
    path : str or Path
        Where the file is to be; its folder is made. What stands there stays until the rename; of a
        link, the link is replaced and what it leads to stays.

    Yields
    ------
    Path
        A new, empty file, with the same ending, for writers that look at it.

    Raises
    ------
    InputError
        If something other than a file stands there.
    """
    path = Path(path)
    refuse_other_kinds(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    remove_leftovers(path)
    with naming(path), _new_aside(path, _open_new_file) as (aside, descriptor):
        try:
            yield aside
            os.fsync(descriptor)  # before its name stands for it: no power cut empties it
            aside.replace(path)
        finally:
            aside.unlink(missing_ok=True)


@contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """Name the file in errors that name none, as those of a full disk in the middle of a file."""
    try:
        yield
    except OSError as error:
        if error.errno is not None and error.filename is None:  # without, its words are lost
            error.filename = str(path)
        raise


@contextmanager
def atomic_folder(path: str | Path, named: str = "") -> Iterator[Path]:
    """Do for a new folder what `atomic_write` does for a file.

    Parameters
    ----------
    path : str or Path
        Must not exist, or be an empty folder.
    named : str, optional
        What it is named by while it is aside, where leftovers may be those of other paths; by
        default its own name.

    Yields
    ------
    Path
        A new, empty folder beside it.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with _folder_aside(path.with_name(named or path.name)) as aside:
        yield aside
        aside.replace(path)


@contextmanager
def together(
    folder: str | Path, last: str = "", ours: Callable[[Path], bool] | None = None
) -> Iterator[Path]:
    """Give an empty folder; move its files into the wanted one when the block ends well.

    If it does not end well, nothing there has changed. What was cut off while it moved files, the
    next call finishes before anything else, or removes.

    Parameters
    ----------
    folder : str or Path
        Where the files are to be; it is made. They replace those of the same names.
    last : str, optional
        Name of the file that says what counts, which is moved after all others.
    ours : callable, optional
        Takes the folder of files that a process which has ended did not move, and tells whether
        to move them; other folders of such a name stay as they are. Default: none is moved, and
        the folder is removed.

    Yields
    ------
    Path

    Raises
    ------
    InputError
        If something other than a file bears the name of one.
    """
    folder = Path(folder)
    with made(folder):
        _finish_moves(folder, last, ours)
        with _folder_aside(folder / "outputs") as aside:
            yield aside
            for path in aside.iterdir():
                refuse_other_kinds(folder / path.name)
            # From here on there is no way back, and the name says so.
            _move_all(aside.rename(aside.with_suffix(MOVING)), last)


def _finish_moves(folder: Path, last: str, ours: Callable[[Path], bool] | None) -> None:
    """Move, or remove, what a process that has ended has not moved any more."""
    for left in folder.iterdir():
        if re.fullmatch(rf"\.outputs\.{TOKEN}\{MOVING}", left.name) and not left.is_symlink():
            with suppress(BlockingIOError), _locked(left):
                if ours is None:
                    shutil.rmtree(left)
                elif ours(left):
                    _move_all(left, last)


def _move_all(aside: Path, last: str) -> None:
    """Move all files of a folder into the one that it lies in."""
    for path in sorted(aside.iterdir(), key=lambda path: (path.name == last, path.name)):
        path.replace(aside.with_name(path.name))
    aside.rmdir()


@contextmanager
def made(folder: Path) -> Iterator[None]:
    """Make a folder, and remove it, and those made for it, if it is empty in the end."""
    missing = [place for place in (folder, *folder.parents) if not place.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        with suppress(OSError):  # it holds something
            for place in missing:
                place.rmdir()


def refuse_other_kinds(path: Path) -> None:
    """Refuse to write a file where a folder, a device or another thing that is no file stands."""
    if path.exists() and not path.is_file():
        kind = "a folder" if path.is_dir() else "no regular file"
        raise InputError(f"{path} is {kind}, which a file cannot replace; choose another name.")


def remove_leftovers(path: Path) -> None:
    """Remove what killed processes left aside of a file or folder."""
    name = re.compile(rf"\.{re.escape(path.stem)}\.{TOKEN}\.part{re.escape(path.suffix)}")
    for left in path.parent.iterdir():
        if not name.fullmatch(left.name) or left.is_symlink():
            continue
        with suppress(OSError):  # another process holds it, or has removed it
            _remove_unless_locked(left)


def _remove_unless_locked(path: Path) -> None:
    with _locked(path):
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink()


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold the lock of something that lies aside, unless another process does."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(descriptor)


@contextmanager
def _folder_aside(path: Path) -> Iterator[Path]:
    remove_leftovers(path)
    with _new_aside(path, _open_new_folder) as (aside, _):
        try:
            yield aside
        finally:
            shutil.rmtree(aside, ignore_errors=True)


@contextmanager
def _new_aside(path: Path, open_new: Callable[[Path], int]) -> Iterator[tuple[Path, int]]:
    """Make something under a name that nobody else has, and hold its lock."""
    while True:
        aside = path.with_name(f".{path.stem}.{secrets.token_hex(8)}.part{path.suffix}")
        descriptor = open_new(aside)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX)
            if os.fstat(descriptor).st_nlink > 0:  # else taken for a leftover before it was locked
                yield aside, descriptor
                return
        finally:
            os.close(descriptor)


def _open_new_file(path: Path) -> int:
    """Open a file exclusively: never somebody else's, nor what a link leads to."""
    return os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o666)


def _open_new_folder(path: Path) -> int:
    path.mkdir()
    return os.open(path, os.O_RDONLY)


def write_text(path: str | Path, text: str) -> None:
    """Write a text file in UTF-8."""
    with atomic_write(path) as aside:
        aside.write_text(text, encoding="utf-8")


def write_json(path: str | Path, record: dict) -> None:
    """Write a record as JSON; which has no infinity and no NaN, so they become null."""
    valid = json.loads(json.dumps(record), parse_constant=lambda name: None)
    write_text(path, json.dumps(valid, indent=1) + "\n")


def finite(row: dict) -> dict:
    """Make JSON values of a row; a bound may be infinite."""
    return {
        key: None if isinstance(value, float) and not math.isfinite(value) else value
        for key, value in row.items()
    }
