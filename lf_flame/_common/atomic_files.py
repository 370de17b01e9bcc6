"""Atomic writing of files and folders: no half-written output, and no user file is lost.

Output is first written under a hidden, unique temporary name in its target folder, then renamed. A
process that is killed may leave that temporary file or folder, which is safe to delete.
"""

import glob
import json
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from lf_flame.errors import InputError


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Give an empty file with the ending of `path`, to be renamed when the block succeeds.

    The folder is made. An existing file stays until the rename; a link is replaced, and its target
    stays.
    """
    path = Path(path)
    if path.exists() and not path.is_file():
        kind = "a folder" if path.is_dir() else "no regular file"
        raise InputError(f"{path} is {kind}, which a file cannot replace; choose another name.")
    path.parent.mkdir(parents=True, exist_ok=True)
    aside = path.with_name(f".{path.stem}.{secrets.token_hex(8)}.part{path.suffix}")
    try:
        with _naming(path, aside):
            aside.touch(exist_ok=False)
            yield aside
            with aside.open("rb") as file:  # so that a power cut leaves no empty file
                os.fsync(file.fileno())
            aside.replace(path)
    finally:
        aside.unlink(missing_ok=True)


@contextmanager
def _naming(path: Path, aside: Path) -> Iterator[None]:
    """Name the final file in the system's errors, such as a full disk, and keep NumPy's texts."""
    try:
        yield
    except OSError as error:
        if error.errno is None:
            error.strerror = error.strerror or str(error)
        named, temporary = str(error.filename or aside), str(aside)
        if named.startswith(temporary):
            error.filename = f"{path}{named.removeprefix(temporary)}"
        raise


@contextmanager
def atomic_folder(path: str | Path) -> Iterator[Path]:
    """Give an empty folder, to be renamed to `path`, which must not exist or be empty."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    aside = path.with_name(f".{path.name}.{secrets.token_hex(8)}.part")
    try:
        with _naming(path, aside):
            aside.mkdir()
            yield aside
            aside.replace(path)
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def remove_leftovers(path: Path) -> None:
    """Remove temporary files and folders of `path` that killed processes left.

    Only for a process that holds the lock (`exclusive`) under which all write `path`.
    """
    part = f"{'[0-9a-f]' * 16}.part"
    names = (
        f".{glob.escape(path.name)}.{part}",
        f".{glob.escape(path.stem)}.{part}{glob.escape(path.suffix)}",
    )
    for left in [found for name in names for found in path.parent.glob(name)]:
        if left.is_file():
            left.unlink()
        else:
            shutil.rmtree(left, ignore_errors=True)


def write_text(path: str | Path, text: str) -> None:
    """Write a text file in UTF-8."""
    with atomic_write(path) as aside:
        aside.write_text(text, encoding="utf-8")


def write_json(path: str | Path, record: dict) -> None:
    """Write a record as JSON; infinity and NaN, which JSON lacks, become null."""
    valid = json.loads(json.dumps(record), parse_constant=lambda name: None)
    write_text(path, json.dumps(valid, indent=1) + "\n")


@contextmanager
def exclusive(output: str | Path) -> Iterator[None]:
    """Keep other processes from writing the same output during the block.

    The lock is a file ``.NAME.lock`` beside the output, whose parent folders are made, and removed
    if they are empty at the end. The system frees it when the process ends for any reason.
    An output that another process is writing is refused.
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
        # Removed while held: a process that opened it before finds it gone, and makes another.
        file.unlink(missing_ok=True)
        lock.release()
        with suppress(OSError):  # one holds something
            for folder in made:
                folder.rmdir()
