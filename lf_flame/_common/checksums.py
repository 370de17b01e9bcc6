"""Checksums of files, and of records, which contain their own hash.

Damage to a file or a record is therefore noticed.
"""

import hashlib
import json
from pathlib import Path
from typing import Any

from lf_flame._common.input_files import check_regular, read_record
from lf_flame.errors import InputError

SEAL = "record_sha256"
"""Key of the hash of all other entries of a record."""


def file_sha256(path: str | Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal digits.

    Raises
    ------
    InputError
        If it is not a regular file: a device may never end.
    """
    check_regular(path)
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def sealed(record: dict[str, Any]) -> dict[str, Any]:
    """Record as JSON values, with a hash of all of them added."""
    valid = json.loads(json.dumps(record), parse_constant=lambda name: None)
    return valid | {SEAL: _hash(valid)}


def check_seal(path: str | Path, instead: str = "") -> dict[str, Any]:
    """Read a record and compare it with its own hash; records of older versions have none.

    Parameters
    ----------
    path : str or Path
    instead : str, optional
        End of the message on a hash that does not match: what to do instead of changing the record.

    Returns
    -------
    dict
        The record.

    Raises
    ------
    InputError
        If the file cannot be read, or its hash does not match.
    """
    record = read_record(path)
    if record.get(SEAL) not in (None, _hash(record)):
        raise InputError(f"{path} is not what was written: it does not fit its own hash{instead}.")
    return record


def _hash(record: dict[str, Any]) -> str:
    rest = {key: value for key, value in record.items() if key != SEAL}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()
