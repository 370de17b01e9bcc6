"""The numbers that the paper prints, read from experiments/paper_values.toml."""

from dataclasses import dataclass
from pathlib import Path

from lf_flame._common.config import build, strict
from lf_flame._common.input_files import read_toml
from lf_flame.errors import InputError


@strict
@dataclass(frozen=True)
class PrintedSlopes:
    """Slopes that the paper prints, one for each depth."""

    source: str
    title: str
    depth_mm: list[float]
    slope: list[float]

    def __post_init__(self):
        _check_columns(self.depth_mm, self.slope)


@strict
@dataclass(frozen=True)
class PrintedScores:
    """A table of the paper, a row for each depth."""

    source: str
    title: str
    object: list[str]
    depth_mm: list[float]
    ssim: list[float]
    psnr_db: list[float]

    def __post_init__(self):
        _check_columns(self.depth_mm, self.object, self.ssim, self.psnr_db)


def _check_columns(depths_mm: list[float], *columns: list) -> None:
    lengths = [len(column) for column in (depths_mm, *columns)]
    if len(set(lengths)) > 1 or len(set(depths_mm)) < len(depths_mm) or not depths_mm:
        raise InputError(
            f"all columns need a value for each depth, and no depth twice, got {lengths} values."
        )


def read_paper_values(path: str | Path, table: str) -> dict:
    """Read the printed values of one of the paper's tables."""
    values = read_toml(path)
    if table not in values:
        raise InputError(f"{path} has no table {table!r}; it has {', '.join(values)}.")
    build(PrintedSlopes if table == "slopes" else PrintedScores, values[table], f"{path}: {table}")
    return values[table]
