"""Table and picture of slope maps beside the truth (`experiments.slope_maps.measuring`)."""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from experiments.slope_maps.measuring import search_slopes
from experiments.slope_maps.rivals import WAYS
from experiments.slope_maps.scenes import Sample
from lf_flame._common import figures
from lf_flame._common.atomic_files import finite, together, write_json, write_text

HEADINGS = {
    "mse_x100": "MSE x 100",
    "wrong_percent": "wrong (%)",
    "certain_percent": "called certain (%)",
    "wrong_of_certain_percent": "wrong of these (%)",
}

FORMATS = ("", "", "", ".1f", ".1f", ".1f", ".1f", ".2f")


def write_report(out: Path, table: pd.DataFrame, record: dict, sample: Sample) -> Path:
    """Write what `experiments.slope_maps.measuring.measure` found.

    Parameters
    ----------
    out : Path
        Folder for ``slope_maps.csv``, ``.md``, ``.png`` and ``.json``, the record.
    table, record, sample
        See there.

    Returns
    -------
    Path
        ``slope_maps.md``.
    """
    with together(out, last="slope_maps.json") as aside:
        write_text(aside / "slope_maps.csv", table.to_csv(index=False))
        write_text(aside / "slope_maps.md", text(table, record))
        figures.save(picture(sample), aside / "slope_maps.png")
        rows = [finite(row) for row in record["rows"]]
        write_json(aside / "slope_maps.json", {**record, "rows": rows})
    return out / "slope_maps.md"


def text(table: pd.DataFrame, record: dict) -> str:
    """Put the table and what it rests on into Markdown."""
    views, size = record["camera"]["views"], record["camera"]["lenslets"]
    shown = table.rename(columns=HEADINGS).to_markdown(
        index=False, floatfmt=FORMATS, disable_numparse=[2]
    )
    return f"""# Slope maps beside the truth

`python -m experiments slope-maps`, {record["date"]}, revision {record["git_revision"]},
{record["machine"]}; {record["wall_s"]:.0f} s.

Scenes of opaque layers, {views} x {views} views of {size[0]} x {size[1]} pixels, 8 bits, without
and with noise (its standard deviation, as a part of white); means over seeds
{", ".join(map(str, record["seeds"]))}. The true slopes come from the geometry. Wrong: off by more
than 0.07. Every map searches {record["steps"]} slopes from {record["slopes"][0]:g} to
{record["slopes"][1]:g} with a window of 3 pixels. "Sharpness, before" is the library's map until
now; "all views" takes the slope at which all views vary least, and "median" smooths that.

{shown}

![Maps of one scene](slope_maps.png)
"""


def picture(sample: Sample) -> Figure:
    """Show the middle view, the truth and the maps of one scene, errors below."""
    maps = {name: way(sample.views, search_slopes()) for name, way in WAYS.items()}
    figure = Figure(figsize=(2.4 * (len(maps) + 1), 4.2), layout="constrained")
    axes = figure.subplots(2, len(maps) + 1)
    middle = sample.views[sample.views.shape[0] // 2, sample.views.shape[1] // 2]
    axes[0, 0].imshow(sample.slopes, vmin=sample.slopes.min(), vmax=sample.slopes.max())
    axes[0, 0].set_title("truth", fontsize=8)
    axes[1, 0].imshow(middle, cmap="gray")
    for column, (name, (slope, certain)) in zip(axes[:, 1:].T, maps.items(), strict=True):
        column[0].imshow(slope, vmin=sample.slopes.min(), vmax=sample.slopes.max())
        column[0].set_title(name, fontsize=8)
        error = np.where(certain, np.abs(slope - sample.slopes), np.nan)
        column[1].imshow(error, vmin=0, vmax=0.3, cmap="magma")
        column[1].set_title("errors of the certain", fontsize=8)
    for ax in axes.flat:
        ax.set_axis_off()
    return figure
