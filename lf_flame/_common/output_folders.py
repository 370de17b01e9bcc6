"""Output folders with a record of their files; files and record appear together."""

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from lf_flame._common import provenance
from lf_flame._common.atomic_files import name_file, together, write_json
from lf_flame._common.checksums import SEAL, check_seal, file_sha256, sealed
from lf_flame._common.config import build_record, load_record
from lf_flame._common.input_files import read_record
from lf_flame._common.locks import exclusive
from lf_flame.errors import InputError

LOGGER = logging.getLogger(__name__)

LONGEST_NAME = 255
"""Longest file name in bytes that file systems accept."""


@dataclass(frozen=True)
class EarlierCall:
    """Required content of an entry of a record's list of earlier calls, beside its facts.

    Attributes
    ----------
    files : list of str
        Names of the files that the call wrote and that no later call replaced.
    """

    files: list[str]


@dataclass(frozen=True)
class EarlierRecord:
    """Content of the record of an earlier call.

    Attributes
    ----------
    versions : dict
        Versions of the program and its libraries; a record of this program must have them.
    files : dict of str, or list of str, optional
        SHA-256 of each file by its name. Older versions stored only names, or nothing.
    source : str, optional
        Origin of the input, where the command records one.
    earlier : list of dict
        Facts of still earlier calls with files that remain, and the names of those files.
    """

    versions: dict[str, str]
    files: dict[str, str] | list[str] | None = None
    source: str | None = None
    earlier: list[dict[str, Any]] = field(default_factory=list)

    def names(self, name: str) -> bool:
        """Whether that call wrote a file; a record without a list of files claims all."""
        return self.files is None or name in self.files

    def has_left(self, path: Path) -> bool:
        """Whether that call wrote a file that is unchanged; links count, as they are replaced."""
        if not isinstance(self.files, dict) or path.is_symlink():
            return self.names(path.name)
        return path.name in self.files and _is_same(path, self.files[path.name])


class OutputFolder:
    """A folder that a command fills, and its record; made by `output_folder`.

    Parameters
    ----------
    folder : Path
        Final place of the files.
    aside : Path
        Temporary folder in which they are written.
    record : str
        Name of the record, a JSON file.
    adds : bool, optional
        Whether files of earlier calls stay beside those of this one.

    Attributes
    ----------
    facts : dict
        Content of the record, beside the SHA-256 of each file and the program's versions.
    files : dict of str
        SHA-256 of each file of this call by its name, known when all are written.
    kept : dict of str
        SHA-256 of each file of earlier calls that stays, by its name.
    before : EarlierRecord
        Record of the earlier call.
    latest : Path
        Final place of the file that was requested last, and is probably being written.

    Raises
    ------
    InputError
        If the earlier record is damaged, or is not from such a call.
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
        """Path at which to write a file.

        Raises
        ------
        InputError
            If a file of that name exists that no earlier call wrote, or that has changed since.
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
        """Remove files that only an earlier call wrote, and log their names.

        Only unchanged files are removed; none where files are added.
        """
        older = [] if self._adds else [name for name, _ in self._older()]
        for name in older:
            (self.folder / name).unlink()
        if older:
            LOGGER.info(
                f"Removed from {self.folder}, because an earlier call wrote them and this one does "
                f"not: {', '.join(older)}."
            )

    def _older(self) -> Iterator[tuple[str, str]]:
        """Name and SHA-256 of each unchanged file that only earlier calls wrote.

        A record may come from anywhere, so files outside the folder are never touched.
        """
        before = self.before.files
        for name, sha256 in before.items() if isinstance(before, dict) else ():
            if name not in self.files and is_plain(name) and _is_same(self.folder / name, sha256):
                yield name, sha256

    def _earlier_calls(self) -> list[dict[str, Any]]:
        """Facts of each earlier call with files that are kept, and the names of those files."""
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
    """Compare a folder's files with the hashes in its record.

    Returns
    -------
    int
        Number of files.

    Raises
    ------
    InputError
        If a file differs from its hash, or the record has no hashes.
    """
    found = check_seal(folder / record)
    files = build_record(EarlierRecord, found, folder / record).files
    if files is None:  # the record of a table
        files = found.get("sha256")
    if not isinstance(files, dict):
        raise InputError(
            f"{folder / record} has no hashes of its files, because an older version wrote it; run "
            f"the command again."
        )
    unreadable = None
    for name, sha256 in files.items():
        path = folder / name
        try:
            sound = is_plain(name) and path.is_file() and file_sha256(path) == sha256
        except OSError as error:  # first check whether another file is damaged
            unreadable = error
            continue
        if not sound and is_plain(name) and not path.exists():
            raise InputError(f"{path} is missing; {record} was written with it.")
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
    """Whether the files in a temporary folder are those that a killed call was moving.

    Their record, which is moved last, must name them all by their hashes, and none may replace a
    file in the folder that is unknown to the folder's own record, or has changed.
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
    """Whether a regular file, not a link, has this hash."""
    try:
        return path.is_file() and not path.is_symlink() and file_sha256(path) == sha256
    except OSError:  # cannot be read
        return False


def is_plain(name: str) -> bool:
    """Whether a name is a plain file name, without a path."""
    return name == Path(name).name and "\0" not in name and len(name.encode()) <= LONGEST_NAME


@contextmanager
def output_folder(folder: str | Path, record: str, *, adds: bool = False) -> Iterator[OutputFolder]:
    """Fill a folder: if the block succeeds, all files and their record appear, the record last.

    If it fails, nothing changes. No other process can write there meanwhile.

    Parameters
    ----------
    folder : str or Path
    record : str
        Name of the record, a JSON file.
    adds : bool, optional
        Whether files of earlier calls stay, with a record of which call made which. Otherwise
        they are removed, because a folder holds one result.

    Raises
    ------
    InputError
        If another process writes there, the record of an earlier call is damaged, or a file
        that no such call wrote would be replaced.
    """
    folder = Path(folder)
    with exclusive(folder):
        with together(folder, record, partial(_was_being_moved, record)) as aside:
            outputs = OutputFolder(folder, aside, record, adds)
            try:
                yield outputs
                outputs.finish()
            except OSError as error:  # a full disk names the temporary file; name the final one
                if str(error.filename or aside).startswith(str(aside)):
                    name_file(error, outputs.latest)
                raise
        outputs.remove_older()
