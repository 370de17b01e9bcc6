"""Output folders of commands: all files and their record appear together, or not at all."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lf_flame._common import provenance
from lf_flame._common.atomic_files import atomic_folder, exclusive, remove_leftovers, write_json
from lf_flame._common.config import build
from lf_flame._common.input_files import read_record
from lf_flame.errors import InputError


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

    The folder must be empty or new; `overwrite` replaces one that holds such a record, and only
    files that it lists. It is first renamed to ``NAME.old-...`` and removed after the new one has
    its name. A process that is killed in between leaves it under that name.
    """
    place = Path(os.path.realpath(folder))  # of a link, the folder behind it is replaced
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
    folder = Path(folder)
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
        raise InputError(f"{folder} is not replaced, as it is no result: {error}") from None
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
