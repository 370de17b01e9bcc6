"""Table and picture of slope maps beside the truth (`experiments.slope_maps.measuring`)."""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from experiments.report import markdown, write_report
from experiments.slope_maps.measuring import search_slopes
from experiments.slope_maps.rivals import WAYS
from experiments.slope_maps.scenes import Sample

COLUMNS = {
    "map": ("map", ""),
    "scene": ("scene", ""),
    "noise": ("noise", ""),
    "mse_x100": ("MSE x 100", ".1f"),
    "wrong_percent": ("wrong (%)", ".1f"),
    "certain_percent": ("called certain (%)", ".1f"),
    "wrong_of_certain_percent": ("wrong of these (%)", ".1f"),
    "seconds": ("seconds", ".2f"),
}


def write(out: Path, record: dict, sample: Sample) -> Path:
    """Write ``slope_maps.*`` from what `experiments.slope_maps.measuring.measure` found."""
    return write_report(
        out, "slope_maps", "Slope maps beside the truth", record, body(record),
        tables={"slope_maps": pd.DataFrame(record["rows"])},
        pictures={"slope_maps": picture(sample)},
    )  # fmt: skip


def body(record: dict) -> list[str]:
    """Write the table and what it rests on as Markdown."""
    views, size = record["camera"]["views"], record["camera"]["lenslets"]
    low, high = record["slopes"]
    return [
        f"Scenes of opaque layers, {views} x {views} views of {size[0]} x {size[1]} pixels, 8 "
        "bits, without and with noise (its standard deviation, as a part of white); means over "
        f"seeds {', '.join(map(str, record['seeds']))}. The true slopes come from the geometry. "
        f"Wrong: off by more than 0.07. Every map searches {record['steps']} slopes from {low:g} "
        f'to {high:g} with a window of 3 pixels. "Sharpness, before" is the library\'s map until '
        'now; "all views" takes the slope at which all views vary least, and "median" smooths '
        "that.",
        markdown(record["rows"], COLUMNS, missing="nan"),
        "![Maps of one scene](slope_maps.png)",
    ]


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
