"""Check that results are still as written: data sets, runs, networks, pictures, tables."""

import errno
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lf_flame._common.checksums import check_seal
from lf_flame._common.input_files import read_record
from lf_flame._common.memory import OverLimitError
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
    "calibration.json",
    "calibrate-colours.json",
)
"""Names of records of folders of pictures; a folder may hold those of several commands."""

WHOLE = ("zarr.json", "config.json")
"""Files that mark a data set or a run; no other results lie inside such a folder."""


WHOLE_RESULT, DAMAGED, UNCHECKED = "whole", "DAMAGED", "UNCHECKED"
"""Verdicts; an UNCHECKED result may be sound, but could not be read here and now."""


@dataclass(frozen=True)
class Finding:
    """Verdict on one result.

    Attributes
    ----------
    path : Path
    text : str
        Description of the result; or, if it is not whole, what is wrong.
    verdict : {"whole", "DAMAGED", "UNCHECKED"}
    """

    path: Path
    text: str
    verdict: str = WHOLE_RESULT


def verify(path: Path) -> Iterator[Finding]:
    """Compute the hashes of all results at a path again.

    Parameters
    ----------
    path : Path
        Data set, run folder, exported network, folder of pictures, or a folder that holds such.

    Yields
    ------
    Finding
        One for each result, and for each place that cannot be read; the others are still checked.
    """
    found = False
    for place, known in _results(path):
        found = True
        yield _unreadable(place, known) if isinstance(known, OSError) else _find(place, known)
    if not found:
        yield Finding(path, _nothing(path), UNCHECKED)


def verify_here(folder: Path) -> list[Finding]:
    """Compute the hashes of the results that lie directly in a folder, and not below it."""
    return [_find(folder, known) for known in _look(folder)[0]]


def _nothing(path: Path) -> str:
    if not path.exists():
        return "there is nothing of that name; name a file or folder that a command has written."
    return (
        "it holds nothing whose hash is known: no data set, run folder, exported network, nor "
        "files of refocus, simulate, reconstruct, temperature, flicker, calibrate or predict, nor "
        "tables with their record."
    )


def _find(place: Path, known: str) -> Finding:
    try:
        return Finding(place, _verify_one(place, known))
    except OverLimitError as error:
        return Finding(place, str(error), UNCHECKED)
    except InputError as error:
        return Finding(place, str(error), DAMAGED)
    except OSError as error:
        return _unreadable(place, error)
    except (MemoryError, ModuleNotFoundError) as error:
        return Finding(place, f"there is not enough memory, or a package ({error})", UNCHECKED)


def _unreadable(place: Path, error: OSError) -> Finding:
    text = f"it cannot be looked at: {error.strerror or error} ({error.filename or place})"
    return Finding(place, text, UNCHECKED)


def _results(path: Path) -> Iterator[tuple[Path, str | OSError]]:
    """Find results at a path and below it, each with the name of the file that marks it.

    Where a place cannot be read, the second item is the system's error.
    """
    left = [path]
    while left:
        place = left.pop()
        try:
            found, inside = _look(place)
        except OSError as error:
            yield place, error
            continue
        yield from ((place, known) for known in found)
        left += reversed(inside)


def _look(path: Path) -> tuple[list[str], list[Path]]:
    """Find the results at a place, and the places inside it to search for others."""
    found = [path.name] if path.suffix == ".keras" and path.exists() else []
    if not path.is_dir():
        return found, []
    for known in (*WHOLE, *RECORDS):
        if (path / known).is_file() and (known != "config.json" or _holds_training(path)):
            found.append(known)
            if known in WHOLE:
                return found, []
    found += [one.name for one in sorted(path.glob("*.json")) if _is_of_table(one)]
    return found, [inside for inside in sorted(path.iterdir()) if _may_hold(inside)]


def _is_of_table(record: Path) -> bool:
    """Whether a file is the record of a table, with its hashes, or damaged where one would be."""
    if not all(record.with_suffix(ending).is_file() for ending in (".csv", ".md")):
        return False
    try:
        return isinstance(read_record(record).get("sha256"), dict)
    except (InputError, OSError):
        return True


def _may_hold(inside: Path) -> bool:
    exported = inside.suffix == ".keras" and inside.with_suffix(".json").is_file()
    return exported or (inside.is_dir() and not inside.is_symlink())


def _holds_training(folder: Path) -> bool:
    """Whether a folder with a ``config.json``, common among programs, is that of a run."""
    return (folder / "model.keras").exists() or any(folder.glob("checkpoint-??????"))


def _verify_one(path: Path, known: str) -> str:
    marks = path / known if path.is_dir() else path
    if not os.access(marks, os.R_OK):  # a record that may not be read can be sound
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(marks))
    if known.endswith(".json") and known not in WHOLE:
        return f"{verify_outputs(path, known)} files, as {known} says"
    if known in WHOLE:
        return _verify_dataset(path) if known == "zarr.json" else _verify_run(path)
    from lf_flame.learning.model_card import read_card

    read_card(path)
    check_seal(path / "run.json" if path.is_dir() else path.with_suffix(".json"))
    return "exported network, as its card says"


def _verify_dataset(path: Path) -> str:
    from lf_flame.datasets.store import Dataset

    attributes = read_record(path / "zarr.json").get("attributes")
    if isinstance(attributes, dict) and "kind" in attributes:
        from lf_flame.flame_video.processing.result import verify_video

        return f"processed video of {verify_video(path).describe()}"
    dataset = Dataset(path)
    return f"data set of {len(dataset)} samples: {', '.join(dataset.verify())}"


def _verify_run(folder: Path) -> str:
    from lf_flame.learning.checkpoints import find_checkpoints, verify_checkpoint, verify_history
    from lf_flame.learning.run_folders import load_run

    request = read_record(folder / "config.json")
    for checkpoint in find_checkpoints(folder):
        _compare(request, verify_checkpoint(checkpoint).run, folder)
        verify_history(checkpoint)
    if not (folder / "model.keras").exists():
        return "run that is not finished: its checkpoint"
    record = load_run(folder)
    check_seal(folder / "run.json")
    _compare(record, request, folder)
    return "trained network and its checkpoint"


def _compare(values: dict[str, Any], part: dict[str, Any], folder: Path) -> None:
    """Compare a request with its copy in another record; only epochs may have increased."""
    for key, value in part.items():
        held = values.get(key)
        if key == "recipe" and isinstance(held, dict) and isinstance(value, dict):
            held, value = ({**recipe, "epochs": None} for recipe in (held, value))
        if held != value:
            raise InputError(
                f"{folder / 'config.json'} is not what was written: its {key} is another than in "
                f"the records beside it."
            )
    if not part:
        raise InputError(f"{folder / 'config.json'} is empty, and is not what was written.")
