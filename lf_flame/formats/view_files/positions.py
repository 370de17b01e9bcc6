"""Positions of views that stand on no grid, as names or a list state them."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from lf_flame._common.input_files import File
from lf_flame.errors import InputError
from lf_flame.formats.view_files.names import (
    MOST_MISSING,
    Count,
    digits_of,
    evenly,
    fullest_pair,
    numbers_of,
    split_numbers,
)
from lf_flame.formats.view_files.orders import ORDERS, SNAKE, check_order
from lf_flame.formats.view_files.parallax_order import FoundOrder

Pair = tuple[Count, Count]
"""Two numbers of a view: its row and column, or its place."""


def pairs_off_grid(files: list[File]) -> list[Pair] | None:
    """Find two neighbouring numbers in all names that are places on no grid.

    They hold decimals, and no two numbers of the names count rows and columns.
    """
    numbers = numbers_of(split_numbers([file.stem for file in files]))
    grids = [grid for one in (numbers, digits_of(files)) if (grid := fullest_pair(one, None))]
    # Digits about a point may seem to number a grid, of which many views are missing.
    grids = [grid for grid in grids if len(files) >= (1 - MOST_MISSING) * grid[1]]
    if grids and not off_grid(min(grids, key=lambda grid: grid[1])[0]):
        return None
    for k in range(len(numbers[0]) - 1):
        pairs = [(one[k], one[k + 1]) for one in numbers]
        if len(set(pairs)) == len(pairs) and off_grid(pairs):
            return pairs
    return None


def off_grid(pairs: Sequence[Pair]) -> bool:
    """Whether pairs of numbers with decimals are places that fill no grid of equal steps."""
    axes = list(zip(*pairs, strict=True))
    if not any("." in count.text for axis in axes for count in axis):
        return False
    runs = [evenly(axis) for axis in axes]
    steps = [np.diff([float(count.value) for count in run]) for run in runs]
    even = all(np.ptp(one) <= 1e-9 * np.abs(one).max() for one in steps if len(one))
    return not even or len(runs[0]) * len(runs[1]) > 2 * len(pairs)


def place_views(pairs: Sequence[Pair], order: str | None) -> tuple[np.ndarray, FoundOrder]:
    """Place views by their numbers.

    Parameters
    ----------
    pairs : sequence of (Count, Count)
    order : str, optional
        Meaning of the two numbers; a minus turns an axis. Default: ``row,col``, down and right.

    Returns
    -------
    ndarray of float64, shape (v, 1, 2)
        Places down and right, in steps: the usual distance of a view from its nearest neighbour.
    FoundOrder
        Order, with sentences on it for the user.

    Raises
    ------
    InputError
        If the order cannot be used.
    """
    stated = check_order(order or ORDERS[0])
    words = stated.split(",")
    if SNAKE in words:
        raise InputError(f"The order {SNAKE} is for a grid, and these views stand on none.")
    numbers = np.array([[float(count.value) for count in pair] for pair in pairs])
    numbers = numbers * [-1 if word.startswith("-") else 1 for word in words]
    places = numbers[:, ::-1] if words[0].endswith("col") else numbers
    step = float(np.median(cKDTree(places).query(places, k=2)[0][:, 1]))
    says = "as stated" if order else "no other is stated"
    return places[:, None] / step, FoundOrder(
        stated,
        f"{says}; the views stand on no grid: slopes are for a step of {step:g}, the usual "
        f"distance of neighbours. Where the numbers rise upwards, or the column comes first, state "
        f"--order=-row,col or --order=col,row",
    )
