"""Frames of a video: their files in order, their times, and reading them one at a time."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from lf_flame._common.arrays_in_files import open_arrays
from lf_flame._common.images import TIFF_SUFFIXES
from lf_flame.errors import InputError
from lf_flame.formats.arrays import ARRAY_SUFFIXES
from lf_flame.formats.coding import note_on_coding
from lf_flame.formats.images import IMAGE_SUFFIXES, LYTRO_SUFFIXES
from lf_flame.formats.reading import Found, find_light_field
from lf_flame.formats.stacks import is_stack
from lf_flame.formats.view_files.folder import split_numbers
from lf_flame.lightfield import LightField


def find_frames(sources: Sequence[Path], not_frames: Sequence[Path] = ()) -> list[Path]:
    """Find the frames of a sequence, in the order of the numbers in their names.

    `sources` are the frames, or one folder that holds them, as files or as folders of views;
    `not_frames` are other files in that folder, such as a white image.
    """
    found = list(sources)
    if len(found) == 1 and found[0].is_dir():
        found = _frames_of_folder(found[0], {path.resolve() for path in not_frames})
    missing = [path for path in found if not path.exists()]
    if missing:
        raise InputError(f"There is no frame {missing[0]}: no such file or folder.")
    twice = [path for path, count in Counter(found).items() if count > 1]
    if twice:
        raise InputError(f"Each frame may be given once, got {twice[0]} more than once.")
    keys = dict(zip(found, _numbered_names(found), strict=True))
    return sorted(found, key=keys.__getitem__)


def _numbered_names(paths: Sequence[Path]):
    """Split names into texts and numbers in turn: frame 2 before frame 10, and -2 before -1."""
    return split_numbers([str(x) if x.is_dir() else str(x.with_suffix("")) for x in paths])


def _frames_of_folder(folder: Path, not_frames: set[Path]) -> list[Path]:
    kinds: dict[str, list[Path]] = {}
    for path in folder.iterdir():
        kind = "folder" if path.is_dir() else path.suffix.lower()
        known = kind in ("folder", *ARRAY_SUFFIXES, *IMAGE_SUFFIXES, *LYTRO_SUFFIXES)
        if known and not path.name.startswith(".") and path.resolve() not in not_frames:
            kinds.setdefault(kind, []).append(path)
    if len(kinds) == 1:
        return next(iter(kinds.values()))
    if not kinds:
        raise InputError(
            f"{folder} holds no frames: neither images ({', '.join(IMAGE_SUFFIXES)}), nor arrays "
            f"({', '.join(ARRAY_SUFFIXES)}), nor folders of views."
        )
    counted = ", ".join(f"{len(paths)} x {kind}" for kind, paths in sorted(kinds.items()))
    raise InputError(f"{folder} holds frames of several kinds ({counted}): name those meant.")


def find_times(
    paths: Sequence[Path], frames_per_second: float = 1.0
) -> tuple[list[Path | None], np.ndarray, list[str]]:
    """Find the times of frames in s by their names: the frames, their times, and notes.

    The one number that differs from name to name counts them: a missing one is a frame None.
    """
    counts, notes = _counts(paths), []
    if counts is None:
        counts = np.arange(len(paths))
        notes.append(
            "The names of the frames do not hold one number that counts them: they are taken for "
            "evenly spaced, without gaps."
        )
    rows: list[Path | None] = [None] * (counts[-1] + 1)
    for path, count in zip(paths, counts, strict=True):
        rows[count] = path
    if missing := rows.count(None):
        notes.append(
            f"By the numbers in the names of the frames, {missing} are missing between the first "
            f"and the last; their time is left free."
        )
    return rows, np.arange(len(rows)) / frames_per_second, notes


def _counts(paths: Sequence[Path]) -> np.ndarray | None:
    """Count frames from 0 by their names, unless most numbers are missing, as with dates."""
    names = _numbered_names(paths)
    if len(paths) == 1:
        return np.zeros(1, int)
    alike = len({name[::2] for name in names}) == 1
    columns = zip(*(name[1::2] for name in names), strict=True) if alike else ()
    differing = [column for column in columns if len(set(column)) > 1]
    if len(differing) != 1 or any(number % 1 for number in differing[0]):
        return None
    counts = np.array([int(number - differing[0][0]) for number in differing[0]], object)
    if min(np.diff(counts)) < 1 or counts[-1] + 1 > 2 * len(counts):
        return None
    return counts.astype(int)


@dataclass
class FrameReader:
    """Reader of frames, which can be sent to other processes; each reads the frame `model` first.

    `options` are those of `lf_flame.read_light_field`. Lenslets, or the order of views, are those
    that are found in `model`; a picture, or an array of one, is a light field of one view unless an
    option says otherwise.
    """

    model: Path
    options: dict[str, Any]

    @property
    def description(self) -> str:
        """Options, and size and time of change of the files that they name, as text."""
        files = [value for value in self.options.values() if isinstance(value, Path)]
        found = [path.stat() for path in files if path.is_file()]
        given = {name: str(x) if isinstance(x, Path) else x for name, x in self.options.items()}
        return f"{given} {[(one.st_size, one.st_mtime_ns) for one in found]}"

    @cached_property
    def _found(self) -> Found:
        stated = {"white", "lenslets", "pitch", "focused", "views", "mosaic", "axes", "grid"}
        plain = stated.isdisjoint(self.options) and _is_picture(self.model)
        return find_light_field(self.model, **self.options, **({"views": 1} if plain else {}))

    @property
    def notes(self) -> list[str]:
        """Sentences on the frame `model`."""
        v, u, t, s = self.shape[:4]
        kind = "Pictures" if v * u == 1 else f"Frames of {v} x {u} views"
        return [*self._found.notes, f"{kind} of {t} x {s} pixels"]

    @property
    def coded(self) -> list[str]:
        """Note that the frame `model` is probably gamma-coded, if it is."""
        return list(filter(None, [note_on_coding(self.model)]))

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the light field in `model`."""
        return self._found.light_field.shape

    def __call__(self, path: Path) -> LightField:
        """Read a frame."""
        return self._found.again(path)

    def __reduce__(self):
        return FrameReader, (self.model, self.options)


def _is_picture(path: Path) -> bool:
    """Whether a file holds one picture: an image, or an array of rows, columns and colours."""
    suffix = path.suffix.lower()
    if suffix == ".npy":
        with open_arrays(path) as file:
            return len(file.header("").shape) < 4
    return suffix in IMAGE_SUFFIXES and not (suffix in TIFF_SUFFIXES and is_stack(path))
