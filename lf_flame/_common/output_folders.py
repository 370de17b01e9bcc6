"""Folders of outputs with a record that says what counts, all of which appear together."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from lf_flame._common import provenance
from lf_flame._common.atomic_files import together, write_json
from lf_flame._common.checksums import file_sha256
from lf_flame._common.config import build_record, load_record
from lf_flame._common.locks import exclusive
from lf_flame._common.seals import check_seal, sealed
from lf_flame.errors import InputError

LONGEST_NAME = 255
"""Number of bytes of a file's name that systems take."""


@dataclass(frozen=True)
class EarlierRecord:
    """What the record of an earlier call says.

    Attributes
    ----------
    versions : dict
        Of the program that wrote it: by them a record of this program is known.
    files : dict of str, or list of str, optional
        The SHA-256 of each file by its name. Older versions knew only names, or none.
    source : str, optional
    """

    versions: dict[str, str]
    files: dict[str, str] | list[str] | None = None
    source: str | None = None

    def knows(self, name: str, record: str) -> bool:
        """Whether a file is of that call; one that names no files has the folder to itself."""
        return self.files is None or name == record or name in self.files


class OutputFolder:
    """A folder that a command fills, and its record; made by `output_folder`.

    Parameters
    ----------
    folder : Path
        Where the files will be.
    aside : Path
        Where they are written.
    record : str
        Name of the record, a JSON file.

    Attributes
    ----------
    facts : dict
        What the record is to say, beside the SHA-256 of each file and what made it.
    files : dict of str
        The SHA-256 of each file by its name, when all are written.
    before : EarlierRecord
        The record of an earlier call.
    latest : Path
        Place of the file that was asked for last, and is probably being written.

    Raises
    ------
    InputError
        If that record is damaged, or not from such a call.
    """

    def __init__(self, folder: Path, aside: Path, record: str):
        self.folder, self.record, self._aside = folder, record, aside
        self.latest = folder / record
        self.facts: dict[str, Any] = {}
        self.files: dict[str, str] = {}
        self._is_first = not (folder / record).exists()
        self.before = EarlierRecord({}) if self._is_first else _read_earlier(folder / record)

    def path(self, name: str) -> Path:
        """Give the path at which to write a file.

        Raises
        ------
        InputError
            If a file of that name is there which no earlier call has written.
        """
        if (self.folder / name).exists() and not self._is_ours(name):
            raise InputError(
                f"{self.folder / name} is there, and {self.record} does not say that this program "
                f"wrote it; move it, or choose another folder."
            )
        self.latest = self.folder / name
        return self._aside / name

    def _is_ours(self, name: str) -> bool:
        return not self._is_first and self.before.knows(name, self.record)

    def finish(self) -> None:
        """Write the record."""
        self.files = {path.name: file_sha256(path) for path in sorted(self._aside.iterdir())}
        record = {**self.facts, "files": self.files, **provenance.environment()}
        write_json(self.path(self.record), sealed(record))

    def remove_older(self) -> None:
        """Remove files of an earlier call that this one did not write, if they are as it left them.

        A record may come from anywhere: never a file outside the folder, nor one that changed.
        """
        before = self.before.files
        for name, sha256 in before.items() if isinstance(before, dict) else ():
            if name not in self.files and is_plain(name) and _is_same(self.folder / name, sha256):
                (self.folder / name).unlink()


def verify_outputs(folder: Path, record: str) -> int:
    """Compute the hashes of a folder's files again.

    Returns
    -------
    int
        How many there are.

    Raises
    ------
    InputError
        If one is not what was written, or the record has no hashes.
    """
    files = build_record(EarlierRecord, check_seal(folder / record), folder / record).files
    if not isinstance(files, dict):
        raise InputError(
            f"{folder / record} has no hashes of its files, as records of older versions; call the "
            f"command again."
        )
    unreadable = None
    for name, sha256 in files.items():
        path = folder / name
        try:
            sound = is_plain(name) and path.is_file() and file_sha256(path) == sha256
        except OSError as error:  # first look whether another one is damaged
            unreadable = error
            continue
        if not sound:
            raise InputError(f"{path} is not the file that {record} was written for.")
    if unreadable:
        raise unreadable
    return len(files)


def _read_earlier(path: Path) -> EarlierRecord:
    try:
        return load_record(EarlierRecord, path)
    except InputError as error:
        raise InputError(
            f"{path} is there, and is no whole record of this program; move it, or choose another "
            f"folder ({error})"
        ) from None


def _was_being_moved(record: str, left: Path) -> bool:
    """Whether files that lie aside are what a call of this program was about to move.

    The record among them, which is moved last, names them all by their hashes, and none would
    replace a file in the folder that its own record does not know.
    """
    names = [path.name for path in left.iterdir()]
    if not names:
        return True
    place = left.parent
    try:
        files = build_record(EarlierRecord, check_seal(left / record), left / record).files
        there = (place / record).exists()
        before = load_record(EarlierRecord, place / record) if there else EarlierRecord({}, {})
    except InputError:
        return False
    return isinstance(files, dict) and all(
        (name == record or _is_same(left / name, files.get(name)))
        and ((there and before.knows(name, record)) or not os.path.lexists(place / name))
        for name in names
    )


def _is_same(path: Path, sha256: str | None) -> bool:
    """Whether a regular file, no link, has a hash."""
    try:
        return path.is_file() and not path.is_symlink() and file_sha256(path) == sha256
    except OSError:  # nobody can tell
        return False


def is_plain(name: str) -> bool:
    """Whether a name is that of a file in a folder, and no path."""
    return name == Path(name).name and "\0" not in name and len(name.encode()) <= LONGEST_NAME


@contextmanager
def output_folder(folder: str | Path, record: str) -> Iterator[OutputFolder]:
    """Fill a folder: if the block ends well, all files and their record appear, the record last.

    Else nothing has changed. Nobody else can write there meanwhile.

    Parameters
    ----------
    folder : str or Path
    record : str
        Name of the record, a JSON file.

    Raises
    ------
    InputError
        If another process writes there, the record of an earlier call is damaged, or a file is
        in the way that is not from such a call.
    """
    folder = Path(folder)
    with exclusive(folder):
        with together(folder, record, partial(_was_being_moved, record)) as aside:
            outputs = OutputFolder(folder, aside, record)
            try:
                yield outputs
                outputs.finish()
            except OSError as error:  # a full disk is met in the middle of a file, which is aside
                if str(error.filename or aside).startswith(str(aside)):
                    error.filename = str(outputs.latest)
                raise
        outputs.remove_older()
