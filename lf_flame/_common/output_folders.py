"""Folders of outputs with a record that says what counts, all of which appear together."""

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from lf_flame._common import provenance
from lf_flame._common.atomic_files import together, write_json
from lf_flame._common.checksums import SEAL, check_seal, file_sha256, sealed
from lf_flame._common.config import build_record, load_record
from lf_flame._common.input_files import read_record
from lf_flame._common.locks import exclusive
from lf_flame.errors import InputError

LOGGER = logging.getLogger(__name__)

LONGEST_NAME = 255
"""Number of bytes of a file's name that systems take."""


@dataclass(frozen=True)
class EarlierCall:
    """What an entry of the list of earlier calls in a record must say, beside its facts.

    Attributes
    ----------
    files : list of str
        Names of the files that the call wrote and that no later one has replaced.
    """

    files: list[str]


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
    earlier : list of dict
        Facts of the calls before that one of which files are left, and the names of these.
    """

    versions: dict[str, str]
    files: dict[str, str] | list[str] | None = None
    source: str | None = None
    earlier: list[dict[str, Any]] = field(default_factory=list)

    def names(self, name: str) -> bool:
        """Whether a file is of that call; one that names no files has the folder to itself."""
        return self.files is None or name in self.files

    def has_left(self, path: Path) -> bool:
        """Whether a file is of that call, and still as that call left it; links are replaced."""
        if not isinstance(self.files, dict) or path.is_symlink():
            return self.names(path.name)
        return path.name in self.files and _is_same(path, self.files[path.name])


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
    adds : bool, optional
        Whether files of earlier calls stay, beside those of this one.

    Attributes
    ----------
    facts : dict
        What the record is to say, beside the SHA-256 of each file and what made it.
    files : dict of str
        The SHA-256 of each file that this call wrote by its name, when all are written.
    kept : dict of str
        The same for those of earlier calls that stay.
    before : EarlierRecord
        The record of an earlier call.
    latest : Path
        Place of the file that was asked for last, and is probably being written.

    Raises
    ------
    InputError
        If that record is damaged, or not from such a call.
    """

    def __init__(self, folder: Path, aside: Path, record: str, adds: bool = False):
        self.folder, self.record, self._aside, self._adds = folder, record, aside, adds
        self.latest = folder / record
        self.facts: dict[str, Any] = {}
        self.files: dict[str, str] = {}
        self.kept: dict[str, str] = {}
        self._is_first = not (folder / record).exists()
        self.before = EarlierRecord({}) if self._is_first else _read_earlier(folder / record)

    def path(self, name: str) -> Path:
        """Give the path at which to write a file.

        Raises
        ------
        InputError
            If a file of that name is there which no earlier call has written, or which has
            changed since.
        """
        path = self.folder / name
        known = not self._is_first and (name == self.record or self.before.has_left(path))
        if path.exists() and not known:
            is_named = not self._is_first and self.before.names(name)
            why = (
                "has changed since this program wrote it"
                if is_named
                else f"is there, and {self.record} does not say that this program wrote it"
            )
            raise InputError(f"{path} {why}; move it, or choose another folder.")
        self.latest = path
        return self._aside / name

    def finish(self) -> None:
        """Write the record."""
        self.files = {path.name: file_sha256(path) for path in sorted(self._aside.iterdir())}
        record = {**self.facts, "files": self.files, **provenance.environment()}
        if self._adds:
            self.kept = dict(self._older())
            earlier = self._earlier_calls() if self.kept else []
            record |= {"files": {**self.files, **self.kept}}
            record |= {"earlier": earlier} if earlier else {}
        write_json(self.path(self.record), sealed(record))

    def remove_older(self) -> None:
        """Remove files of an earlier call that this one did not write, and say so.

        Only those that are as that call left them; where files are added, none.
        """
        older = [] if self._adds else [name for name, _ in self._older()]
        for name in older:
            (self.folder / name).unlink()
        if older:
            LOGGER.info(
                f"Removed from {self.folder}, as they were of an earlier call and this one makes "
                f"none: {', '.join(older)}."
            )

    def _older(self) -> Iterator[tuple[str, str]]:
        """Give name and SHA-256 of what earlier calls wrote, this one did not, and nobody changed.

        A record may come from anywhere: never a file outside the folder.
        """
        before = self.before.files
        for name, sha256 in before.items() if isinstance(before, dict) else ():
            if name not in self.files and is_plain(name) and _is_same(self.folder / name, sha256):
                yield name, sha256

    def _earlier_calls(self) -> list[dict[str, Any]]:
        """Give the facts of each earlier call of which files are kept, and their names."""
        path = self.folder / self.record
        known = [
            (entry, build_record(EarlierCall, entry, path).files) for entry in self.before.earlier
        ]
        named = {name for _, files in known for name in files}
        facts = {k: x for k, x in read_record(path).items() if k not in ("files", "earlier", SEAL)}
        calls = [*known, (facts, [name for name in self.kept if name not in named])]
        left = [(facts, [x for x in files if x in self.kept]) for facts, files in calls]
        return [{**facts, "files": files} for facts, files in left if files]


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
        return build_record(EarlierRecord, check_seal(path), path)
    except InputError as error:
        raise InputError(
            f"{path} is there, and is no whole record of this program; move it, or choose another "
            f"folder ({error})"
        ) from None


def _was_being_moved(record: str, left: Path) -> bool:
    """Whether files that lie aside are what a call of this program was about to move.

    The record among them, which is moved last, names them all by their hashes, and none would
    replace a file in the folder that its own record does not know, or that has changed.
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
        and (
            not os.path.lexists(place / name)
            or (there and (name == record or before.has_left(place / name)))
        )
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
def output_folder(folder: str | Path, record: str, *, adds: bool = False) -> Iterator[OutputFolder]:
    """Fill a folder: if the block ends well, all files and their record appear, the record last.

    Else nothing has changed. Nobody else can write there meanwhile.

    Parameters
    ----------
    folder : str or Path
    record : str
        Name of the record, a JSON file.
    adds : bool, optional
        Whether files of earlier calls that this one does not write stay, and the record says which
        call made which; otherwise they are removed, because a folder holds one result.

    Raises
    ------
    InputError
        If another process writes there, the record of an earlier call is damaged, or a file is
        in the way that is not from such a call.
    """
    folder = Path(folder)
    with exclusive(folder):
        with together(folder, record, partial(_was_being_moved, record)) as aside:
            outputs = OutputFolder(folder, aside, record, adds)
            try:
                yield outputs
                outputs.finish()
            except OSError as error:  # a full disk is met in the middle of a file, which is aside
                if str(error.filename or aside).startswith(str(aside)):
                    error.filename = str(outputs.latest)
                raise
        outputs.remove_older()
