"""The numbers that the paper prints, read from experiments/paper_values.toml."""

from pathlib import Path

from lf_flame._common.input_files import read_toml
from lf_flame.errors import InputError


def read_paper_values(path: str | Path, table: str) -> dict:
    """Read the printed values of one of the paper's tables."""
    values = read_toml(path)
    if table not in values:
        raise InputError(f"{path} has no table {table!r}; it has {', '.join(values)}.")
    return values[table]
