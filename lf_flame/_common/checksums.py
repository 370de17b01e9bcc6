"""Checksums, by which a file is known again."""

import hashlib
from pathlib import Path


def file_sha256(path: str | Path) -> str:
    """Compute the SHA-256 of a file's bytes, in hexadecimal digits."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
