"""Orders and grids of views, as users state them.

An order names the meaning of the two numbers of a view, the slower one first: ``row,col`` is row
by row. A minus turns an axis: ``-row`` counts rows from the bottom, ``-col`` columns from the
right. ``snake`` before it means that every other row (with ``col,row``: column) runs back.
"""

import numpy as np

from lf_flame.errors import InputError
from lf_flame.lightfield import LightField

ORDERS = tuple(
    f"{a}{first},{b}{second}"
    for first, second in (("row", "col"), ("col", "row"))
    for a in ("", "-")
    for b in ("", "-")
)

SNAKE = "snake"
"""First word of an order whose second, fourth ... run of the slower number is backwards."""

Grid = tuple[int, int]
"""Number of rows and columns of views."""


def arranged(views: np.ndarray, order: str) -> np.ndarray:
    """Reorder an array of views, or of files, from an order to ``[v, u, ...]``."""
    order = check_order(order)
    if order.startswith(SNAKE):
        views = views.copy()
        views[1::2] = views[1::2, ::-1].copy()
        order = order.partition(",")[2]
    for axis, name in enumerate(order.split(",")):
        if name.startswith("-"):
            views = np.flip(views, axis)
    return np.swapaxes(views, 0, 1) if by_columns(order) else views


def check_order(order: str) -> str:
    """Return a stated order without blanks; ``snake`` alone is ``snake,row,col``.

    Raises
    ------
    InputError
        If it is not one of `ORDERS`, with ``snake`` before it or without.
    """
    plain = str(order).replace(" ", "")
    snake, _, rest = plain.partition(",") if plain.startswith(SNAKE) else ("", "", plain)
    rest = ORDERS[0] if plain == SNAKE else rest
    if snake not in ("", SNAKE) or rest not in ORDERS:
        raise InputError(
            f"order must be one of {'; '.join(ORDERS)}, with snake, before it where every other "
            f"row runs back, got {order!r}."
        )
    return f"{snake},{rest}" if snake else rest


def arranged_light_field(light_field: LightField, order: str | None) -> LightField:
    """Reorder the views of a light field, their weights and known pixels, from an order, if any."""
    if order is None:
        return light_field
    beside = {"weights": light_field.weights, "valid": light_field.valid}
    return LightField(
        arranged(light_field.views, order),
        **{name: None if one is None else arranged(one, order) for name, one in beside.items()},
    )


def by_columns(order: str) -> bool:
    """Whether an order counts column by column, so that its first number is the column's."""
    return "col," in order


def turned_round(order: str) -> str:
    """Order with both axes turned, which only changes the sign of all slopes."""
    *snake, first, second = order.split(",")
    turned = [name[1:] if name.startswith("-") else f"-{name}" for name in (first, second)]
    return ",".join([*snake, *turned])


def check_grid(stated: Grid | None, found: Grid, source: object) -> None:
    """Refuse a stated number of rows and columns, if there is one, that a source does not hold."""
    if stated not in (None, found):
        raise InputError(
            f"A grid of {stated[0]} x {stated[1]} views does not fit {source}, of {found[0]} x "
            f"{found[1]}."
        )


def as_grid(grid: Grid | str | None) -> Grid | None:
    """Read rows and columns of views, if they are given; see `read_grid`."""
    return None if grid is None else read_grid(grid, "grid")


def read_grid(grid: Grid | str, name: str) -> Grid:
    """Read rows and columns of views from two numbers, or from text such as ``1x9``.

    Raises
    ------
    InputError
        If they are not two whole numbers above 0.
    """
    words = grid.lower().split("x") if isinstance(grid, str) else list(grid)
    try:
        rows, columns = (int(word) for word in words)
    except (TypeError, ValueError):
        rows = columns = 0
    if rows < 1 or columns < 1:
        raise InputError(
            f"{name} must be rows x columns of views, such as 1x9 or (1, 9), got {grid!r}."
        )
    return rows, columns
