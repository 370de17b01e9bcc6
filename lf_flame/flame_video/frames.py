"""Frames of a video: their files in order, their times, and reading them one at a time."""

import glob
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from lf_flame._common.arrays_in_files import open_arrays
from lf_flame._common.images import TIFF_SUFFIXES
from lf_flame._common.input_files import read_text
from lf_flame.errors import InputError
from lf_flame.flame_video.flicker import check_times
from lf_flame.formats.arrays import ARRAY_SUFFIXES
from lf_flame.formats.images import IMAGE_SUFFIXES, LYTRO_SUFFIXES
from lf_flame.formats.reading import Found, find_light_field
from lf_flame.formats.stacks import is_stack
from lf_flame.formats.view_files.folder import ARCHIVE
from lf_flame.formats.view_files.names import split_numbers
from lf_flame.lightfield import LightField

STATE = "state them by --timestamps FILE"


def find_frames(sources: Sequence[Path], not_frames: Sequence[Path] = ()) -> list[Path]:
    """Find the frames of a sequence, in the order of the numbers in their names.

    Parameters
    ----------
    sources : sequence of Path
        Frames; or one folder that holds them, as files or as folders of views; or one pattern with
        ``*``, ``?`` or ``[]``.
    not_frames : sequence of Path, optional
        Other files in that folder, such as a white image and a dark image.
    """
    found = list(sources)
    if len(found) == 1 and found[0].is_dir():
        found = _frames_of_folder(found[0], {path.resolve() for path in not_frames})
    elif len(found) == 1 and not found[0].exists() and glob.has_magic(str(found[0])):
        # A pattern may be absolute, which `Path.glob` refuses.
        found = [Path(name) for name in glob.glob(str(found[0]))]  # noqa: PTH207
        if not found:
            raise InputError(f"No file is of the pattern {sources[0]}.")
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
        known = kind in ("folder", ARCHIVE, *ARRAY_SUFFIXES, *IMAGE_SUFFIXES, *LYTRO_SUFFIXES)
        if known and not path.name.startswith(".") and path.resolve() not in not_frames:
            kinds.setdefault(kind, []).append(path)
    if not kinds:
        raise InputError(
            f"{folder} holds no frames: neither images ({', '.join(IMAGE_SUFFIXES)}), nor arrays "
            f"({', '.join(ARRAY_SUFFIXES)}), nor folders of views."
        )
    if len(kinds) > 1:
        counted = ", ".join(f"{len(paths)} x {kind}" for kind, paths in sorted(kinds.items()))
        raise InputError(
            f"{folder} holds frames of several kinds ({counted}): name them by a pattern, as "
            f"'{folder}/*{min(kinds)}'."
        )
    return next(iter(kinds.values()))


def find_times(
    paths: Sequence[Path], frames_per_second: float | None, timestamps: Path | None
) -> tuple[np.ndarray, list[str]]:
    """Find the times of frames, rising, in s (in frames if neither is given), and notes on them."""
    if timestamps is None:
        return times_by_names(paths, frames_per_second or 1.0)
    if frames_per_second is not None:
        raise InputError("Say when the frames were taken: --frames-per-second or --timestamps.")
    return read_timestamps(timestamps, len(paths)), []


def times_by_names(paths: Sequence[Path], frames_per_second: float) -> tuple[np.ndarray, list[str]]:
    """Find times by the numbers in the names of frames; a missing number is a gap in time.

    Frames are evenly spaced, with a note, unless exactly one number differs from name to name.
    """
    names = _numbered_names(paths)
    alike = len({name[::2] for name in names}) == 1
    columns = zip(*(name[1::2] for name in names), strict=True) if alike else ()
    differing = [column for column in columns if len(set(column)) > 1]
    if len(differing) != 1:
        note = (
            f"The names of the frames do not hold one number that counts them: they are taken for "
            f"evenly spaced, without gaps; if their times are others, {STATE}."
        )
        return np.arange(len(paths)) / frames_per_second, [note] * (len(paths) > 1)
    counts = np.array([float(number) for number in differing[0]])
    steps = np.diff(counts)
    if not steps.all():
        number = int(np.argmin(steps))
        raise InputError(
            f"{paths[number]} and {paths[number + 1]} have the same number, and one time cannot "
            f"have two frames."
        )
    if np.any(counts % 1):
        raise InputError(f"The names of the frames hold decimals, which count nothing: {STATE}.")
    common = math.gcd(*steps.astype(int).tolist())
    missing = round((counts[-1] - counts[0]) / common) + 1 - len(counts)
    notes = []
    if common > 1:
        notes.append(
            f"The numbers in the names of the frames rise by {common} or multiples of it, and are "
            f"taken for counts of 1 / {frames_per_second:g} s; if their times are others, {STATE}."
        )
    if missing:
        notes.append(
            f"By the numbers in the names of the frames, {missing} are missing between the first "
            f"and the last; their time is left free."
        )
    return (counts - counts[0]) / frames_per_second, notes


def with_gaps(
    paths: Sequence[Path], times: np.ndarray, frames_per_second: float
) -> tuple[list[Path | None], np.ndarray]:
    """Give missing frames times of their own, None in place of a path.

    If more are missing than there, as with numbers that are dates, gaps stay without frames.
    """
    counts = np.round(times * frames_per_second).astype(int)
    counts //= max(1, int(np.gcd.reduce(np.diff(counts)))) if len(counts) > 1 else 1
    if counts[-1] + 1 > 2 * len(counts):
        return list(paths), times
    rows: list[Path | None] = [None] * (counts[-1] + 1)
    for path, count in zip(paths, counts, strict=True):
        rows[count] = path
    return rows, np.interp(np.arange(len(rows)), counts, times)


def read_timestamps(path: Path, frames: int) -> np.ndarray:
    """Read the time of each frame: a number in s on each line, or a column titled ``time_s``."""
    lines = [line for line in read_text(path, 1 << 26).splitlines() if line.strip()]
    rows = [[word.strip() for word in line.split(",")] for line in lines]
    place, header = 0, rows[0] if rows else []
    if "time_s" in header:
        place, rows = header.index("time_s"), rows[1:]
    elif any(len(row) != 1 for row in rows):
        raise InputError(
            f"{path} must hold one column of times in s, or a table with a column titled time_s."
        )
    elif header and not any(letter.isdigit() for letter in header[0]):
        rows = rows[1:]
    try:
        seconds = np.array([float(row[place] if place < len(row) else "") for row in rows])
    except ValueError as error:
        raise InputError(f"{path} must hold a time in s on each line: {error}.") from None
    if len(seconds) != frames:
        raise InputError(
            f"{path} must hold a time for each of the {frames} frames, got {len(seconds)}."
        )
    check_times(seconds, f"in {path}")
    return seconds


# Reading ------------------------------------------------------------------------------------------


@dataclass
class FrameReader:
    """Reader of frames, which can be sent to other processes; each reads the frame `model` first.

    `options` are those of `lf_flame.read_light_field`. Lenslets, or the order of views, are those
    that are found in `model`; a picture, or an array of one, is a light field of one view unless an
    option says otherwise. `notes` are sentences on `model`.
    """

    model: Path
    options: dict[str, Any]

    @classmethod
    def by_first_sound(cls, paths: Sequence[Path], options: dict[str, Any]) -> "FrameReader":
        """Make a reader with the first of some frames that can be read."""
        refusals = []
        for path in paths:
            reader = cls(path, options)
            try:
                v, u, t, s = reader.shape[:4]
            except InputError as error:
                refusals.append(error)
                continue
            kind = "Pictures" if v * u == 1 else f"Frames of {v} x {u} views"
            reader.notes.append(f"{kind} of {t} x {s} pixels")
            return reader
        raise refusals[0]

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
        return self._found.notes

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
