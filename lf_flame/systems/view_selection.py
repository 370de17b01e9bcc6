"""Selections of the views of a light field that a system uses."""

import numpy as np

from lf_flame._common.arrays import spread
from lf_flame.errors import InputError
from lf_flame.systems.base import ViewIndices

ARM = 4
"""Number of views of the cross on each side of its centre."""


def every_view(rows: int, columns: int) -> ViewIndices:
    """List all views."""
    return [(v, u) for v in range(rows) for u in range(columns)]


def square_of_views(rows: int, columns: int, side: int = 3) -> ViewIndices:
    """Choose the views at the centres of side x side equal parts of the aperture."""
    _need_square(rows, columns, side)
    return [(v, u) for v in middles(rows, side) for u in middles(columns, side)]


def outer_square_of_views(rows: int, columns: int, side: int) -> ViewIndices:
    """Choose side x side views, spread from the first to the last."""
    _need_square(rows, columns, side)
    return [(v, u) for v in spread(rows, side) for u in spread(columns, side)]


def _need_square(rows: int, columns: int, side: int) -> None:
    if min(rows, columns) < side:
        raise InputError(f"{side} x {side} views are needed, got {rows} x {columns}.")


def cross_of_views(rows: int, columns: int, arm: int = ARM) -> ViewIndices:
    """Choose the central row and the central column, 2 arm + 1 views of each, spread evenly.

    With arm 4 these are 17 of 81 views (Samarakoon et al., arXiv 2502.19238).
    """
    need = 2 * arm + 1
    if min(rows, columns) < need:
        raise InputError(f"A cross of {need} views each way is needed, got {rows} x {columns}.")
    down, across = spread(rows, need), spread(columns, need)
    middle = down[arm], across[arm]
    return [(v, middle[1]) for v in down] + [(middle[0], u) for u in across if u != middle[1]]


def lattice_of_views(rows: int, columns: int) -> ViewIndices:
    """Choose nine views spread evenly over the aperture, no two in the same row or column.

    They are the nodes of a rank-1 lattice, (k, 2k modulo 9) (I. H. Sloan, S. Joe, "Lattice Methods
    for Multiple Integration", Oxford 1994). Along a row or a column they sample the aperture at
    nine positions, unlike 3 x 3 views at three. The ghosts of an edge are three times as close.
    """
    if min(rows, columns) < LATTICE:
        raise InputError(
            f"The lattice needs {LATTICE} x {LATTICE} views or more, got {rows} x {columns}."
        )
    down, across = (middles(n, LATTICE) for n in (rows, columns))
    half = LATTICE // 2
    return [(down[(2 * (k - half) + half) % LATTICE], across[k]) for k in range(LATTICE)]


LATTICE = 9


def middles(count: int, parts: int) -> list[int]:
    """Find the views nearest to the centres of equal parts of the aperture."""
    return np.floor((np.arange(parts) + 0.5) * count / parts).astype(int).tolist()
