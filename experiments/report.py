"""Reports of the experiments: a text with tables, pictures, and the record of how it came about."""

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import pandas as pd
from matplotlib.figure import Figure
from tabulate import tabulate
from tqdm import tqdm

from lf_flame._common import figures, provenance
from lf_flame._common.atomic_files import write_json, write_text

Format = str | Callable[[Any], str]
"""Format specification of a column's values, or a function that writes one."""

BACKBONES = {
    "imagenet": "ResNet-50 (ImageNet)",
    "random": "ResNet-50 (random weights)",
    "resnet50_imagenet_conv1-conv4.npz": "ResNet-50 (ImageNet)",
    "resnet50_pruned_8bit_keras_names.npz": "pruned 8-bit ResNet-50 (ImageNet)",
}
"""Backbone by the weights in a record; any other file is called by its name."""

STAGES = {"conv3": "first three stages", "conv4": "first four stages", "conv5": "all five stages"}

T = TypeVar("T")


def backbone_name(weights: str) -> str:
    """Name a backbone and its stages by the weights in a record."""
    name, _, depth = re.sub(r" \((sha256|seed) \w+\)", "", weights).rpartition(", ")
    network = BACKBONES.get(name, f"ResNet-50 ({name})")
    return f"{network}, {STAGES.get(depth, depth)}" if name else depth


def step_bar(steps: Iterable[T], total: int | None = None) -> Iterable[T]:
    """Show a progress bar over steps; `total` is their number if they have no length."""
    return tqdm(steps, "measuring", total, unit="step")


def panels(
    titles: Sequence[str], size: tuple[float, float], xlabel: str = "", **shared: bool
) -> tuple[Figure, Any]:
    """Make a figure with a row of panels with grids; `shared` axes are those of `subplots`."""
    figure, axes = figures.subplots(
        1, len(titles), figsize=size, squeeze=False, layout="constrained", **shared
    )
    for axis, title in zip(axes[0], titles, strict=True):
        axis.set_title(title, fontsize=10)
        axis.set_xlabel(xlabel)
        axis.grid(alpha=0.25)
    return figure, axes[0]


def write_report(
    out: Path,
    name: str,
    title: str,
    record: dict,
    body: Sequence[str],
    *,
    tables: Mapping[str, pd.DataFrame] | None = None,
    pictures: Mapping[str, Figure] | None = None,
    dpi: int = 150,
) -> Path:
    """Write a report: ``NAME.md``, which is returned, tables, pictures, and last ``NAME.json``.

    The record has ``wall_s`` where the time is known; command, date, revision, versions and machine
    are added, and infinity and NaN become null. The body is paragraphs and tables in Markdown;
    tables (CSV) and pictures (PNG) go by their names without ending.
    """
    record = record | provenance.environment()
    write_text(out / f"{name}.md", "\n\n".join([f"# {title}", origin(record), *body]) + "\n")
    for table_name, table in (tables or {}).items():
        write_text(out / f"{table_name}.csv", table.to_csv(index=False))
    for picture_name, picture in (pictures or {}).items():
        figures.save(picture, out / f"{picture_name}.png", dpi=dpi)
    write_json(out / f"{name}.json", record)
    return out / f"{name}.md"


def origin(record: dict) -> str:
    """Say by which command, when, on which revision and machine a result was made."""
    versions = ", ".join(f"{name} {version}" for name, version in record["versions"].items())
    seconds = f"; {record['wall_s']:.0f} s" if "wall_s" in record else ""
    return (
        f"`{record['command']}`, {record['date']}, revision {record['git_revision']}, "
        f"{record['machine']}; {versions}{seconds}."
    )


def markdown(
    table: pd.DataFrame | Sequence[dict],
    columns: Mapping[str, tuple[str, Format]] | None = None,
    *,
    missing: str = "",
) -> str:
    """Write columns (heading and format by name; default: all) of a table as Markdown.

    Numbers are on the right, words on the left, and `missing` in place of None and NaN.
    """
    table = pd.DataFrame(table)
    columns = columns or {name: (name, "") for name in table}
    sides = [
        "right" if form or pd.api.types.is_numeric_dtype(table[name]) else "left"
        for name, (_, form) in columns.items()
    ]
    written = [
        [_written(value, form, missing) for value in table[name]]
        for name, (_, form) in columns.items()
    ]
    headings = [heading for heading, _ in columns.values()]
    rows = list(zip(*written, strict=True))
    return tabulate(rows, headings, "pipe", colalign=sides, disable_numparse=True)


def _written(value: Any, form: Format, missing: str) -> str:
    if callable(form):
        return form(value)
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return missing
    return format(value, form)
