"""Atomic writing of files and folders: no half-written output, and no user file is lost.

Output is first written under a unique temporary name in its target folder, then renamed. The
writing process holds a system lock on it. The next write of the same output can therefore tell
what a killed process left from what is still being written, and removes the former.
"""

import fcntl
import json
import os
import re
import secrets
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from lf_flame.errors import InputError

TOKEN = "[0-9a-f]{16}"
"""Pattern of the random part of a temporary name; no user's file has such a name by chance."""

MOVING = ".moving"
"""Ending of a temporary folder whose files are being moved to their place."""


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Give a temporary path; rename it to `path` when the block succeeds, else remove it.

    Parameters
    ----------
    path : str or Path
        Target file; its folder is made. An existing file stays until the rename. If it is a link,
        the link is replaced and its target stays.

    Yields
    ------
    Path
        A new, empty file with the same ending, for writers that look at the ending.

    Raises
    ------
    InputError
        If `path` exists and is not a file.
    """
    path = Path(path)
    refuse_other_kinds(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    remove_leftovers(path)
    with naming(path), _new_aside(path, _open_new_file) as (aside, descriptor):
        try:
            yield aside
            os.fsync(descriptor)  # before the rename, so that a power cut leaves no empty file
            aside.replace(path)
        finally:
            aside.unlink(missing_ok=True)


@contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """Add the file's name to errors that have none, such as a full disk during a write."""
    try:
        yield
    except OSError as error:
        name_file(error, error.filename or path)
        raise


def name_file(error: OSError, path: str | Path) -> None:
    """Give an error the name of a file, and keep a text without a number, as NumPy's are."""
    if error.errno is None:
        error.strerror = error.strerror or str(error)
    error.filename = str(path)


@contextmanager
def atomic_folder(path: str | Path, named: str = "") -> Iterator[Path]:
    """Make a new folder atomically, as `atomic_write` does for a file.

    Parameters
    ----------
    path : str or Path
        Target; it must not exist, or be an empty folder.
    named : str, optional
        Base of the temporary name; it decides which leftovers are removed. Default: the name of
        `path`.

    Yields
    ------
    Path
        A new, empty folder beside `path`.
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
    """Give an empty folder; move its files into `folder` when the block succeeds.

    If the block fails, nothing in `folder` changes. If a process was killed while it moved files,
    the next call first completes or removes them.

    Parameters
    ----------
    folder : str or Path
        Target folder; it is made. Existing files of the same names are replaced.
    last : str, optional
        Name of the file that is moved after all others: the record of the folder.
    ours : callable, optional
        Function of a folder of files that a killed process did not finish moving; returns whether
        to move them. If not, that folder stays as it is. Default: such files are never moved, and
        the folder is removed.

    Yields
    ------
    Path

    Raises
    ------
    InputError
        If a target name is taken by something that is not a file.
    """
    folder = Path(folder)
    with made(folder):
        _finish_moves(folder, last, ours)
        with _folder_aside(folder / "outputs") as aside:
            yield aside
            for path in aside.iterdir():
                refuse_other_kinds(folder / path.name)
            # From here on the move must be completed; the name of the folder records this.
            _move_all(aside.rename(aside.with_suffix(MOVING)), last)


def _finish_moves(folder: Path, last: str, ours: Callable[[Path], bool] | None) -> None:
    """Complete, or remove, what a killed process did not finish moving."""
    for left in folder.iterdir():
        if re.fullmatch(rf"\.outputs\.{TOKEN}\{MOVING}", left.name) and not left.is_symlink():
            with suppress(BlockingIOError), _locked(left):
                if ours is None:
                    shutil.rmtree(left)
                elif ours(left):
                    _move_all(left, last)


def _move_all(aside: Path, last: str) -> None:
    """Move all files of a folder into its parent folder."""
    for path in sorted(aside.iterdir(), key=lambda path: (path.name == last, path.name)):
        path.replace(aside.with_name(path.name))
    aside.rmdir()


@contextmanager
def made(folder: Path) -> Iterator[None]:
    """Make a folder; at the end remove it and the parents made for it, if they are empty."""
    missing = [place for place in (folder, *folder.parents) if not place.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        with suppress(OSError):  # it holds something
            for place in missing:
                place.rmdir()


def refuse_other_kinds(path: Path) -> None:
    """Refuse to write a file where a folder, a device or anything but a file exists."""
    if path.exists() and not path.is_file():
        kind = "a folder" if path.is_dir() else "no regular file"
        raise InputError(f"{path} is {kind}, which a file cannot replace; choose another name.")


def remove_leftovers(path: Path) -> None:
    """Remove temporary files and folders of `path` that killed processes left."""
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
    """Hold the lock of a temporary file or folder; raises BlockingIOError if another holds it."""
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
    """Make a file or folder under a unique temporary name, and hold its lock."""
    while True:
        aside = path.with_name(f".{path.stem}.{secrets.token_hex(8)}.part{path.suffix}")
        descriptor = open_new(aside)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX)
            if os.fstat(descriptor).st_nlink > 0:  # else removed as a leftover before the lock
                yield aside, descriptor
                return
        finally:
            os.close(descriptor)


def _open_new_file(path: Path) -> int:
    """Open a new file exclusively: an existing file or link is never opened."""
    return os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o666)


def _open_new_folder(path: Path) -> int:
    path.mkdir()
    return os.open(path, os.O_RDONLY)


def write_text(path: str | Path, text: str) -> None:
    """Write a text file in UTF-8."""
    with atomic_write(path) as aside:
        aside.write_text(text, encoding="utf-8")


def write_json(path: str | Path, record: dict) -> None:
    """Write a record as JSON; infinity and NaN, which JSON lacks, become null."""
    valid = json.loads(json.dumps(record), parse_constant=lambda name: None)
    write_text(path, json.dumps(valid, indent=1) + "\n")
