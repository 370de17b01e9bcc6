"""A file is known by its SHA-256, and a device has none."""

import os

import pytest

from lf_flame._common.checksums import file_sha256
from lf_flame.errors import InputError


def test_the_hash_is_that_of_the_standard(tmp_path):
    """FIPS 180-4's own example."""
    (tmp_path / "a").write_bytes(b"abc")
    expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert file_sha256(tmp_path / "a") == expected


def test_what_has_no_end_is_refused(tmp_path):
    (tmp_path / "a").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "b")
    for name, kind in (("a", "a device"), ("b", "a pipe")):
        with pytest.raises(InputError, match=f"{name} cannot be read: .* is {kind}"):
            file_sha256(tmp_path / name)
