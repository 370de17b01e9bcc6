"""Folders of outputs with a record that says what counts, all of which appear together."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lf_flame._common import provenance
from lf_flame._common.atomic_files import together, write_json
from lf_flame._common.checksums import file_sha256
from lf_flame._common.config import load_record
from lf_flame._common.locks import exclusive
from lf_flame.errors import InputError


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

    Raises
    ------
    InputError
        If that record is damaged, or not from such a call.
    """

    def __init__(self, folder: Path, aside: Path, record: str):
        self.folder, self.record, self._aside = folder, record, aside
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
        return self._aside / name

    def _is_ours(self, name: str) -> bool:
        # Records from before they named their files: the folder is theirs.
        known = [name] if self.before.files is None else [*self.before.files, self.record]
        return not self._is_first and name in known

    def finish(self) -> None:
        """Write the record."""
        self.files = {path.name: file_sha256(path) for path in sorted(self._aside.iterdir())}
        record = {**self.facts, "files": self.files, **provenance.environment()}
        write_json(self.path(self.record), record)

    def remove_older(self) -> None:
        """Remove files of an earlier call that this one did not write, if they are as it left them.

        A record may come from anywhere: never a file outside the folder, nor one that changed.
        """
        before = self.before.files
        for name, sha256 in before.items() if isinstance(before, dict) else ():
            if name not in self.files and is_plain(name) and self._is_still(name, sha256):
                (self.folder / name).unlink()

    def _is_still(self, name: str, sha256: str) -> bool:
        path = self.folder / name
        return path.is_file() and not path.is_symlink() and file_sha256(path) == sha256


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
    files = load_record(EarlierRecord, folder / record).files
    if not isinstance(files, dict):
        raise InputError(
            f"{folder / record} has no hashes of its files, as records of older versions; call the "
            f"command again."
        )
    for name, sha256 in files.items():
        path = folder / name
        if not is_plain(name) or not path.is_file() or file_sha256(path) != sha256:
            raise InputError(f"{path} is not the file that {record} was written for.")
    return len(files)


def _read_earlier(path: Path) -> EarlierRecord:
    try:
        return load_record(EarlierRecord, path)
    except InputError as error:
        raise InputError(
            f"{path} is there, and is no whole record of this program; move it, or choose another "
            f"folder ({error})"
        ) from None


def is_plain(name: str) -> bool:
    """Whether a name is that of a file in a folder, and no path."""
    return name == Path(name).name and "\0" not in name


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
        with together(folder, last=record) as aside:
            outputs = OutputFolder(folder, aside, record)
            yield outputs
            outputs.finish()
        outputs.remove_older()
