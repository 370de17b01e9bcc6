"""Places in which data sets are built: folders, and object stores such as S3.

In a folder a data set is built as ``NAME.part`` and renamed when it is complete. An object store
cannot rename: there it is built under its final name, and is complete when its attributes have the
hash of its images.
"""

import sys
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import zarr

from lf_flame._common.atomic_files import atomic_folder
from lf_flame._common.config import build_record
from lf_flame._common.input_files import parse_json, readable
from lf_flame._common.locks import exclusive
from lf_flame._common.zarr_files import ZARR_ERRORS
from lf_flame.datasets.config import DatasetConfig
from lf_flame.datasets.hashes import describe_arrays
from lf_flame.datasets.metadata import (
    METADATA,
    Attributes,
    check_array_files,
    check_array_records,
    read_attributes,
)
from lf_flame.errors import InputError

Group = zarr.Group

CLIENTS = {"botocore.exceptions": ("BotoCoreError", "ClientError"), "aiohttp": ("ClientError",)}
"""Names of exceptions of stores' clients that are not built-in ones, by their module."""


class Place(ABC):
    """Place in which a data set is built.

    Attributes
    ----------
    name : str
        Name of the place, in messages.
    address : str
        Address with which `open_group` opens it, here and on other machines.
    """

    name: str
    address: str

    @abstractmethod
    def reserved(self):
        """Context in which no other process builds there, as far as the place can ensure this.

        Raises
        ------
        InputError
            If a data set is there, or another process builds one.
        """

    @abstractmethod
    def attributes(self) -> Attributes | None:
        """Attributes of a data set that was begun; None if there is none.

        Raises
        ------
        InputError
            If something else is in the way.
        """

    @abstractmethod
    def laid_out(self):
        """Context with an empty group, which appears when the block succeeds."""

    @abstractmethod
    def count_samples(self, config: DatasetConfig) -> int:
        """Check the arrays of a data set that was begun, and count its samples."""

    @abstractmethod
    def reading(self):
        """Context that turns errors of reading samples into one sentence."""

    @abstractmethod
    def finish(self) -> None:
        """Move a complete data set to its final place."""

    def open(self) -> Group:
        """Open the data set that is being built."""
        return open_group(self.address)


def find_place(target: str | Path) -> Place:
    """Make the place for a folder, or for the URL of an object store.

    Raises
    ------
    InputError
        If the store cannot be reached.
    """
    return ObjectStore(str(target)) if is_url(target) else Folder(Path(target))


def is_url(target: str | Path) -> bool:
    """Whether a place is in an object store: SCHEME://BUCKET/NAME."""
    return isinstance(target, str) and "://" in target


def open_group(address: str) -> Group:
    """Open a data set that is being built, by the address of its place."""
    with _reaching(address):
        return zarr.open_group(address, mode="r+")


class Folder(Place):
    """A folder on this machine, or on a shared file system."""

    def __init__(self, path: Path):
        self.path, self.part = path, path.with_name(path.name + ".part")
        self.name, self.address = str(self.part), str(self.part.resolve())

    @contextmanager
    def reserved(self) -> Iterator[None]:
        """Lock the folder."""
        with exclusive(self.path):
            if self.path.exists() or self.path.is_symlink():  # a folder cannot replace a link
                raise InputError(f"{self.path} exists; remove it or choose another folder.")
            yield

    def attributes(self) -> Attributes | None:
        """Read the attributes from the folder."""
        if not self.part.exists():
            return None
        found = read_attributes(self.part) if (self.part / METADATA).exists() else None
        if found is None:
            raise InputError(
                f"{self.part} is in the way: a data set is built under that name, but this is "
                f"none; move it or choose another folder."
            )
        return found

    @contextmanager
    def laid_out(self) -> Iterator[Group]:
        """Create the group under a temporary name."""
        with atomic_folder(self.part) as aside:  # so that NAME.part is always a data set
            yield zarr.open_group(aside, mode="w", zarr_format=3)

    def count_samples(self, config: DatasetConfig) -> int:
        """Count the samples in the files' metadata."""
        return check_array_files(self.part, config)

    def reading(self):
        """Name the folder if Zarr raises an error."""
        return readable(self.part / METADATA, ZARR_ERRORS, "a sample is")

    def finish(self) -> None:
        """Remove remains of interrupted writes, and rename the folder."""
        for left in self.part.rglob("*.partial"):  # written by Zarr's store
            left.unlink(missing_ok=True)
        self.part.rename(self.path)


class ObjectStore(Place):
    """A place in an object store that fsspec can access, with the environment's credentials.

    Object stores have no locks: the user must ensure that only one process builds there.
    """

    def __init__(self, url: str):
        self.name = self.address = url.rstrip("/")
        with _reaching(url):
            import fsspec

            self._files, self._root = fsspec.core.url_to_fs(self.address)
            if "file" in self._files.protocol or "local" in self._files.protocol:
                raise InputError(f"{url} is a folder of this machine: give its path without ://.")
            # The listing may be outdated when a data set is requested again.
            self._files.invalidate_cache()

    @contextmanager
    def reserved(self) -> Iterator[None]:
        """Refuse to build a data set again."""
        there = self.attributes()
        if there is not None and there.sha256 is not None:
            raise InputError(f"{self.name} exists; remove it or choose another place.")
        yield

    def attributes(self) -> Attributes | None:
        """Read the attributes from the store."""
        file = f"{self._root}/{METADATA}"
        with _reaching(self.name):
            if not self._files.exists(self._root):
                return None
            text = self._files.cat_file(file).decode() if self._files.exists(file) else "{}"
        values = parse_json(text, f"{self.name}/{METADATA}")
        found = values.get("attributes") if isinstance(values, dict) else None
        if not isinstance(found, dict) or "config" not in found:  # it is written last
            raise InputError(
                f"{self.name} is in the way: something is there that is no data set, or one that "
                f"was cut off at once; what is there is never removed, so choose another place."
            )
        return build_record(Attributes, found, self.name)

    @contextmanager
    def laid_out(self) -> Iterator[Group]:
        """Create the group in place; attributes come last."""
        with _reaching(self.name):
            group = zarr.open_group(self.address, mode="w-", zarr_format=3)
        yield group

    def count_samples(self, config: DatasetConfig) -> int:
        """Count the samples in the arrays' metadata."""
        group = self.open()
        with _reaching(self.name, damaged=True):
            described = describe_arrays(group)
        return check_array_records(self.name, described, config)

    def reading(self):
        """Name the place if the store or Zarr raises an error."""
        return _reaching(self.name, damaged=True)

    def finish(self) -> None:
        """Do nothing: the data set was built in its final place."""


@contextmanager
def writing(address: str) -> Iterator[None]:
    """Turn errors of writing to a store into one sentence; a folder's errors are one already."""
    with _reaching(address):
        yield


@contextmanager
def _reaching(address: str, damaged: bool = False) -> Iterator[None]:
    """Turn errors of a store, or of reading its data, into one sentence.

    Only calls of the store and of Zarr belong inside the block.
    """
    if not is_url(address):
        yield
        return
    try:
        yield
    except InputError:
        raise
    except ImportError as error:
        raise InputError(
            f"{address} cannot be reached: {error}; S3 needs pip install 'lf_flame[s3]'."
        ) from None
    except _store_errors(damaged) as error:
        reason = str(error).strip().partition("\n")[0] or type(error).__name__
        what = "reached, or is damaged" if damaged else "reached"
        raise InputError(f"{address} cannot be {what}: {reason[:200]}.") from error


def _store_errors(damaged: bool) -> tuple[type[Exception], ...]:
    """List the exceptions of stores; loaded clients have their own."""
    found: list[type[Exception]] = [OSError, ValueError, NotImplementedError]
    for module, names in CLIENTS.items():
        loaded = sys.modules.get(module)
        found += [getattr(loaded, name) for name in names if loaded]
    return (*found, *(ZARR_ERRORS if damaged else ()))
