"""Files of a results folder, and the record that knows them again.

``NAME.json`` is the record of ``NAME.csv``, ``NAME.md`` and ``NAME_history.csv``: it holds all
numbers in full, and the SHA-256 of the other files. Older records hold no SHA-256.
"""

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lf_flame._common.atomic_files import together
from lf_flame._common.checksums import file_sha256
from lf_flame._common.config import load_record
from lf_flame._common.input_files import read_text
from lf_flame._common.locks import exclusive
from lf_flame.errors import InputError

ENDINGS = (".csv", ".md", "_history.csv")

WRITING_S = 60.0
"""How long one writer waits for another, which is at it for about a second."""


@contextmanager
def results_aside(folder: Path, last: str) -> Iterator[Path]:
    """Give an empty folder, as `together` does, to one writer of a results folder at a time."""
    with exclusive(folder, wait_s=WRITING_S), together(folder, last=last) as aside:
        yield aside


@dataclass(frozen=True)
class Row:
    """A plane's means over the test split; a noise ratio that is infinite is none in JSON."""

    depth_mm: float
    ssim: float
    psnr_db: float | None


@dataclass(frozen=True)
class ResultRecord:
    """What the record of a table says; there is more in it."""

    seed: int
    preset: str
    split: list[float]
    model: dict[str, Any]
    recipe: dict[str, Any]
    epochs: int
    backbone_weights: str
    scenes_sha256: str
    data_sha256: str
    table: list[Row]
    devices: list[str] = field(default_factory=list)
    sha256: dict[str, str] = field(default_factory=dict)

    def __post_init__(self):
        if not isinstance(self.recipe.get("batch_size"), int):
            raise InputError("recipe must hold a batch_size, a whole number.")


def hashes_of(folder: Path, name: str) -> dict[str, str]:
    """SHA-256 of the files of a table, those that are there."""
    paths = [folder / f"{name}{ending}" for ending in ENDINGS]
    return {path.name: file_sha256(path) for path in paths if path.exists()}


def text_sha256(text: str) -> str:
    """SHA-256 of a text file that is still to be written."""
    return hashlib.sha256(text.encode()).hexdigest()


def read_result_record(folder: Path, name: str) -> ResultRecord | None:
    """Read the record of a table, and see that the files beside it are those it was written with.

    None where there is no such table; an InputError says that one of them is damaged.
    """
    if not (folder / f"{name}.csv").exists():
        return None
    record = load_record(ResultRecord, folder / f"{name}.json")
    for ending in ENDINGS:
        path = folder / f"{name}{ending}"
        known = record.sha256.get(path.name)
        if known is None:  # an older record: a file that was cut has a last line without its end
            whole = not path.exists() or read_text(path).endswith("\n")
        else:
            whole = path.exists() and file_sha256(path) == known
        if not whole:
            raise InputError(
                f"{path} is damaged: it is not the file that was written with the record beside "
                f"it; make it anew by `python -m experiments evaluate`."
            )
    return record
