"""A run folder, and the epochs of a training run that goes on where it was cut off.

The folder holds ``config.json`` (what was asked for), ``checkpoint-*/`` (the newest whole state),
``history.csv``, and at the end ``model.keras`` (the best weights by validation loss, the whole
network) and ``run.json`` (the record).
"""

import math
import time
from pathlib import Path

import numpy as np
from tqdm import tqdm

from lf_flame.checkpoints import Checkpoint, save_checkpoint
from lf_flame.errors import InputError
from lf_flame.files import read_json, write_json


def is_done(out: Path, asked: dict) -> bool:
    """Whether the folder holds this run, finished."""
    if not ((out / "run.json").exists() and (out / "model.keras").exists()):
        return False
    found = read_json(out / "run.json")
    return all(found.get(key) == asked[key] for key in asked)


def claim_folder(out: Path, asked: dict) -> None:
    """Write what is asked for into a new run folder; refuse one that holds something else.

    A run at a constant rate may go on for more epochs: it is as if they had been asked for at once.

    Parameters
    ----------
    out : Path
        The run folder.
    asked : dict
        Everything that decides how the run turns out, as JSON values; "recipe" is one of them.

    Raises
    ------
    InputError
        If the folder holds another run.
    """
    path = out / "config.json"
    if not path.exists():
        write_json(path, asked)
        return
    found = read_json(path)
    if _goes_on(found.get("recipe", {}), asked["recipe"]):
        found["recipe"]["epochs"] = asked["recipe"]["epochs"]
        if found == asked:
            write_json(path, asked)
    changed = [key for key in asked if found.get(key) != asked[key]]
    if changed:
        key = changed[0]
        raise InputError(
            f"{out} holds a run with another {key} ({found.get(key)}, now {asked[key]}); "
            f"remove the folder or choose another (RUN=name)."
        )


def _goes_on(found: dict, asked: dict) -> bool:
    return asked["schedule"] == "constant" and found.get("epochs", math.inf) < asked["epochs"]


def fit(run: Checkpoint, trainer, recipe, seed: int, out: Path, show: bool, started: float) -> None:
    """Train until the recipe's last epoch, with a progress bar and checkpoints.

    Parameters
    ----------
    run : Checkpoint
        How far it has come; brought up to date.
    trainer
        See `lf_flame.trainers`.
    recipe
        With `epochs`, and `checkpoint_s`, the seconds between checkpoints; 0: after every epoch.
    seed : int
        Of the order of the samples.
    out : Path
        Run folder.
    show : bool
        Show progress.
    started : float
        When the run was started; the seconds of epoch 0, the start, are all since then.

    Raises
    ------
    InputError
        If the loss stops being a number.
    """
    saved_at = time.perf_counter()
    bar = tqdm(total=recipe.epochs, desc="training", unit="epoch", disable=not show)
    with bar:
        bar.update(run.epochs_done)
        for epoch in range(run.next_epoch, recipe.epochs + 1):
            begun = time.perf_counter() if epoch else started
            losses = _run_epoch(trainer, seed, epoch)
            seconds = round(time.perf_counter() - begun, 4)
            run.record({"epoch": epoch, **losses, "seconds": seconds}, trainer)
            bar.set_postfix_str(f"best validation PSNR {run.best_row['val_psnr_db']:.2f} dB")
            bar.update(epoch > 0)
            now = time.perf_counter()
            if epoch == recipe.epochs or now - saved_at >= recipe.checkpoint_s:
                run.state = trainer.state
                save_checkpoint(run, out)
                saved_at = now


def _run_epoch(trainer, seed: int, epoch: int) -> dict:
    """One pass over the training samples, in an order that depends on seed and epoch alone.

    Epoch 0 only measures where training starts.
    """
    if epoch == 0:
        loss = trainer.evaluate("train")
    else:
        loss = trainer.train_epoch(np.random.default_rng([seed, epoch]))
    validation = trainer.evaluate("validation")
    if not np.isfinite([loss, validation]).all():
        raise InputError(
            f"The loss is no longer a number in epoch {epoch} (training {loss}, validation "
            f"{validation}); the last checkpoint is kept."
        )
    return {
        "loss": loss,
        "val_loss": validation,
        "val_psnr_db": float(-10 * np.log10(validation)),
    }
