"""Whether results are still what was written: data sets, runs, exported networks, pictures."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from lf_flame._common.output_folders import verify_outputs
from lf_flame.errors import InputError

RECORDS = (
    "refocus.json",
    "simulation.json",
    "prediction.json",
    "abel.json",
    "profiles.json",
    "reconstruct.json",
    "temperature.json",
    "flicker.json",
)
"""Records of folders of pictures; a folder may hold those of several commands."""

WHOLE = ("zarr.json", "config.json")
"""Files of data sets and of runs, in which no other result lies."""


@dataclass(frozen=True)
class Finding:
    """What was found at a place.

    Attributes
    ----------
    path : Path
    text : str
        What is there; or, if `sound` is false, what is wrong.
    sound : bool
    """

    path: Path
    text: str
    sound: bool = True


def verify(path: Path) -> Iterator[Finding]:
    """Compute the hashes of all results at a path again.

    Parameters
    ----------
    path : Path
        A data set, a run folder, an exported network, a folder of pictures, or a folder that holds
        such.

    Yields
    ------
    Finding

    Raises
    ------
    InputError
        If there is no result.
    """
    found = False
    for place, known in _results(path):
        found = True
        try:
            yield Finding(place, _verify_one(place, known))
        except InputError as error:
            yield Finding(place, str(error), sound=False)
    if not found:
        raise InputError(
            f"{path} holds nothing whose hash is known: no data set, run folder, exported network, "
            f"nor files of refocus, simulate, reconstruct, temperature, flicker or predict."
        )


def _results(path: Path) -> Iterator[tuple[Path, str]]:
    """Find results, and the name of the file by which each is known: at a path, and below it."""
    if path.suffix == ".keras":
        yield path, path.name
    if not path.is_dir():
        return
    for known in (*WHOLE, *RECORDS):
        if (path / known).is_file() and (known != "config.json" or _holds_training(path)):
            yield path, known
            if known in WHOLE:
                return
    for inside in sorted(path.iterdir()):
        exported = inside.suffix == ".keras" and inside.with_suffix(".json").is_file()
        if exported or (inside.is_dir() and not inside.is_symlink()):
            yield from _results(inside)


def _holds_training(folder: Path) -> bool:
    """Whether a folder with a ``config.json``, as many programs have, is that of a run."""
    return (folder / "model.keras").exists() or any(folder.glob("checkpoint-??????"))


def _verify_one(path: Path, known: str) -> str:
    if known in RECORDS:
        return f"{verify_outputs(path, known)} files, as {known} says"
    if known in WHOLE:
        return _verify_dataset(path) if known == "zarr.json" else _verify_run(path)
    from lf_flame.learning.model_card import read_card

    read_card(path)
    return "exported network, as its card says"


def _verify_dataset(path: Path) -> str:
    from lf_flame.datasets.store import Dataset

    dataset = Dataset(path)
    return f"data set of {len(dataset)} samples: {', '.join(dataset.verify())}"


def _verify_run(folder: Path) -> str:
    from lf_flame.learning.checkpoints import find_checkpoints, verify_checkpoint
    from lf_flame.learning.run_folders import load_run

    for checkpoint in find_checkpoints(folder):
        verify_checkpoint(checkpoint)
    if not (folder / "model.keras").exists():
        return "run that is not finished: its checkpoint"
    load_run(folder)
    return "trained network and its checkpoint"
