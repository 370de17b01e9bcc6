"""Files in a ZIP archive, read into memory within bounds; nothing is extracted."""

from pathlib import Path, PurePosixPath
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile, ZipInfo

from lf_flame._common.inflating import LARGEST_RATIO
from lf_flame._common.input_files import ZIP_ERRORS, PackedFile, readable
from lf_flame._common.memory import check_memory
from lf_flame.errors import InputError

MOST_FILES = 100_000
"""Largest number of files in an archive."""

ENCRYPTED = 0x1
"""Bit of a member's flags that says that it is encrypted."""


def list_zip(path: str | Path) -> list[PurePosixPath]:
    """Names of the files in an archive, as paths inside it.

    Raises
    ------
    InputError
        If it is no archive, or holds more than `MOST_FILES`.
    """
    with readable(path, ZIP_ERRORS, "no ZIP archive"), ZipFile(path) as archive:
        members = [one.filename for one in archive.infolist() if not one.is_dir()]
    if len(members) > MOST_FILES:
        raise InputError(
            f"{path} cannot be read: it holds {len(members):,} files, and {MOST_FILES:,} are the "
            f"most."
        )
    return [PurePosixPath(name) for name in members]


def read_zip(path: str | Path, names: list[PurePosixPath]) -> list[PackedFile]:
    """Read files of an archive into memory.

    Parameters
    ----------
    path : str or Path
    names : list of PurePosixPath
        Names from `list_zip`.

    Raises
    ------
    InputError
        If one is damaged, encrypted, packed in another way than by DEFLATE, or says that it holds
        more than DEFLATE can pack; or if together they exceed the memory limit.
    """
    with readable(path, (KeyError, *ZIP_ERRORS), "no ZIP archive"), ZipFile(path) as archive:
        members = [archive.getinfo(str(name)) for name in names]
        for member in members:
            _check_member(member, path)
        check_memory(sum(member.file_size for member in members), path)
        return [PackedFile(Path(path), one.filename, _read(archive, one)) for one in members]


def _read(archive: ZipFile, member: ZipInfo) -> bytes:
    """Unpack as many bytes as an entry says; without the number all would be unpacked at once."""
    with archive.open(member) as file:
        return file.read(member.file_size)


def _check_member(member: ZipInfo, path: str | Path) -> None:
    if member.flag_bits & ENCRYPTED:
        raise InputError(f"{path} cannot be read: {member.filename} in it is encrypted.")
    if member.compress_type not in (ZIP_STORED, ZIP_DEFLATED):
        raise InputError(
            f"{path} cannot be read: {member.filename} in it is packed by method "
            f"{member.compress_type}; only stored files and DEFLATE are read."
        )
    if member.file_size > LARGEST_RATIO * member.compress_size:
        raise InputError(
            f"{path} cannot be read: {member.filename} in it says that {member.compress_size:,} "
            f"bytes hold {member.file_size:,}, more than DEFLATE can pack."
        )
