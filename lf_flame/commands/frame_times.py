"""Times of the frames of a video: from the numbers in their names, or from a file."""

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np

from lf_flame._common.input_files import check_regular, readable
from lf_flame.errors import InputError
from lf_flame.flame_video.flicker import check_times
from lf_flame.formats.view_files.names import Parts, split_numbers

EVEN = 0.05
"""Largest deviation of decimal numbers of frames from whole steps, in steps."""

LARGEST_FILE = 1 << 26
"""Largest size of a file of times, in bytes: some millions of frames."""

SLOW_STEP_S = 0.5
"""Interval in s above which the unit is doubted: flames flicker at a few to a few tens of Hz."""

TIME_COLUMN = "time_s"
"""Title of the column of times, needed if there are several columns."""

STATE = "state them by --timestamps FILE"


@dataclass(frozen=True, eq=False)
class FrameTimes:
    """Times of frames, with notes for the user.

    Attributes
    ----------
    seconds : ndarray of float64, shape (frames,)
        Times in s, rising.
    notes : tuple of str
        Notes on how the times were found, one sentence each.
    """

    seconds: np.ndarray
    notes: tuple[str, ...] = ()


def number_key(paths: Sequence[Path]) -> list[Parts]:
    """Give sort keys that order paths by number: frame 2 before frame 10, and -2 before -1."""
    return split_numbers(
        [str(path) if path.is_dir() else str(path.with_suffix("")) for path in paths]
    )


def times_by_names(paths: Sequence[Path], frames_per_second: float) -> FrameTimes:
    """Find times by the numbers in the names of frames; a missing number is a gap in time.

    Parameters
    ----------
    paths : sequence of Path
        Paths in the order of their numbers.
    frames_per_second : float
        Number of frames a second; the numbers in the names count frames.

    Returns
    -------
    FrameTimes
        Times; evenly spaced, with a note, unless exactly one number differs from name to name.

    Raises
    ------
    InputError
        If two frames have the same number, or decimals are no multiples of one step.
    """
    numbers = _frame_numbers(number_key(paths))
    if numbers is None:
        note = (
            f"The names of the frames do not hold one number that counts them: they are taken for "
            f"evenly spaced, without gaps; if their times are others, {STATE}."
        )
        return FrameTimes(np.arange(len(paths)) / frames_per_second, (note,))
    for k in range(1, len(paths)):
        if numbers[k] == numbers[k - 1]:
            raise InputError(
                f"{paths[k - 1]} and {paths[k]} have the same number, and one time cannot have two "
                f"frames."
            )
    counts, notes = _counts(numbers, frames_per_second)
    return FrameTimes(counts / frames_per_second, tuple(notes))


def with_gaps(
    paths: Sequence[Path], times: FrameTimes, frames_per_second: float
) -> tuple[list[Path | None], np.ndarray]:
    """Give missing frames times of their own, None in place of a path.

    If more are missing than there, as with numbers that are dates, gaps stay without frames.
    """
    counts = np.round(times.seconds * frames_per_second).astype(int)
    counts //= max(1, int(np.gcd.reduce(np.diff(counts)))) if len(counts) > 1 else 1
    if counts[-1] + 1 > 2 * len(counts):
        return list(paths), times.seconds
    rows: list[Path | None] = [None] * (counts[-1] + 1)
    for path, count in zip(paths, counts, strict=True):
        rows[count] = path
    return rows, np.interp(np.arange(len(rows)), counts, times.seconds)


def _frame_numbers(names: list[Parts]) -> list[Decimal] | None:
    """Find the only number that differs from name to name; None if there is no such."""
    if len({name[::2] for name in names}) > 1:
        return None
    differing = [
        list(numbers)
        for numbers in zip(*(name[1::2] for name in names), strict=True)
        if len(set(numbers)) > 1
    ]
    return differing[0] if len(differing) == 1 else None  # type: ignore[return-value]


def _counts(numbers: list[Decimal], frames_per_second: float) -> tuple[np.ndarray, list[str]]:
    """Turn numbers into counts of frames, from 0; with notes."""
    offsets = [number - numbers[0] for number in numbers]
    steps = [after - before for before, after in zip(offsets, offsets[1:], strict=False)]
    notes = []
    if all(number == number.to_integral_value() for number in numbers):
        counts, common = np.array(offsets, float), math.gcd(*(int(step) for step in steps))
        if common > 1:
            notes.append(
                f"The numbers in the names of the frames rise by {common} or multiples of it, and "
                f"are taken for counts of 1 / {frames_per_second:g} s; if their times are others, "
                f"{STATE}."
            )
    else:
        common, step = 1, min(steps)
        exact = np.array([offset / step for offset in offsets], float)
        counts = exact.round()
        if np.abs(exact - counts).max() > EVEN:
            raise InputError(
                f"The decimals in the names of the frames are no multiples of one step, and do not "
                f"say of what they are: if of seconds, {STATE}."
            )
        if abs(float(step) * frames_per_second - 1) > 0.01:
            notes.append(
                f"The numbers in the names of the frames rise by {step} or multiples of it, which "
                f"is taken for one frame, 1 / {frames_per_second:g} s; if their times are others, "
                f"{STATE}."
            )
    missing = round(counts[-1] / common) + 1 - len(counts)
    if missing:
        notes.append(
            f"By the numbers in the names of the frames, {missing} are missing between the first "
            f"and the last; their time is left free."
        )
    return counts, notes


def read_timestamps(path: Path, frames: int) -> FrameTimes:
    """Read the time of each frame.

    Parameters
    ----------
    path : Path
        Text file with a time in s on each line; or a CSV table with the times in its only column,
        or in the column titled `TIME_COLUMN`.
    frames : int
        Number of frames.

    Raises
    ------
    InputError
        If the file cannot be read, holds something else, or does not hold `frames` rising times.
    """
    if check_regular(path) > LARGEST_FILE:
        raise InputError(f"{path} is too large for a file of times, {LARGEST_FILE} bytes at most.")
    with (
        readable(path, (OSError, UnicodeDecodeError, csv.Error)),
        path.open(newline="", encoding="utf-8-sig") as file,
    ):
        rows = [row for row in csv.reader(file) if any(word.strip() for word in row)]
    words = _column_of_times(path, rows)
    try:
        seconds = np.array([float(word) for word in words])
    except ValueError as error:
        raise InputError(f"{path} must hold a time in s on each line: {error}.") from None
    if len(seconds) != frames:
        raise InputError(
            f"{path} must hold a time for each of the {frames} frames, got {len(seconds)}."
        )
    check_times(seconds, f"in {path}")
    slowest = float(np.median(np.diff(seconds))) if frames > 1 else 0.0
    if slowest > SLOW_STEP_S:
        note = (
            f"The times in {path} are taken for seconds, so that {slowest:g} s pass between "
            f"frames; if they are in another unit, all frequencies are wrong by it."
        )
        return FrameTimes(seconds, (note,))
    return FrameTimes(seconds)


def _column_of_times(path: Path, rows: list[list[str]]) -> list[str]:
    """Find the cells of the column of times."""
    header = [word.strip() for word in rows[0]] if rows else []
    if TIME_COLUMN in header:
        place, rows = header.index(TIME_COLUMN), rows[1:]
        return [row[place] if place < len(row) else "" for row in rows]
    if any(len(row) != 1 for row in rows):
        raise InputError(
            f"{path} must hold one column of times in s, or a table with a column titled "
            f"{TIME_COLUMN}."
        )
    words = [row[0].strip() for row in rows]
    is_title = words and not any(letter.isdigit() for letter in words[0])
    return words[1:] if is_title else words
