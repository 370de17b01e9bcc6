"""Table, text and figure of the latency of trained networks (`experiments.costs.latency`)."""

import math
from pathlib import Path
from textwrap import shorten

import pandas as pd

from experiments.costs.latency import STAGES, WHOLE, columns
from experiments.costs.precision import REFERENCE
from experiments.histories import recipe_in_words
from experiments.report import markdown, write_report
from lf_flame._common.figures import subplots

COLOURS = {"resize": "#999999", "backbone": "#56B4E9", "decoder": "#E69F00"}
"""Colours of the stages, told apart by colour-blind readers as well."""

FLOOR_COLOUR = "#D55E00"

WHOLE_LABEL = "in one go, with quartiles"
FLOOR_LABEL = "floor: weights and raw image read once"

LABELS = {"int8": "int8 (dense layers)"}
"""Precisions that not all layers have."""


def _psnr(value: float) -> str:
    return "missing" if math.isnan(value) else "same" if math.isinf(value) else f"{value:.1f}"


COLUMNS = {
    "network": ("network", ""),
    "precision": ("precision", ""),
    "compiler": ("compiler", ""),
    **{f"{stage}_shown": (f"{stage} (ms)", str) for stage in STAGES},
    f"{WHOLE}_shown": ("in one go (ms)", str),
    "times_floor": ("x floor", ".1f"),
    "weights_mb": ("weights (MB)", ".1f"),
    "psnr_db": ("PSNR to float32 (dB)", _psnr),
    "truth_psnr_db": ("to the truth (dB)", ".2f"),
}
"""Headings and formats of the table."""


def write(out: Path, record: dict) -> Path:
    """Write ``latency.*`` from the record of `experiments.costs.latency.measure_latency`."""
    return write_report(
        out, "latency", "Latency of one picture", record, body(record),
        tables={"latency": pd.DataFrame(record["ways"])}, pictures={"latency": figure(record)},
    )  # fmt: skip


def table_of(record: dict) -> pd.DataFrame:
    """Give the variants of a record, in which JSON knows no infinity."""
    table = pd.DataFrame(record["ways"])
    numbers = [name for name in table if name.endswith(("_ms", "_mb", "_db", "floor"))]
    table[numbers] = table[numbers].astype(float)
    same = table["psnr_db"].isna() & (table["missing"] == "")
    table["psnr_db"] = table["psnr_db"].mask(same, math.inf)
    for stage in (*STAGES, WHOLE):
        quartiles = table[list(columns(stage))].itertuples(index=False)
        table[f"{stage}_shown"] = [
            "missing" if math.isnan(row[0]) else "{:.1f} ({:.1f}-{:.1f})".format(*row)
            for row in quartiles
        ]
    return table


def body(record: dict) -> list[str]:
    """Write the table, and in words what it says, as Markdown."""
    table = table_of(record)
    known = table.loc[table["computes"] != "", ["precision", "computes"]].drop_duplicates()
    shown = table.assign(precision=table["precision"].replace(LABELS))
    return [
        "## What was measured",
        "\n".join(_network_line(*one) for one in record["networks"].items()),
        f"""From a raw lenslet image in memory (random, float32) to refocused images in memory, at
batch 1, by a network that is loaded and compiled. Resize: area averaging to the network's size;
backbone and decoder: with copying in and out. In one go: resize, then the whole network, as a user
runs it, with no copying in between. Median, and in brackets the quartiles, of {record["repeats"]}
rounds; in each every row goes once stage by stage and once in one go.
Floor: reading weights and raw image from memory once, at {record["bandwidth_gb_s"]:.3g} GB/s, the
best measured in this run.""",
        """PSNR (peak 1, over all images): against what float32 in its first row makes of the same
inputs; and against the truth, which only a run folder's test inputs have.""",
        "\n".join(f"- {precision}: {computes}." for precision, computes in known.to_numpy()),
        "## What it says",
        "\n".join(f"- {_finding(rows)}" for _, rows in table.groupby("network", sort=False)),
        "## All variants",
        markdown(shown, COLUMNS, missing="missing"),
    ]


def _network_line(label: str, network: dict) -> str:
    height, width = network["raw_pixels"]
    rows, cols = network["image"]
    return (
        f"- {label}: “{network['title']}” ({network['preset']}), backbone weights "
        f"{network['backbone_weights']}; raw image of {height} x {width} pixels "
        f"({network['raw_mb']:.3g} MB) to {network['planes']} images of {rows} x {cols}; compared "
        f"on {network['compared_on']}."
    )


def fastest(rows: pd.DataFrame) -> pd.DataFrame:
    """Select each precision's fastest variant in one go; a missing one if all are."""
    ranked = rows.sort_values(f"{WHOLE}_ms", kind="stable", na_position="last")
    return ranked.groupby("precision", sort=False).head(1).sort_index()


def _finding(rows: pd.DataFrame) -> str:
    """Say where the time goes, and what fewer bits buy."""
    variants = fastest(rows)
    first = variants[variants["precision"] == REFERENCE].iloc[0]
    if first["missing"]:
        return f"{first['network']}: missing. {first['missing']}."
    total = sum(first[f"{stage}_ms"] for stage in STAGES)
    shares = ", ".join(f"{stage} {first[f'{stage}_ms'] / total:.0%}" for stage in STAGES)
    said = [
        f"{first['network']}: {REFERENCE} ({first['compiler']}) takes {first[f'{WHOLE}_ms']:.3g} "
        f"ms, {first['times_floor']:.2g} times its floor of {first['floor_ms']:.3g} ms ({shares})."
    ]
    for variant in variants[variants["precision"] != REFERENCE].to_dict("records"):
        said.append(_against(variant, first))
    return " ".join(said)


def _against(variant: dict, first: pd.Series) -> str:
    """Set a precision beside float32; no difference where the quartiles overlap."""
    if variant["missing"]:
        return f"{variant['precision']} is missing: {variant['missing']}."
    ms, least = variant[f"{WHOLE}_ms"], first[f"{WHOLE}_ms"]
    _, low, high = columns(WHOLE)
    apart = variant[high] < first[low] or variant[low] > first[high]
    pace = f"{ms / least:.2f} times as long" if apart else "as long, within the quartiles"
    truth = variant["truth_psnr_db"] - first["truth_psnr_db"]
    cost = "" if math.isnan(truth) else f", which moves that against the truth by {truth:+.2f} dB"
    return (
        f"{variant['precision']} ({variant['compiler']}) takes {pace} ({ms:.3g} ms), at "
        f"{variant['psnr_db']:.1f} dB to {REFERENCE}{cost}."
    )


def figure(record: dict):
    """Draw the stages as bars, one for each precision, compiled in the variant that is fastest."""
    table = table_of(record)
    groups = [(label, fastest(rows)) for label, rows in table.groupby("network", sort=False)]
    heights = [len(variants) for _, variants in groups]
    picture, axes = subplots(
        len(groups), 1, figsize=(11, 2.0 + 0.62 * sum(heights) + 0.7 * len(groups)), sharex=True,
        squeeze=False, layout="constrained", height_ratios=heights,
    )  # fmt: skip
    reach = max(_reach(variants) for _, variants in groups)
    for axis, (label, variants) in zip(axes[:, 0], groups, strict=True):
        axis.set_title(_title(record["networks"][label]), fontsize=10, loc="left", parse_math=False)
        _draw_variants(axis, variants, reach)
    axes[-1, 0].set_xlim(0, 1.5 * reach)  # the words stand behind the longest bar
    axes[-1, 0].set_xlabel("milliseconds (median)")
    picture.suptitle(
        "From a raw lenslet image in memory to the refocused images, batch 1\n"
        f"{record['repeats']} rounds; each precision by its fastest compiler",
        fontsize=12,
    )
    *lines, floor = _legend_order(axes[0, 0])
    legend = picture.legend(
        handles=[*lines, floor], loc="outside lower center", ncols=5, frameon=False
    )
    legend.legend_handles[-1].set_markersize(12)
    return picture


def _title(network: dict) -> str:
    height, width = network["raw_pixels"]
    rows, cols = network["image"]
    depth = network["backbone_weights"].rpartition(", ")[2]
    return (
        f"{network['title']}, {recipe_in_words(network['preset'])}, backbone up to {depth}: "
        f"{height} x {width} pixels to {network['planes']} images of {rows} x {cols}"
    )


def _legend_order(axis) -> list:
    """Stages first, then the whole, then the floor."""
    handles, labels = axis.get_legend_handles_labels()
    first = dict(zip(labels, handles, strict=True))
    floor = first.pop(FLOOR_LABEL)
    whole = first.pop(WHOLE_LABEL)
    return [*first.values(), whole, floor]


def _reach(variants: pd.DataFrame) -> float:
    """Where the longest bar or whisker ends; 1 where all are missing."""
    sums = variants[[f"{stage}_ms" for stage in STAGES]].sum(axis=1)
    return max(sums.max(), variants[columns(WHOLE)[2]].fillna(0.0).max()) or 1.0


def _draw_variants(axis, variants: pd.DataFrame, reach: float) -> None:
    at = range(len(variants))
    left = pd.Series(0.0, variants.index)
    for stage in STAGES:
        lengths = variants[f"{stage}_ms"].fillna(0.0)
        axis.barh(at, lengths, 0.62, left, color=COLOURS[stage], label=stage)
        left = left + lengths
    middle, low, high = (variants[name] for name in columns(WHOLE))
    axis.errorbar(
        middle, at, xerr=(middle - low, high - middle), fmt="D", color="black", markersize=5,
        capsize=4, label=WHOLE_LABEL,
    )  # fmt: skip
    axis.plot(
        variants["floor_ms"], at, "|", color=FLOOR_COLOUR, markersize=26, markeredgewidth=2.5,
        label=FLOOR_LABEL,
    )  # fmt: skip
    for place, variant in zip(at, variants.to_dict("records"), strict=True):
        start = 0.01 * reach if variant["missing"] else 1.03 * reach
        axis.text(start, place, _caption(variant), va="center", fontsize=9, parse_math=False)
    labels = [
        f"{LABELS.get(x.precision, x.precision)}\n{x.compiler}" for x in variants.itertuples()
    ]
    axis.set_yticks(at, labels)
    axis.set_ylim(len(variants) - 0.5, -0.5)
    axis.grid(axis="x", alpha=0.25)
    axis.set_axisbelow(True)


def _caption(variant: dict) -> str:
    """Total, floor, distance from float32, weights."""
    if variant["missing"]:
        return f"missing: {shorten(variant['missing'], 100)}"
    reference = variant["precision"] == REFERENCE
    images = "the reference" if reference else f"{variant['psnr_db']:.1f} dB to {REFERENCE}"
    return (
        f"{variant[f'{WHOLE}_ms']:.1f} ms, {variant['times_floor']:.1f} x floor\n"
        f"{images}, weights {variant['weights_mb']:.0f} MB"
    )
