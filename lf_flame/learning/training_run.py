"""A run folder, and the epochs of a training run that can be resumed.

The folder has ``config.json`` (the request), ``checkpoint-*/`` (the newest complete state),
``history.csv``, and at the end of a call ``model.keras`` (the whole network with the best weights
so far by validation loss) and ``run.json`` (the record, with the number of completed epochs).
"""

import reprlib
import signal
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, ZipFile

import keras
import numpy as np

from lf_flame._common import progress, provenance
from lf_flame._common.atomic_files import atomic_write, write_json
from lf_flame._common.config import build_record
from lf_flame._common.input_files import read_record
from lf_flame._common.locks import exclusive
from lf_flame.errors import InputError
from lf_flame.learning.checkpoints import Checkpoint, load_checkpoint, save_checkpoint
from lf_flame.learning.keras_loading import accelerators
from lf_flame.learning.run_folders import load_run

MAX_SEED = 1_000_000
"""Largest seed: layers use 1000 times the seed plus a small number as a 32-bit seed."""


@dataclass(frozen=True)
class FoundRecipe:
    """Required content of a recipe in a run folder."""

    epochs: int


@dataclass(frozen=True)
class FoundRequest:
    """Required content of the request in a run folder."""

    recipe: FoundRecipe


def check_seed(seed: int) -> None:
    """Refuse a seed that is out of range."""
    if not 0 <= seed <= MAX_SEED:
        raise InputError(f"seed must be 0 to {MAX_SEED}, got {seed}.")


TIMED_EPOCHS = 1
"""Number of epochs of a call before the one that is timed: the first ones compile."""

MOST_EPOCHS = 999_999
"""Maximum number of epochs; checkpoint names have six digits."""


@dataclass(frozen=True)
class Job:
    """Description of a training run.

    Attributes
    ----------
    request : dict
        Everything that determines the result of the run, as JSON values; "recipe" must contain
        `epochs` and `schedule`.
    epochs, seed : int
        Number of epochs, and seed of the order of the samples.
    checkpoint_s : float
        Time between checkpoints in seconds; 0 writes one after every epoch.
    start : callable
        Function of whether the run is new; returns the trainer (`lf_flame.learning.trainers`).
    finish : callable
        Function of the best weights; returns the network with them.
    metadata : dict
        Content of the record beside `request`.
    minutes : float, optional
        Time in minutes at which the call ends, at the nearest end of an epoch; 0 trains to the end.
    """

    request: dict
    epochs: int
    seed: int
    checkpoint_s: float
    start: Callable
    finish: Callable
    metadata: dict
    minutes: float = 0.0


def carry_out(job: Job, out: Path, started: float) -> Path:
    """Run a training, or continue one that was interrupted.

    Parameters
    ----------
    job : Job
    out : Path
        Run folder.
    started : float
        Start time from `time.perf_counter`; the seconds of epoch 0, the start, count from it.

    Returns
    -------
    Path
        Network ``model.keras`` in the run folder.

    Raises
    ------
    InputError
        If the folder contains another run, another process trains there, or the loss becomes NaN
        or infinite.
    """
    model = out / "model.keras"
    with exclusive(out):
        if _is_done(out, job):
            progress.tell(f"{out} holds this run, finished.")
            model.touch()  # make compares it with the configuration file
            return model
        _refuse_other_run(out, job.request)
        _train(job, model, started)
    return model


def _train(job: Job, model: Path, started: float) -> None:
    """Train from the last checkpoint, and write network and record."""
    out = model.parent
    run = load_checkpoint(out, _decides_epochs(job.request))
    write_json(out / "config.json", job.request)
    if run.history:
        progress.tell(f"Going on behind epoch {run.epochs_done} of {job.epochs}.")
    if run.next_epoch <= job.epochs:
        trainer = job.start(not run.history)
        if run.state:
            trainer.state = run.state
        _fit(run, trainer, job, out, started)
    network = job.finish(run.best)
    record = {
        **job.request,
        "epochs": run.epochs_done,
        "finished": run.epochs_done == job.epochs,
        "best_epoch": run.best_row["epoch"],
        "best_validation_loss": run.best_row["val_loss"],
        **job.metadata,
        "keras_backend": keras.backend.backend(),
        "devices": accelerators(),
        "start_s": run.history[0]["seconds"],
        "train_s": round(sum(row["seconds"] for row in run.history[1:]), 2),
        "wall_s": round(time.perf_counter() - started, 2),
        **provenance.environment(),
    }
    with atomic_write(model) as aside:  # renamed last: make looks at this file
        network.save(aside)
        model.unlink(missing_ok=True)  # a kill leaves no older network beside the new record
        write_json(out / "run.json", record)


def assign(variables: Iterable[keras.Variable], values: Iterable[np.ndarray]) -> None:
    """Assign values to variables."""
    for variable, value in zip(variables, values, strict=True):
        variable.assign(value)


def _is_done(out: Path, job: Job) -> bool:
    if not ((out / "run.json").exists() and (out / "model.keras").exists()):
        return False
    found, asked = load_run(out), {**job.request, "epochs": job.epochs}
    try:
        with ZipFile(out / "model.keras") as archive:
            whole = archive.testzip() is None
    except BadZipFile:
        whole = False
    # Older versions have other entries; those that both have decide.
    return whole and all(found[key] == asked[key] for key in asked if key in found)


def _decides_epochs(request: dict) -> dict:
    """Part of a request that determines the epochs; at a constant rate not their number."""
    recipe = request["recipe"]
    if recipe["schedule"] == "constant":
        recipe = {key: value for key, value in recipe.items() if key != "epochs"}
    return {**request, "recipe": recipe}


def _refuse_other_run(out: Path, request: dict) -> None:
    """Refuse a run folder that contains another run than the requested one.

    A run at a constant rate may continue for more epochs, with the same result as in one call.
    """
    path = out / "config.json"
    if not path.exists():
        return
    found = read_record(path)
    build_record(FoundRequest, found, path)
    if _goes_on(found["recipe"], request["recipe"]):
        found["recipe"]["epochs"] = request["recipe"]["epochs"]
    changed = [key for key in request if key in found and found[key] != request[key]]
    if changed:
        key = changed[0]
        raise InputError(
            f"{out} holds a run with another {key} ({reprlib.repr(found[key])}, now "
            f"{reprlib.repr(request[key])}); remove the folder or choose another."
        )


def _goes_on(found: dict, request: dict) -> bool:
    return request["schedule"] == "constant" and found["epochs"] < request["epochs"]


def _fit(run: Checkpoint, trainer, job: Job, out: Path, started: float) -> None:
    """Train to the last epoch, or until Ctrl-C or the time limit ends the call after an epoch."""
    saved_at, first = time.perf_counter(), run.next_epoch
    bar = progress.bar("training", job.epochs, "epoch", stays=True, initial=run.epochs_done)
    with bar as shown, _interrupt_after_epoch() as interrupted:
        for epoch in range(first, job.epochs + 1):
            begun = time.perf_counter() if epoch else started
            losses = _run_epoch(trainer, job.seed, epoch)
            now = time.perf_counter()
            run.record({"epoch": epoch, **losses, "seconds": round(now - begun, 4)}, trainer)
            shown.set_postfix_str(f"best validation PSNR {run.best_row['val_psnr_db']:.2f} dB")
            shown.update(epoch > 0)
            if epoch == first + TIMED_EPOCHS:
                _tell_duration(job, run.history[-1]["seconds"])
            # Whichever end of an epoch is nearest to the time: half of them are early, half late.
            middle_of_next = now - started + (now - begun) / 2
            over = job.minutes > 0 and epoch > 0 and middle_of_next >= 60 * job.minutes
            ends = epoch == job.epochs or over or bool(interrupted)
            if ends or now - saved_at >= job.checkpoint_s:
                run.state = trainer.state
                save_checkpoint(run, out, _decides_epochs(job.request))
                saved_at = now
            if ends:
                break
    if run.epochs_done < job.epochs:
        progress.tell(
            f"Saved behind epoch {run.epochs_done} of {job.epochs}, the best so far is "
            f"{run.best_row['epoch']}; the same command goes on from there."
        )
    if interrupted:
        raise KeyboardInterrupt


def _tell_duration(job: Job, epoch_s: float) -> None:
    """Tell how long all epochs take on this machine, from one in which nothing was compiled."""
    hours = job.epochs * epoch_s / 3600
    if hours < 1 / 60:
        return
    duration = f"{hours:.1f} h" if hours >= 1 else f"{60 * hours:.0f} minutes"
    progress.tell(f"{job.epochs} epochs: about {duration} on this machine, as busy as it is.")


@contextmanager
def _interrupt_after_epoch() -> Iterator[list[int]]:
    """Let Ctrl-C wait for the end of an epoch: within an epoch there is no state to resume from.

    Yields
    ------
    list of int
        Empty until Ctrl-C; a second Ctrl-C stops at once.
    """
    interrupted: list[int] = []

    def note(number: int, _frame: Any) -> None:
        if interrupted:
            raise KeyboardInterrupt
        interrupted.append(number)
        progress.tell("Stopping when this epoch is done and saved; Ctrl-C again stops at once.")

    try:
        before = signal.signal(signal.SIGINT, note)
    except ValueError:  # only the main thread can set handlers
        yield interrupted
        return
    try:
        yield interrupted
    finally:
        signal.signal(signal.SIGINT, before)


def _run_epoch(trainer, seed: int, epoch: int) -> dict:
    """One pass over the training samples, in an order that depends only on seed and epoch.

    Epoch 0 only measures the loss at the start.
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
