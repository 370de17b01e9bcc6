"""Atomic writing of files and folders: no half-written output, and no user file is lost.

Output is first written under a hidden, unique temporary name in its target folder, then renamed. A
process that is killed may leave that temporary file or folder, which is safe to delete. The files
of a command and their record appear together, see `output_folder`.
"""

import glob
import json
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from lf_flame._common import provenance
from lf_flame._common.config import build
from lf_flame._common.input_files import read_record
from lf_flame.errors import InputError


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Yield an empty file with the extension of `path`, to be renamed when the block succeeds.

    Its folder is made. An existing file stays until the rename; a link is replaced, and its target
    stays.
    """
    path = Path(path)
    if path.exists() and not path.is_file():
        raise InputError(f"{path} is not a file, and is not replaced by one; choose another name.")
    with _renamed(path, path.suffix) as aside:
        aside.touch(exist_ok=False)
        yield aside
        with aside.open("rb") as file:  # so that a power cut leaves no empty file
            os.fsync(file.fileno())


@contextmanager
def atomic_folder(path: str | Path) -> Iterator[Path]:
    """Yield an empty folder, to be renamed to `path`, which must not exist or be empty."""
    with _renamed(Path(path)) as aside:
        aside.mkdir()
        yield aside


@contextmanager
def _renamed(path: Path, suffix: str = "") -> Iterator[Path]:
    """Yield a temporary path, renamed to `path` or removed; the system's errors name `path`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    aside = path.with_name(f".{path.name}.{secrets.token_hex(8)}.part{suffix}")
    try:
        yield aside
        aside.replace(path)
    except OSError as error:
        error.strerror = error.strerror or str(error)  # NumPy's for a full disk is text only
        error.filename = str(error.filename or aside).replace(str(aside), str(path))
        raise
    finally:
        _remove(aside)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def remove_leftovers(path: Path) -> None:
    """Remove temporary files and folders of `path` that killed processes left.

    Call it only under the lock (`exclusive`) under which all processes write `path`.
    """
    for left in path.parent.glob(f".{glob.escape(path.name)}.{'[0-9a-f]' * 16}.part*"):
        _remove(left)


def write_text(path: str | Path, text: str) -> None:
    """Write a text file in UTF-8."""
    with atomic_write(path) as aside:
        aside.write_text(text, encoding="utf-8")


def write_json(path: str | Path, record: dict) -> None:
    """Write a record as JSON; infinity and NaN become null, and bytes of names beyond UTF-8 "?"."""
    text = json.dumps(record, ensure_ascii=False).encode(errors="replace")
    valid = json.loads(text, parse_constant=lambda name: None)
    write_text(path, json.dumps(valid, indent=1) + "\n")


@contextmanager
def exclusive(output: str | Path) -> Iterator[None]:
    """Keep other processes from writing the same output during the block.

    The system frees the lock, a file ``.NAME.lock`` beside the output, however the process ends.
    Parent folders are made, and removed if they stay empty. A second process is refused.
    """
    path = Path(output).resolve()
    if not path.name:
        raise InputError(f"{output} is the root of all folders; choose another place.")
    made = [folder for folder in path.parents if not folder.exists()]
    path.parent.mkdir(parents=True, exist_ok=True)
    file = path.with_name(f".{path.name}.lock")
    lock = FileLock(file)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        raise InputError(
            f"{output} is being written by another process; wait for it, or choose another place."
        ) from None
    try:
        yield
    finally:
        # Removed under the lock: a process that opened it before finds it gone, and makes another.
        file.unlink(missing_ok=True)
        lock.release()
        with suppress(OSError):  # one is not empty
            for folder in made:
                folder.rmdir()


@dataclass
class OutputFolder:
    """A folder that a command fills in `aside`; made by `output_folder`, which puts it in place.

    `facts` go into the record; `files` are the names of all others, known at the end.
    """

    folder: Path
    aside: Path
    facts: dict[str, Any] = field(default_factory=dict)
    files: list[str] = field(default_factory=list)

    def path(self, name: str) -> Path:
        """Path at which to write a file."""
        return self.aside / name


@contextmanager
def output_folder(
    folder: str | Path, record: str, *, overwrite: bool = False
) -> Iterator[OutputFolder]:
    """Fill a new folder, which appears with all files and their record when the block succeeds.

    The folder must be empty or new; `overwrite` replaces one that contains such a record, and only
    files that it lists. It is first renamed to ``NAME.old-...`` and removed after the new one has
    its name. A process that is killed in between leaves it under that name.
    """
    place = Path(os.path.realpath(folder))  # the target of a link is replaced
    old, old_files = place.with_name(f"{place.name}.old-{secrets.token_hex(4)}"), []
    with exclusive(place):
        refuse_folder(folder, record, overwrite=overwrite)
        remove_leftovers(place)
        try:
            with atomic_folder(place) as aside:
                opened = OutputFolder(Path(folder), aside)
                yield opened
                opened.files = sorted(path.name for path in aside.iterdir())
                origin = provenance.environment()
                write_json(aside / record, {**opened.facts, "files": opened.files, **origin})
                # Again, as a user may have put something there meanwhile.
                old_files = refuse_folder(folder, record, overwrite=overwrite)
                if old_files:
                    place.rename(old)
        except BaseException:
            if old_files and not place.exists():
                old.rename(place)
            raise
        with suppress(OSError):  # a file that came last is kept, under the name NAME.old-...
            for name in old_files:
                (old / name).unlink()
            if old_files:
                old.rmdir()


def refuse_folder(folder: str | Path, record: str, *, overwrite: bool = False) -> list[str]:
    """Refuse a folder that may not be written, see `output_folder`; else name the files in it."""
    # "new/../results" may exist although "new" does not.
    folder = Path(folder if os.path.lexists(folder) else os.path.realpath(folder))
    if not os.path.lexists(folder):
        return []
    if not folder.is_dir():
        raise InputError(f"{folder} exists and is not a folder; choose another name.")
    if folder.resolve() == Path.cwd():
        raise InputError(f"{folder} is the current folder, which is not replaced; name a new one.")
    names = sorted(path.name for path in folder.iterdir())
    if names and not overwrite:
        raise InputError(f"{folder} exists; name another folder, or replace it with --overwrite.")
    if not names:
        return names
    try:
        listed = build(list[str], read_record(folder / record).get("files"), f"{record}, files")
    except InputError as error:
        raise InputError(f"{folder} is not replaced, as it is not a result: {error}") from None
    for name in names:
        path = folder / name
        if name not in (record, *listed) or (path.is_dir() and not path.is_symlink()):
            raise InputError(
                f"{folder} is not replaced: {record} does not list {name} in it; move that away, "
                f"or name another folder."
            )
    return names


def recorded_path(path: str | Path, folder: str | Path) -> str:
    """Path of another file or folder, relative to the `folder` of the record that stores it."""
    # The system follows a link before it applies "..", so that links are resolved first.
    return os.path.relpath(os.path.realpath(path), os.path.realpath(folder))
