"""Files of a results folder, and the record that knows them again.

``NAME.json`` is the record of ``NAME.csv``, ``NAME.md`` and ``NAME_history.csv``, with all numbers.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lf_flame._common.config import load_record
from lf_flame._common.input_files import read_text
from lf_flame.errors import InputError

ENDINGS = (".csv", ".md", "_history.csv")


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
    table: list[Row]
    devices: list[str] = field(default_factory=list)
    data_sha256: str = ""

    def __post_init__(self):
        if not isinstance(self.recipe.get("batch_size"), int):
            raise InputError("recipe must hold a batch_size, a whole number.")


def read_result_record(folder: Path, name: str) -> ResultRecord | None:
    """Read the record of a table; None where there is no such table.

    An InputError says that a file beside it was cut: its last line has no end.
    """
    if not (folder / f"{name}.csv").exists():
        return None
    for path in (folder / f"{name}{ending}" for ending in ENDINGS):
        if path.exists() and not read_text(path).endswith("\n"):
            raise InputError(
                f"{path} is damaged: it is cut short; make it anew by "
                f"`python -m experiments evaluate`."
            )
    return load_record(ResultRecord, folder / f"{name}.json")
