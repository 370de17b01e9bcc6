"""Table and picture of slope maps beside the truth (`experiments.slope_maps.measuring`)."""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from experiments.report import markdown, write_report
from experiments.slope_maps.rivals import WAYS

COLUMNS = {
    "scene": ("scene", ""),
    "map": ("map", ""),
    "bad_07": ("off by over 0.07 (%)", ".1f"),
    "bad_03": ("0.03 (%)", ".1f"),
    "bad_01": ("0.01 (%)", ".1f"),
    "mse_x100": ("MSE x 100", ".1f"),
    "certain_percent": ("certain (%)", ".0f"),
    "bad_07_of_certain": ("of these, off by over 0.07 (%)", ".1f"),
    "worst_bad_07_of_certain": ("in the worst scene (%)", ".1f"),
    "seconds": ("seconds", ".1f"),
}


def write(out: Path, record: dict, shown: dict) -> Path:
    """Write ``slope_maps.*`` from what `experiments.slope_maps.measuring.measure` found."""
    return write_report(
        out, "slope_maps", "Slope maps beside the truth", record, body(record),
        tables={"slope_maps": pd.DataFrame(record["rows"])},
        pictures={"slope_maps": picture(shown)},
        dpi=70,
    )  # fmt: skip


def body(record: dict) -> list[str]:
    """Table and what it rests on, as Markdown."""
    height, width = record["size"]
    low, high = record["slopes"]
    photographs, tuned = (", ".join(record[key]) for key in ("photographs", "tuned_on"))
    return [
        f"Photographs of scikit-image ({photographs}) on surfaces, 9 x 9 views (or as the kind "
        f"says) of {height} x {width} pixels, 8 bits, noise of 0.3 % of white (2 % in the kind of "
        f"that name), JPEG of quality 85; seeds {', '.join(map(str, record['seeds']))}. "
        "The renderer is the experiment's own; the true slopes follow from geometry. Kinds from "
        '"shadow" to "15 x 15 views" are mixed scenes of all surfaces. The library\'s numbers were '
        f"chosen on other photographs ({tuned}) and seeds, the form of its confidence with a look "
        "at other scenes of these photographs too (seeds 2 to 4). Every map searches "
        f"{record['steps']} slopes from {low:g} to {high:g}. The plain methods call every pixel "
        "certain. Transparent "
        "scenes are the mean of two: no pixel has one slope, and only the share of certain pixels "
        "counts.",
        markdown(record["rows"], COLUMNS, missing="nan"),
        "![Maps of the first scene of each kind](slope_maps.png)",
    ]


def picture(shown: dict) -> Figure:
    """Central view, truth and the slopes by each method, for a scene of each kind."""
    figure = Figure(figsize=(1.6 * (len(WAYS) + 2), 1.4 * len(shown)), layout="constrained")
    axes = figure.subplots(len(shown), len(WAYS) + 2, squeeze=False)
    for row, (kind, (sample, maps)) in zip(axes, shown.items(), strict=True):
        middle = sample.views[sample.views.shape[0] // 2, sample.views.shape[1] // 2]
        row[0].imshow(middle, cmap="gray")
        known = sample.slopes if np.isfinite(sample.slopes).all() else maps["library"]
        images = {"truth": sample.slopes, **maps}
        for ax, image in zip(row[1:], images.values(), strict=True):
            ax.imshow(image, vmin=known.min(), vmax=known.max())
        for ax, title in zip(row, (kind, *images), strict=True):
            ax.set_axis_off()
            ax.set_title(title, fontsize=7)
    return figure
