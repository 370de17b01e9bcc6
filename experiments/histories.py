"""Histories of training runs, and their length in words."""

from io import StringIO
from pathlib import Path

import pandas as pd

from lf_flame._common.input_files import read_text, readable
from lf_flame.errors import InputError

COLUMNS = ["epoch", "seconds", "val_psnr_db"]


def epochs_in_words(record: dict) -> str:
    """Describe the length of a run from its record: "84 of 1,000 epochs, best 81, batch 2"."""
    epochs, recipe = record["epochs"], record["recipe"]
    if epochs == 0:
        return "closed form, no epochs"
    planned = recipe.get("epochs", epochs)
    length = f"{epochs:,} of {planned:,}" if planned > epochs else f"{epochs:,}"
    best = record.get("best_epoch")
    best = f", best {best:,}" if best is not None else ""
    return f"{length} epochs{best}, batch {recipe['batch_size']}"


def recipe_in_words(preset: str) -> str:
    """Name the recipe of a preset."""
    return "closed form" if preset == "closed-form" else f"{preset} recipe"


def read_history(path: Path, epochs: int | None = None) -> pd.DataFrame:
    """Read a run's ``history.csv``: epoch 0 (the start) and `epochs` more, or all there are.

    The seconds are counted from the start of the run. An InputError refuses a file that is missing,
    damaged or cut; without the last line's end, its last number may be cut.
    """
    text = read_text(path)
    with readable(path, (ValueError, OverflowError)):
        rows = pd.read_csv(StringIO(text))
    expected = list(range(len(rows) if epochs is None else epochs + 1))
    complete = (
        text.endswith("\n")
        and set(COLUMNS) <= set(rows.columns)
        and list(rows["epoch"]) == expected != []
        and all(rows[name].dtype.kind in "if" and rows[name].notna().all() for name in COLUMNS)
    )
    if not complete:
        raise InputError(
            f"{path} is damaged: it must hold the numbers {', '.join(COLUMNS)} of the epochs 0 to "
            f"{expected[-1] if expected else 0}, each line with its end."
        )
    return rows.assign(seconds=rows["seconds"].cumsum())
