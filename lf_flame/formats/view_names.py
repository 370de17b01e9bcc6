"""Finding the views of a light field among the files of a folder, by their numbers."""

import re
from collections import defaultdict
from math import isqrt
from pathlib import Path

import numpy as np

from lf_flame.errors import InputError
from lf_flame.formats.images import IMAGE_SUFFIXES

MOST_NAMED = 3
"""Missing views that an error names."""


def view_files(folder: Path) -> list[Path]:
    """Find the images of a folder that are named alike but for their numbers, the most numerous.

    Raises
    ------
    InputError
        If there is no such folder, no two such images, or another set half as large or more.
    """
    if not folder.is_dir():
        raise InputError(f"The views cannot be read: {folder} is no folder.")
    sets = defaultdict(list)
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith("."):
            like = re.sub(r"[-+]?\d+(\.\d+)?", "#", path.stem) + path.suffix.lower()
            if "#" in like:
                sets[like].append(path)
    by_size = sorted(sets.items(), key=lambda item: len(item[1]), reverse=True)
    if not by_size or len(by_size[0][1]) < 2:
        raise InputError(
            f"{folder} holds no two images ({', '.join(IMAGE_SUFFIXES)}) whose names differ in "
            f"numbers only."
        )
    if len(by_size) > 1 and 2 * len(by_size[1][1]) >= len(by_size[0][1]):
        found = " and ".join(f"{len(files)} of {like}" for like, files in by_size[:2])
        raise InputError(
            f"{folder} holds more than one set of images, {found}: leave only the views there."
        )
    return by_size[0][1]


def number_grid(files: list[Path]) -> np.ndarray:
    """Arrange files by their numbers.

    Two neighbouring numbers that make a full grid count rows and columns, the first such pair: they
    may start anywhere and rise by any one step; a constant number counts only where it is 0 or 1
    and written as wide as its partner. Otherwise one running number counts along a square.

    Parameters
    ----------
    files : list of Path
        As `view_files` finds them.

    Returns
    -------
    ndarray of Path, shape (first number, second number)

    Raises
    ------
    InputError
        If a view is missing, or the numbers make no grid.
    """
    words = [re.findall(r"\d+", path.stem) for path in files]
    shared = min(map(len, words))
    numbers = np.array([[int(word[-18:]) for word in one[:shared]] for one in words])  # as int64
    widths = np.array([[len(word) for word in one[:shared]] for one in words]).min(axis=0)
    pair = _pair(numbers, widths)
    if pair is not None:
        return _full_grid(files, numbers[:, pair], widths[pair])
    for k in range(shared):
        if len(np.unique(numbers[:, k])) == len(files):
            return _square(files, numbers[:, k], widths[k])
    raise InputError(
        f"The {len(files)} images like {files[0]} do not number a grid: each needs a row and a "
        f"column, or a running number, of its own."
    )


def _pair(numbers: np.ndarray, widths: np.ndarray) -> slice | None:
    """Find the neighbouring columns of numbers that make the fullest grid, the first of them."""
    found = {}
    for k in range(numbers.shape[1] - 1):
        pair = slice(k, k + 2)
        values = numbers[:, pair]
        counts = [len(np.unique(values[:, axis])) for axis in (0, 1)]
        constant = counts.index(1) if 1 in counts else None
        one_row = constant is None or (values[0, constant] in (0, 1) and widths[k] == widths[k + 1])
        # Less than half a grid is no grid with gaps, but numbers that count something else.
        full_enough = counts[0] * counts[1] <= 2 * len(numbers)
        if one_row and full_enough and len(np.unique(values, axis=0)) == len(numbers):
            found[k] = counts[0] * counts[1]
    first = min(found, key=found.__getitem__, default=None)
    return None if first is None else slice(first, first + 2)


def _full_grid(files: list[Path], numbers: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """Put the files in their places and refuse a grid with gaps."""
    rows, columns = (_evenly(numbers[:, axis]) for axis in (0, 1))
    placed = {tuple(pair): path for pair, path in zip(numbers.tolist(), files, strict=True)}
    wanted = [(row, column) for row in rows for column in columns]
    _refuse_missing(
        [f"{r:0{widths[0]}}_{c:0{widths[1]}}" for r, c in wanted if (r, c) not in placed],
        files,
        f"{len(rows)} x {len(columns)} views",
    )
    return _as_grid([placed[pair] for pair in wanted], (len(rows), len(columns)))


def _square(files: list[Path], numbers: np.ndarray, width: int) -> np.ndarray:
    """Put files with one running number in a square, in its order."""
    side = isqrt(len(files))
    placed = dict(sorted(zip(numbers.tolist(), files, strict=True)))
    if side**2 != len(files):
        gaps = [f"{n:0{width}}" for n in _evenly(numbers) if n not in placed]
        _refuse_missing(gaps, files, f"{len(files)} views")
        raise InputError(
            f"The {len(files)} images like {files[0]}, with one running number, make no square "
            f"grid: {side**2} or {(side + 1) ** 2} would."
        )
    return _as_grid(list(placed.values()), (side, side))


def _evenly(numbers: np.ndarray) -> list[int]:
    """All numbers from the lowest to the highest, in the step that they have in common."""
    values = np.unique(numbers).tolist()
    step = int(np.gcd.reduce(np.diff(values))) or 1
    steps = range(values[0], values[-1] + 1, step)
    # Wide gaps are no missing views, but another way of counting, by positions or times.
    return list(steps) if len(steps) <= 2 * len(values) else values


def _refuse_missing(missing: list[str], files: list[Path], what: str) -> None:
    if missing:
        named = ", ".join(missing[:MOST_NAMED])
        more = f" and {len(missing) - MOST_NAMED} more" if len(missing) > MOST_NAMED else ""
        are = "view {} is" if len(missing) == 1 else "views {} are"
        raise InputError(f"Of {what} like {files[0]}, {are.format(named + more)} missing.")


def _as_grid(files: list[Path], shape: tuple[int, int]) -> np.ndarray:
    grid = np.empty(len(files), object)
    grid[:] = files
    return grid.reshape(shape)
