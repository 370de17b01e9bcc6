"""Figures that are written to files, without a screen; a notebook's backend is not changed."""

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from lf_flame._common.atomic_files import atomic_write


def subplots(
    rows: int = 1, columns: int = 1, *, figsize: Any = None, layout: Any = None, **options: Any
) -> tuple[Figure, Any]:
    """Make a figure with axes, as `matplotlib.pyplot.subplots` does, but without pyplot."""
    figure = Figure(figsize=figsize, layout=layout)
    return figure, figure.subplots(rows, columns, **options)


def save(figure: Figure, path: Path, dpi: int = 150) -> None:
    """Write a figure as PNG."""
    with atomic_write(path) as aside:
        figure.savefig(aside, dpi=dpi)
