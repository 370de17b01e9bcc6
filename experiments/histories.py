"""How runs learnt: the tables ``history.csv``, read so that one that was cut is noticed."""

import math
from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.stats import linregress

from lf_flame._common.input_files import read_text, readable
from lf_flame.errors import InputError

LEAST_EPOCHS = 20
"""Smallest number of epochs of a run whose second half tells a trend."""

COLUMNS = ["epoch", "seconds", "val_psnr_db"]


def epochs_in_words(record: dict) -> str:
    """Say how long a run learnt, from its record: "84 of 1,000 epochs, best 81, batch 2"."""
    if record["epochs"] == 0:
        return "another decoder, solved, no epochs"
    asked = record["recipe"].get("epochs", record["epochs"])
    best = record.get("best_epoch")
    done = f"{record['epochs']:,}" + (f" of {asked:,}" if asked > record["epochs"] else "")
    best = f", best {best}" if best is not None else ""
    return f"{done} epochs{best}, batch {record['recipe']['batch_size']}"


def recipe_in_words(preset: str) -> str:
    """Name the recipe of a preset."""
    return "closed form" if preset == "closed-form" else f"{preset} recipe"


def read_history(path: Path, epochs: int | None = None) -> pd.DataFrame:
    """Read a run's history; the seconds are counted since its start.

    It holds the start and behind it `epochs`, or as many as there are. An InputError says that the
    file is missing, damaged or cut: a line without an end may end within a number.
    """
    text = read_text(path)
    with readable(path, (ValueError, OverflowError)):
        rows = pd.read_csv(StringIO(text))
    wanted = list(range(len(rows) if epochs is None else epochs + 1))
    whole = (
        text.endswith("\n")
        and set(COLUMNS) <= set(rows.columns)
        and list(rows["epoch"]) == wanted != []
        and all(rows[name].dtype.kind in "if" and rows[name].notna().all() for name in COLUMNS)
    )
    if not whole:
        raise InputError(
            f"{path} is damaged: it must hold the numbers {', '.join(COLUMNS)} of the epochs 0 to "
            f"{wanted[-1] if wanted else 0}, each line with its end."
        )
    return rows.assign(seconds=rows["seconds"].cumsum())


def trend(history: pd.DataFrame) -> tuple[float, float]:
    """Fit a line to the validation PSNR over the second half of a run's epochs.

    Returns by how much it rises in ten epochs, in dB, and two standard errors of that, as if what
    is left of each epoch were independent; NaN for fewer epochs than `LEAST_EPOCHS`.
    """
    if len(history) <= LEAST_EPOCHS:
        return math.nan, math.nan
    half = history.iloc[len(history) // 2 :]
    line = linregress(half["epoch"], half["val_psnr_db"])
    return 10 * line.slope, 20 * line.stderr


def extrapolate(history: pd.DataFrame, epochs: int) -> float:
    """Tell what validation PSNR in dB a run would have around a later epoch, at most.

    The PSNR is taken to go on rising with the logarithm of the epoch as over the second half of the
    run. Trainings flatten: what came later was below this in all runs that went on
    (`docs/reproduction.md`). NaN for fewer epochs than `LEAST_EPOCHS`.
    """
    if len(history) <= LEAST_EPOCHS:
        return math.nan
    half = history.iloc[len(history) // 2 :]
    line = linregress(np.log(half["epoch"]), half["val_psnr_db"])
    return float(line.intercept + line.slope * math.log(epochs))
