"""Table and pictures of how well emission by depth is found."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from textwrap import fill

import numpy as np
import pandas as pd

from experiments.report import markdown, write_report
from experiments.tomography.colours import colours_figure
from experiments.tomography.phantoms import (
    BLOCK,
    Recorder,
    overlapping_flames,
    truth_on,
    volume_flame,
)
from experiments.tomography.round_flames import round_figure
from experiments.tomography.tasks import AGAINST_NOISE, DEPTHS_MM, Row, by_focal_stack
from lf_flame import PAPER_CAMERA, Scene
from lf_flame._common.figures import subplots
from lf_flame.tomography import FrustumGrid, reconstruct
from lf_flame.tomography.frustum_grid import planes_between

EMISSION, NETWORKS, BARS = "emission", "networks", "bars"
"""Reports that are written."""


COLUMNS = {
    "task": ("task", ""),
    "noise": ("noise", ""),
    "method": ("method", ""),
    "measure": ("what", ""),
    "value": ("value", ".4f"),
    "accepted": ("wanted", "g"),
    "seconds": ("seconds", ".2f"),
}

TITLES = {
    EMISSION: "Emission by depth from one light field",
    BARS: "How often bars of 95 % hold the truth",
    NETWORKS: "The planes of the paper's network, taken for sections",
}

TEXTS = {
    EMISSION: [
        "15 x 15 views of 270 x 540 lenslets, averaged to 90 x 180 pixels; noise as a share of the "
        "brightest pixel of those, or electrons in it. The phantoms are rendered by the simulator "
        "from layers of their own cells, not from the inversion's. Flames in matter are a quarter "
        "of the others in size, seen by 72 x 84 lenslets. Errors are root-mean-square relative to "
        "the truth's root-mean-square. `reconstruct` is called as a user calls it, its noise "
        "measured and its penalty chosen by itself. One draw of the noise each, where nothing else "
        "is said; seconds with all setting up.",
        "What is called small is a quarter in size too, and not averaged. Temperatures count where "
        "the emission exceeds 20 % of its plane's peak. How often error bars hold the truth: "
        "[bars.md](bars.md).",
        "The round flame's axis is found, too; its errors count heights between 3 and 97 % of its "
        "own, over the volume and over the half section. PyAbel sees the middle view alone, and "
        "has the penalty of least true error. The video is followed twice; seconds are those of "
        "the second time, when nothing is left to compile.",
    ],
    BARS: [
        "15 x 15 views of 72 x 84 lenslets, flames a quarter of the usual size. Each row is a mean "
        "over independent draws of the noise, its number beside the noise. Cells and places on "
        "profiles count where the truth exceeds 5 % of the plane's peak. Two successive draws are "
        "the two colours of a temperature. A bar is right that holds the truth in 93 to 97 %. "
        "Seconds are those of a reconstruction of 20 bootstrap draws on one thread, others beside "
        "it."
    ],
    NETWORKS: [
        "The network draws refocused images, from the photograph focused at 0 mm. Taken for "
        "emission, its planes are held against the truth on a scene that it has not learnt from, "
        "beside `reconstruct` and the refocused images. All else as in [emission.md](emission.md)."
    ],
}


def write(out: Path, name: str, rows: Sequence[Row], wall_s: float) -> Path:
    """Write ``NAME.csv``, ``.md`` and ``.json``; with `EMISSION` the pictures, too."""
    table = pd.DataFrame([asdict(row) for row in rows])
    pictures = {}
    if name == EMISSION:
        pictures = {
            "sheets": sheets_figure(),
            "volume": volume_figure(),
            "noise": noise_figure(table),
            "round": round_figure(),
            "colours": colours_figure(),
        }
    return write_report(
        out, name, TITLES[name], {"wall_s": round(wall_s, 1)}, body(name, table),
        tables={name: table}, pictures=pictures, dpi=110,
    )  # fmt: skip


def body(name: str, table: pd.DataFrame) -> list[str]:
    """Write the table and what it rests on as Markdown."""
    return [*TEXTS[name], markdown(table, COLUMNS)]


def _planes(scene: Scene, grid: FrustumGrid) -> dict[str, np.ndarray]:
    """Truth, reconstruction and refocused images of a scene at 1 % of noise."""
    light_field = Recorder(scene, PAPER_CAMERA).with_noise(0.01, np.random.default_rng(0))
    return {
        "truth": truth_on(grid, scene),
        "reconstructed": reconstruct(light_field, grid).emission,
        "refocused": by_focal_stack(light_field, grid),
    }


def sheets_figure():
    """Four flames behind each other at 1 % of noise: truth, reconstruction, refocused images."""
    lines = _planes(overlapping_flames(DEPTHS_MM), FrustumGrid(PAPER_CAMERA, DEPTHS_MM, BLOCK))
    columns = slice(55, 130)
    figure, axes = subplots(3, 4, figsize=(9, 8.4), layout="constrained")
    for axis_line, (word, planes) in zip(axes, lines.items(), strict=True):
        white = max(float(lines["truth"].max()), float(planes.max()) if word != "truth" else 0)
        for axis, plane, depth in zip(axis_line, planes, DEPTHS_MM, strict=True):
            drawn = axis.imshow(plane[:, columns], cmap="inferno", vmin=0, vmax=white)
            axis.set_title(f"{word}, {depth:+g} mm", fontsize=9)
            axis.axis("off")
        figure.colorbar(drawn, ax=list(axis_line), shrink=0.85, label="radiance")
    return figure


def volume_figure():
    """Show a flame that is round in depth: sections across and along depth, at 1 % of noise."""
    scene = volume_flame(25.0, 4.0, slab_mm=0.5, reach_mm=12.0)
    grid = FrustumGrid(PAPER_CAMERA, planes_between(-12, 12, 2), BLOCK)
    lines = _planes(scene, grid)
    middle, row = len(grid.depths_mm) // 2, 55
    half = grid.cell_mm(0.0) * grid.pixels[1] / 2
    figure, axes = subplots(
        2, 3, figsize=(10, 6), layout="constrained", height_ratios=(1.4, 1), squeeze=False
    )
    found = np.stack([lines["truth"], lines["reconstructed"]])  # on one scale, to be compared
    for (word, planes), (across, along) in zip(lines.items(), axes.T, strict=True):
        scale = planes[None] if word == "refocused" else found
        white = float(scale[:, middle].max())
        drawn = across.imshow(planes[middle][:, 50:130], cmap="inferno", vmin=0, vmax=white)
        across.axhline(row, color="w", linewidth=0.5)
        across.set_title(f"{word}, plane at 0 mm", fontsize=9)
        across.axis("off")
        figure.colorbar(drawn, ax=across, shrink=0.8)
        section = along.imshow(
            planes[:, row], cmap="inferno", vmin=0, vmax=float(scale[:, :, row].max()),
            extent=(-half, half, 13, -13), aspect="equal",
        )  # fmt: skip
        along.set_xlim(-16, 16)
        along.set_xlabel("across (mm)")
        along.set_title(f"{word}, along depth", fontsize=9)
        figure.colorbar(section, ax=along, shrink=0.8)
    axes[1][0].set_ylabel("depth (mm)")
    return figure


def noise_figure(table: pd.DataFrame):
    """Worst plane's error of the paper's four flames against noise, by method."""
    figure, axis = subplots(figsize=(7.4, 4.2), layout="constrained")
    rows = table[table["task"] == AGAINST_NOISE]
    for method, some in rows.groupby("method", sort=False):
        shares = [float(noise.rstrip("%")) for noise in some["noise"]]
        (line,) = axis.loglog(shares, 100 * some["value"], "o-")
        axis.annotate(
            fill(method, 20), (1.02, 100 * some["value"].iloc[-1]), color=line.get_color(),
            xycoords=("axes fraction", "data"), va="center", fontsize=9, annotation_clip=False,
        )  # fmt: skip
    axis.set_xlabel("noise, % of the brightest pixel")
    axis.set_ylabel("worst plane's error (%)")
    for ticks in (axis.xaxis, axis.yaxis):
        ticks.set_major_formatter("{x:g}")
    axis.grid(alpha=0.3)
    return figure
