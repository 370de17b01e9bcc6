"""Checksums, by which a file is known again."""

import hashlib
from pathlib import Path

from lf_flame._common.input_files import check_regular


def file_sha256(path: str | Path) -> str:
    """Compute the SHA-256 of a file's bytes, in hexadecimal digits.

    Raises
    ------
    InputError
        If it is no regular file: a device may never end.
    """
    check_regular(path)
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
