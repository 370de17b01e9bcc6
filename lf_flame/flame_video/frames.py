"""Frames of a video: their order, times and reading, and the flicker of the flame in them."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np

from lf_flame._common import figures
from lf_flame._common.arrays_in_files import ArrayFile
from lf_flame._common.atomic_files import OutputFolder
from lf_flame._common.images import TIFF_SUFFIXES
from lf_flame.errors import InputError
from lf_flame.flame_video import processing
from lf_flame.flame_video.flame_shape import DOUBTS, row_error
from lf_flame.flame_video.flicker import Flicker, find_flicker
from lf_flame.formats.arrays import ARRAY_SUFFIXES
from lf_flame.formats.images import IMAGE_SUFFIXES, LYTRO_SUFFIXES, is_stack
from lf_flame.formats.reading import Found, find_light_field
from lf_flame.formats.view_files.folder import split_numbers
from lf_flame.lightfield import LightField

RECORD = "flicker.json"
MEASURES = ("height", "tip_row", "width", "area", "brightness")
RESULTS = ("frequency_hz", "peak_hz", "amplitude", "false_alarm", "resolution_hz", "resolvable")


def find_frames(sources: Sequence[Path], not_frames: Sequence[Path | None] = ()) -> list[Path]:
    """Find the frames of a sequence, in the order of the numbers in their names.

    `sources` are the frames, or one folder that contains them, as files or as folders of views;
    `not_frames` are white and dark image: left out in a folder, and refused by name.
    """
    found, others = list(sources), {path.resolve() for path in not_frames if path}
    if len(found) == 1 and found[0].is_dir():
        found = _frames_of_folder(found[0], others)
    if wrong := [path for path in found if path.resolve() in others]:
        raise InputError(f"{wrong[0]} is the white or the dark image, and cannot be a frame too.")
    if missing := [path for path in found if not path.exists()]:
        raise InputError(f"There is no frame {missing[0]}: no such file or folder.")
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
    counted = ", ".join(f"{len(paths)} x {kind}" for kind, paths in sorted(kinds.items()))
    raise InputError(
        f"{folder} must contain frames of one kind, images ({', '.join(IMAGE_SUFFIXES)}), arrays "
        f"({', '.join(ARRAY_SUFFIXES)}) or folders of views, got {counted or 'none'}."
    )


def find_times(
    paths: Sequence[Path], frames_per_second: float = 1.0
) -> tuple[list[Path | None], np.ndarray, list[str]]:
    """Find the times of frames in s by their names: the frames, their times, and notes.

    The one number that differs between names counts the frames: a missing one is a frame None.
    """
    counts, notes = _counts(paths), []
    if counts is None:
        counts = np.arange(len(paths))
        notes.append(
            "The names of the frames do not contain one number that counts them with at most half "
            "of the frames missing: they are assumed to be evenly spaced, without gaps."
        )
    rows: list[Path | None] = [None] * (counts[-1] + 1)
    for path, count in zip(paths, counts, strict=True):
        rows[count] = path
    if missing := rows.count(None):
        notes.append(
            f"According to the numbers in the names, {missing} of the frames between the first "
            f"and the last are missing; they stay gaps in time."
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
    if len(differing) != 1:
        return None
    # Digits behind a point count as well (``run3.0001``).
    first, digits = differing[0][0], max(-int(x.as_tuple().exponent) for x in differing[0])
    counts = np.array([int((number - first) * 10**digits) for number in differing[0]], object)
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
        """Options, with names, sizes and times of change of the files that they name, as text."""
        files = [value for value in self.options.values() if isinstance(value, Path)]
        found = [path.stat() for path in files if path.is_file()]
        given = {name: x.name if isinstance(x, Path) else x for name, x in self.options.items()}
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
    def order(self) -> str:
        """Order in which the views of `model` are stored."""
        return str(self._found.order)

    @property
    def coded(self) -> str:
        """Note that `model` is probably gamma-coded, if it is."""
        return self._found.coded

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
    """Whether a file contains one picture: an image, or an array of rows, columns and colours."""
    suffix = path.suffix.lower()
    if suffix == ".npy":
        return len(ArrayFile(path).header("").shape) < 4
    return suffix in IMAGE_SUFFIXES and not (suffix in TIFF_SUFFIXES and is_stack(path))


def write_flicker(
    video: Path, folder: OutputFolder, *, frames_per_second: float | None = None
) -> tuple[str, list[str]]:
    """Find the flicker in a video that was processed with the step ``height``.

    Writes the table, the figure and the facts of the record; returns a sentence on the flicker,
    empty if too few frames have a height, and warnings, each with the number of its frames.
    """
    done = processing.open_video(video)
    names = (*MEASURES, "state", "doubts", "time")
    if not {*names} <= {*done.names}:
        raise InputError(f"{video} contains no heights: process it with the step height.")
    if processing.count_frames(done).counts["to_do"]:  # refuses lost files, too
        raise InputError(f"{video} is not finished: repeat the command that makes it.")
    *columns, state, bits, times = done.read(names)
    counted = done.arrays["time"].attrs.get("units") != "s"
    if counted != (frames_per_second is not None):
        said = "counts frames: state" if counted else "contains the times of its frames: leave out"
        raise InputError(f"{video} {said} --frames-per-second.")
    times, heights = times / (frames_per_second or 1.0), columns[0]
    paths, options = done.attributes["frames"], dict[str, Any](done.arrays["height"].attrs)
    sources = [name or f"frame {number}" for number, name in enumerate(paths)]
    pixel_mm, level = options.get("pixel_mm"), options["level"]
    unit = "px" if pixel_mm is None else "mm"
    doubts = [[x for k, x in enumerate(DOUBTS.values()) if bit >> k & 1] for bit in bits]
    for lost in np.flatnonzero(state == processing.UNUSABLE):
        doubts[lost].append("The frame is unusable.")
    doubtful: dict[str, list[str]] = {}
    for source, some in zip(sources, doubts, strict=True):
        for doubt in some:
            doubtful.setdefault(doubt, []).append(source)
    warnings = [f"{len(x)} of {len(bits)} frames, first {x[0]}: {y}" for y, x in doubtful.items()]
    found = None
    try:
        found = find_flicker(times, heights, resolvable=row_error(level) * (pixel_mm or 1.0))
    except InputError as error:  # the heights are useful without a frequency
        warnings.append(str(error))
    with folder.path("flame.csv").open("w", newline="", encoding="utf-8", errors="replace") as file:
        writer = csv.writer(file)
        lengths = f"height_{unit}", "tip_row", f"width_{unit}", f"area_{unit}2"
        writer.writerow(["frame", "time_s", *lengths, "brightness", "source", "warnings"])
        for number, row in enumerate(np.column_stack(columns)):
            numbers = f"{times[number]:.15g}", *(f"{x:.7g}" for x in row)
            writer.writerow([number, *numbers, sources[number], " ".join(doubts[number])])
    figures.save(_flicker_figure(times, heights, found, unit), folder.path("flicker.png"))
    known = heights[np.isfinite(heights)]
    folder.facts |= {
        "frames": len(heights),
        "frames_with_flame": len(known),
        "level": level,
        "pixel_mm": pixel_mm,
        "unit": unit,
        "mean_height": float(known.mean()) if len(known) else None,
        "standard_deviation_of_height": float(known.std()) if len(known) else None,
        "flicker": found and {name: getattr(found, name) for name in RESULTS},
        "warnings": warnings,
    }
    return found.describe(unit=unit) if found else "", warnings


def _flicker_figure(times: np.ndarray, heights: np.ndarray, found: Flicker | None, unit: str):
    """Height against time, and its spectrum with the level of a false alarm."""
    figure, (top, below) = figures.subplots(2, 1, figsize=(9, 6.5), layout="constrained")
    top.plot(times, heights, "." * (len(heights) < 300) + "-", linewidth=0.8, markersize=4)
    top.set(xlabel="time (s)", ylabel=f"height ({unit})")
    below.set(xlabel="frequency (Hz)", ylabel="share of the scatter", title="too few heights")
    if found is not None:
        below.plot(found.frequencies_hz, found.power, linewidth=0.9)
        below.axhline(found.level, color="C7", linestyle=":", label="1 % false-alarm level")
        below.legend(fontsize=8)
        below.set_title(fill(found.describe(unit=unit), 100), fontsize=9)
    return figure
