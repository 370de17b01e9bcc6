"""Table, text and figure of the study of refocusing (`experiments.costs.refocusing`)."""

import math
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.lines import Line2D
from matplotlib.text import Annotation, Text
from matplotlib.transforms import Bbox

from experiments.costs.refocusing import ALONE, NETWORK, binned
from experiments.report import markdown, write_report
from lf_flame._common.figures import subplots

VIDEO_HZ = 25
"""Light fields a second from which on we speak of real time."""

EIGHT_BITS_DB = 20 * math.log10(255 * math.sqrt(12))
"""PSNR of an image whose only error is rounding to 8 bits."""

EXACT_DB, EXACT_SSIM = 140.0, 1 - 1e-7
"""Where the figure draws what is exact: scores that rounding of float32 does not reach."""

FAMILIES = {
    "interpolation": ("#0072B2", "o", "", "interpolation, all views"),
    "central": ("#E69F00", "s", "-", "central views: a smaller aperture (linear)"),
    "spread": ("#009E73", "^", "-", "views spread over the full aperture (linear)"),
    "storage": ("#CC79A7", "D", "", "storage, all views (linear)"),
    "fourier": ("#000000", "v", "", "Fourier domain, all views"),
    "network": ("#D55E00", "*", "", f"trained {NETWORK}"),
}
"""Colour, marker, line and words of each family, told apart by colour-blind readers as well."""

PLACES = [
    (radius * math.cos(angle), radius * math.sin(angle))
    for radius in (9, 13, 20, 30, 45, 60, 80, 105)
    for angle in np.pi / 12 * np.array([0, 6, 12, 18, 3, 9, 15, 21, *range(1, 24)])
]
"""Where the figure may put a label beside its point, the best first, in points."""

COLUMNS = {
    "data_set": ("data set", ""),
    "title": ("method", ""),
    "milliseconds": ("ms", ".3g"),
    "psnr_db": ("PSNR (dB)", lambda x: _decibels(x)),
    "worst_psnr_db": ("worst", lambda x: _decibels(x)),
    "ssim": ("SSIM", ".5f"),
    "worst_ssim": ("worst", ".5f"),
}

CURVE_DOTS = 40
"""Places on each piece of a curve that labels keep clear of."""


def write(out: Path, record: dict) -> Path:
    """Write ``refocusing.*`` from the record of `experiments.costs.refocusing`."""
    table = table_of(record)
    return write_report(
        out, "refocusing", "What accuracy costs in time: refocusing", record, body(record),
        tables={"refocusing": table}, pictures={"refocusing": figure(record)},
    )  # fmt: skip


def table_of(record: dict) -> pd.DataFrame:
    """Give the methods of a record, in which JSON knows no infinity."""
    table = pd.DataFrame(record["methods"])
    for name in ("psnr_db", "worst_psnr_db"):
        known = table[name].astype(float)
        table[name] = known.where(known.notna() | table["milliseconds"].isna(), np.inf)
    return table


def body(record: dict) -> list[str]:
    """Write the table, and in words what it says, as Markdown."""
    scenes, table = record["scenes"], table_of(record)
    cores = f"{record['threads']} cores" if record["threads"] > 1 else "one core"
    found = [_finding(name, one["run"] is not None, table) for name, one in scenes.items()]
    return [
        "## What was measured",
        "\n".join(_scene_line(name, one) for name, one in scenes.items()),
        f"""Time: from a light field in memory to the finished images, the fastest of a few runs,
compiled beforehand, on {cores}, without a graphics card. Score: against exact phases of all views
(nothing is interpolated; float64; edges clamped), averaged and clipped like the targets of the data
sets, over samples that the network was not trained on. PSNR is that of the mean squared error of
all images; worst is a single image. (The targets that the network learns from are linear
shift-and-sum.) Central views are those of a smaller aperture, with its greater depth of field;
those over the full aperture are what a camera with few views has, and show ghosts.""",
        "## What it says",
        "\n".join(f"- {said}" for said in [*found, _premise(scenes, table, cores)]),
        "## All methods",
        markdown(table, COLUMNS, missing="missing"),
    ]


def _scene_line(name: str, scenes: dict) -> str:
    config = scenes["config"]
    camera, (height, width) = config["camera"], config["image"]
    planes = ", ".join(f"{x['depth_mm']:g}" for x in config["template"]["objects"])
    samples = ", ".join(map(str, scenes["samples"]))
    return (
        f"- {name}: {_views(camera)} to {len(scenes['slopes'])} images of {height} x {width}, "
        f"refocused at {planes} mm; samples {samples}. {NETWORK}: {scenes['network']}"
    )


def _views(camera: dict) -> str:
    lines, columns = camera["lenslets"]
    return f"{camera['views']} x {camera['views']} views of {lines} x {columns} lenslets"


def _row(table: pd.DataFrame, name: str, family: str, label: str) -> pd.Series:
    found = (table["family"] == family) & (table["label"] == label)
    return table[found & (table["data_set"] == name)].iloc[0]


def _finding(name: str, trained: bool, table: pd.DataFrame) -> str:
    """Set the network beside linear shift-and-sum, in words."""
    linear = _row(table, name, "interpolation", "linear")
    begin = (
        f"{name}: linear shift-and-sum of all views takes {_ms(linear)} "
        f"({1e3 / linear['milliseconds']:.3g} light fields a second) and reaches "
        f"{linear['psnr_db']:.1f} dB."
    )
    if not trained:
        return f"{begin} {NETWORK} is missing."
    network, alone = (_row(table, name, "network", label) for label in (NETWORK, ALONE))
    methods = table[(table["data_set"] == name) & (table["family"] != "network")]
    as_good = methods[methods["psnr_db"] >= network["psnr_db"]]
    fastest = as_good.loc[as_good["milliseconds"].idxmin()]
    change = network["psnr_db"] - linear["psnr_db"]
    return (
        f"{begin} {NETWORK} takes {_ms(network)}, {_times(network, linear)}, and its images are "
        f"{abs(change):.1f} dB {'better' if change > 0 else 'worse'} ({network['psnr_db']:.1f} dB, "
        f"SSIM {network['ssim']:.4f} beside {linear['ssim']:.4f}). With its input given it takes "
        f"{_ms(alone)}, {_times(alone, linear)}. The fastest method at least as good as the "
        f"network: {fastest['title']}, {_ms(fastest)}, {fastest['psnr_db']:.1f} dB."
    )


def _premise(scenes: dict, table: pd.DataFrame, cores: str) -> str:
    """Say how the paper's premise fares."""
    config = next(iter(scenes.values()))["config"]
    height, width = config["image"]
    block = tuple(
        n // pixels for n, pixels in zip(config["camera"]["lenslets"], config["image"], strict=True)
    )
    wanted = {
        "float32": ("interpolation", "linear"),
        "uint8": ("storage", "uint8"),
        f"{height} x {width} lenslets": ("storage", binned(block)),
    }
    rates = {kind: _slowest_hz(table, *method) for kind, method in wanted.items()}
    rates = {kind: hz for kind, hz in rates.items() if math.isfinite(hz)}
    network = _slowest_hz(table, "network", NETWORK)
    shown = ", ".join(f"{hz:.3g} of {kind}" for kind, hz in rates.items())
    holds = " and ".join(f"of {kind}" for kind, hz in rates.items() if hz < VIDEO_HZ)
    return (
        f"The paper's premise is that conventional algorithms cannot refocus light fields in real "
        f"time. Light fields a second by linear shift-and-sum of all views on {cores}: {shown}; by "
        f"the network: {f'{network:.3g}' if network > 0 else 'missing'}. If real time is "
        f"{VIDEO_HZ}, the premise holds for {f'light fields {holds}' if holds else 'none of them'}."
    )


def _slowest_hz(table: pd.DataFrame, family: str, label: str) -> float:
    """Light fields a second where a method is slowest; NaN where it was not measured."""
    rows = table[(table["family"] == family) & (table["label"] == label)]
    return 1e3 / rows["milliseconds"].max()


def _decibels(value: float) -> str:
    if math.isnan(value):
        return "missing"
    return "exact" if math.isinf(value) else f"{value:.1f}"


def _ms(row) -> str:
    return f"{row['milliseconds']:.3g} ms"


def _times(row, other) -> str:
    """Compare two times in words."""
    ratio = row["milliseconds"] / other["milliseconds"]
    if abs(math.log(ratio)) < 0.05:
        return "about as long"
    return f"{ratio:.2g} times as long" if ratio > 1 else f"{1 / ratio:.2g} times as fast"


def figure(record: dict):
    """Draw PSNR and SSIM over milliseconds, one column a data set."""
    found, table = record["scenes"], table_of(record)
    picture, axes = subplots(
        2, len(found), figsize=(8.0 * len(found), 11.0), sharex=True, sharey="row", squeeze=False,
        layout="constrained",
    )  # fmt: skip
    for (name, scenes), column in zip(found.items(), axes.T, strict=True):
        rows = table[table["data_set"] == name]
        heights = np.minimum(rows["psnr_db"], EXACT_DB), 1 - np.minimum(rows["ssim"], EXACT_SSIM)
        for axis, height in zip(column, heights, strict=True):
            _draw_methods(axis, rows.assign(height=height))
        title = f"{name}: {_views(scenes['config']['camera'])} to {len(scenes['slopes'])} "
        column[0].set_title(f"{title}refocused images", fontsize=11)
        if scenes["run"] is None:
            column[0].text(0.98, 0.02, f"{NETWORK}: missing", color=FAMILIES["network"][0],
                           transform=column[0].transAxes, horizontalalignment="right")  # fmt: skip
        column[1].set_xlabel("milliseconds for a light field (all cores)")
    _scale_axes(axes, table)
    picture.suptitle("Refocusing: the higher the closer to the exact result, the farther left the "
                     "faster", fontsize=13)  # fmt: skip
    handles = [
        Line2D([], [], color=colour, marker=marker, linestyle=line, label=words)
        for colour, marker, line, words in FAMILIES.values()
    ]
    picture.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False)
    picture.draw_without_rendering()  # lays it out, so that it is known what overlaps
    picture.set_layout_engine("none")
    for axis in axes.flat:
        _place_labels(axis)
    return picture


def _draw_methods(axis, rows: pd.DataFrame) -> None:
    """Draw every method as a labelled point; fewer views are curves that end at all of them."""
    whole = rows[(rows["family"] == "interpolation") & (rows["label"] == "linear")]
    for name, (colour, marker, line, _) in FAMILIES.items():
        some = rows[(rows["family"] == name) & rows["milliseconds"].notna()]
        if line:
            ends = pd.concat([some, whole])
            axis.plot(ends["milliseconds"], ends["height"], line, color=colour, zorder=1)
        for method in some.itertuples():
            place, aside = (method.milliseconds, method.height), method.label == ALONE
            size, face = (15 if marker == "*" else 7), ("white" if aside else colour)
            axis.plot(*place, marker, color=colour, markersize=size, markerfacecolor=face)
            axis.annotate(
                method.label.replace(" x ", "×"), place, (0, 0), textcoords="offset points",
                color=colour, fontsize=9, annotation_clip=False,
                arrowprops={"arrowstyle": "-", "linewidth": 0.5, "color": colour, "shrinkB": 3},
            )  # fmt: skip


def _scale_axes(axes, table: pd.DataFrame) -> None:
    """Scale milliseconds by logarithm, and SSIM by that of its distance from 1."""
    decibels, similarity = axes[:, 0]
    decibels.set_xscale("log")
    decibels.set_xlim(table["milliseconds"].min() / 2, 2.5 * table["milliseconds"].max())
    decibels.set_ylim(10 * math.floor(table["psnr_db"].min() / 10) - 5, EXACT_DB + 6)
    ticks = range(20, int(EXACT_DB), 20)
    decibels.set_yticks([*ticks, EXACT_DB], [*map(str, ticks), "exact"])
    decibels.set_ylabel("PSNR against the exact result (dB)")
    similarity.set_yscale("log")
    similarity.set_ylim(2 * (1 - table["ssim"].min()), (1 - EXACT_SSIM) / 2.5)
    nines = range(1, 7)
    similarity.set_yticks(
        [*(10.0**-n for n in nines), 1 - EXACT_SSIM],
        [*(f"{1 - 10.0**-n:.{n}f}" for n in nines), "1"],
    )
    similarity.minorticks_off()
    similarity.set_ylabel("SSIM against the exact result")
    for axis in axes.flat:
        axis.grid(which="major", alpha=0.25)
        axis.axvline(1e3 / VIDEO_HZ, color="0.5", linewidth=0.8, linestyle=":")
    for axis in axes[0]:
        axis.axhline(EIGHT_BITS_DB, color="0.5", linewidth=0.8, linestyle=":")
        axis.text(0.99, EIGHT_BITS_DB + 1, "error of rounding to 8 bits", fontsize=8, color="0.4",
                  transform=axis.get_yaxis_transform(), horizontalalignment="right")  # fmt: skip
        axis.text(1e3 / VIDEO_HZ, 0.01, f" {VIDEO_HZ} light fields a second", fontsize=8,
                  color="0.4", transform=axis.get_xaxis_transform())  # fmt: skip


def _place_labels(axis) -> None:
    """Put each label where it covers neither a point nor another text."""
    notes = [note for note in axis.texts if isinstance(note, Annotation)]
    notes.sort(key=lambda note: note.xy)
    taken = [note.get_window_extent() for note in axis.texts if note not in notes]
    for line in axis.lines:
        path = line.get_transform().transform_path(line.get_path())
        dots = path.interpolated(1 if len(path) == 1 else CURVE_DOTS).vertices
        reach = line.get_markersize() if line.get_marker() != "None" else 1
        taken += [Bbox.from_extents(*(dot - reach), *(dot + reach)) for dot in dots]
    inside = axis.get_window_extent()
    for note in notes:
        for place in PLACES:
            note.set_position(place)
            note.set_horizontalalignment(_side(place[0], "right", "left"))
            note.set_verticalalignment(_side(place[1], "top", "bottom"))
            box = Text.get_window_extent(note).padded(1)  # without the line to its point
            free = not any(box.overlaps(other) for other in taken)
            if free and inside.contains(*box.min) and inside.contains(*box.max):
                break
        taken.append(box)


def _side(offset: float, before: str, behind: str) -> str:
    if abs(offset) < 5:
        return "center"
    return before if offset < 0 else behind
