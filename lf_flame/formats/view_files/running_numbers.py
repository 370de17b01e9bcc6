"""Views with one running number: their rows and columns, as stated or as the parallax shows."""

from collections.abc import Callable
from dataclasses import replace
from math import isqrt, prod
from pathlib import Path

import numpy as np

from lf_flame.errors import InputError
from lf_flame.formats.view_files.orders import Grid, by_columns, check_order
from lf_flame.formats.view_files.parallax_order import (
    LEAST_LEAD,
    UNKNOWN,
    FoundOrder,
    find_order,
)


def fold(
    views: np.ndarray,
    source: str | Path,
    shape: Grid | None = None,
    order: str | None = None,
    *,
    read: Callable = np.asarray,
) -> tuple[np.ndarray, FoundOrder]:
    """Cut a row of views into lines, which are rows or columns, and find their order.

    Parameters
    ----------
    views : ndarray, shape (number, ...)
        Views in their order, or arguments of `read`.
    source : str or Path
        Origin of the views, for the message.
    shape : (int, int), optional
        Number of rows and columns of the light field. Default: a square, if the parallax shows
        rows and columns.
    order : str, optional
        Stated order. Default: the one that the parallax shows.
    read : callable, optional
        Function that gives the view for an entry of `views`.

    Returns
    -------
    lines : ndarray, shape (rows, columns, ...)
        Views as they are numbered; (columns, rows, ...) if the order is column by column.
    found : FoundOrder
        Order of the lines and of the views in a line.

    Raises
    ------
    InputError
        If the shape does not match the number of views, or the parallax shows columns x rows
        instead; or if no shape is stated, and no square shows.
    """
    count, side = len(views), isqrt(len(views))
    if shape is not None and prod(shape) != count:
        raise InputError(
            f"A grid of {shape[0]} x {shape[1]} views does not fit {source}, which holds {count}."
        )
    stated = None if order is None else FoundOrder(check_order(order), "as stated")
    if shape is not None:
        if stated is None:
            return _fold_by_parallax(views, source, shape, read)
        return _lines(views, shape[::-1] if by_columns(stated.order) else shape), stated
    if side**2 == count > 1:
        square = _lines(views, (side, side))
        found = find_order(square, read)
        if found.lead > LEAST_LEAD:
            return square, stated or replace(found, half_turn=True)
    shown = f"their parallax shows no {side} rows" if side**2 == count else "they make no square"
    oblong = f"--grid {' or '.join(grids_of(count))}, or as " if len(grids_of(count)) > 1 else ""
    raise InputError(
        f"{source} holds {count} views with one running number, and {shown}: state rows x columns "
        f"as {oblong}--grid 1x{count}, if they are one row (in Python grid=(1, {count}))."
    )


def grids_of(count: int) -> list[str]:
    """Grids of unlike numbers of rows and columns for a number of views, as ``5x7`` and ``7x5``.

    They are the two that are nearest to a square; one row if there is nothing else.
    """
    rows = max(
        (n for n in range(2, isqrt(count) + 1) if count % n == 0 and n * n < count), default=1
    )
    columns = count // rows
    return [f"{rows}x{columns}", f"{columns}x{rows}"] if rows > 1 else [f"1x{count}"]


def _lines(views: np.ndarray, shape: Grid) -> np.ndarray:
    return views.reshape(*shape, *views.shape[1:])


def _fold_by_parallax(
    views: np.ndarray, source: str | Path, shape: Grid, read: Callable
) -> tuple[np.ndarray, FoundOrder]:
    """Cut a row of views into rows, or into columns if the parallax shows these more clearly.

    Lines of the wrong length run across the grid at a slant. All orders then explain little, or
    the best one takes rows for columns, which would give a grid of columns x rows.
    """
    rows, columns = shape
    found = [
        (find_order(_lines(views, lines), read), lines)
        for lines in dict.fromkeys((shape, shape[::-1]))
    ]
    fitting = [one for one in found if by_columns(one[0].order) == (one[1] != shape)]
    fitting = found if rows == columns else fitting
    best, _ = max(found, key=_lead)
    order, lines = max(fitting, key=_lead, default=(UNKNOWN, shape))
    if best.lead > max(LEAST_LEAD, order.lead):
        raise InputError(
            f"The views in {source} move as {columns} rows of {rows} do, not as {rows} rows of "
            f"{columns}: state --grid {columns}x{rows}, or --order too."
        )
    return _lines(views, lines), replace(order, half_turn=order.lead > 0)


def _lead(found: tuple[FoundOrder, Grid]) -> float:
    return found[0].lead
