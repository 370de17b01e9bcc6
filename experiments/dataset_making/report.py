"""Tables and record of the rates at which data sets are made."""

import math
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from experiments.dataset_making.rates import compare_routes, measure_rates, summarise
from experiments.paths import DATA_SETS
from experiments.report import markdown, write_report
from lf_flame.datasets.config import DatasetConfig, read_config
from lf_flame.datasets.making import shard_size

MILLION = 10**6

CORES = (2, 16, 128)
"""Numbers of cores for which the hours of a million samples are worked out."""


def _decibels(psnr_db: float | None) -> str:
    return f"{psnr_db:.1f}" if psnr_db is not None and math.isfinite(psnr_db) else "-"


RATES = {
    "data": ("data set", ""),
    "way": ("by", ""),
    "processes": ("processes", ""),
    "seconds": ("whole (s)", ".1f"),
    "rate": ("samples/s", str),
    "of_pool": ("of the pool's", lambda share: f"{100 * share:.0f} %"),
}

ROUTES = {
    "data": ("data set", ""),
    "route": ("route", ""),
    "rays": ("rays", lambda n: "-" if pd.isna(n) else f"{n:.0f} x {n:.0f} a pixel"),
    "seconds": ("whole (s)", ".1f"),
    "input_psnr_db": ("inputs (dB)", _decibels),
    "target_psnr_db": ("targets (dB)", _decibels),
}


def run_dataset_making(
    samples: int,
    processes: int,
    rounds: int,
    out: Path,
    configs: Sequence[DatasetConfig] | None = None,
) -> Path:
    """Measure rates and routes, by default of the paper's data sets, and write the report."""
    configs = [read_config(path) for path in DATA_SETS] if configs is None else configs
    record = {
        "rates": [x for one in configs for x in measure_rates(one, samples, processes, rounds)],
        "routes": [x for one in configs for x in compare_routes(one, samples // 8, processes)],
        "rounds": rounds,
    }
    return write_report(out, "dataset_making", "How fast data sets are made", record, body(record))


def body(record: dict) -> list[str]:
    """Write what was measured, and what follows from it, as Markdown."""
    rates, rows = record["rates"], summarise(record["rates"])
    same = len({(rate["data"], rate["sha256"]) for rate in rates}) == len(
        {rate["data"] for rate in rates}
    )
    parts = [
        f"{rows[0]['samples']} samples; medians of the rounds, which went through the ways in "
        "turn, and in brackets the slowest and the fastest. Whole: with the start of processes and "
        "the search for the slopes. Samples/s: once as many shards are written as there are "
        "processes. One process works on all cores by its threads; each of several on one thread.",
        markdown(rows, RATES),
        f"All rounds and ways {'gave the same images' if same else 'did NOT give the same images'} "
        "of each data set, by their SHA-256.",
        "## A million samples",
        "Worked out from the rates above: bytes and files grow with the samples, and each core "
        "does as much as in the pool here. No such run was made.",
        markdown(_million(rows)),
    ]
    routes = record.get("routes")  # which older records lack
    if routes:
        parts += [
            "## Three routes to the same images",
            f"{routes[0]['samples']} samples by {routes[0]['processes']} processes, with the "
            "search for the slopes and for the number of rays. PSNR of all inputs and of all "
            "targets, against light fields in closed form.",
            markdown(routes, ROUTES, missing="-"),
        ]
    return parts


def _million(rows: Sequence[dict]) -> list[dict]:
    """Work out files, bytes and hours of a million samples."""
    shown = []
    for data in dict.fromkeys(row["data"] for row in rows):
        one, pool = (
            next(row for row in rows if (row["data"], row["way"]) == (data, way))
            for way in ("one process", "process pool")
        )
        by_core = pool["per_second"] / pool["processes"]
        line = {
            "data set": data,
            "files": f"{_files(one, MILLION):,}",
            "GB": f"{one['size'] / one['samples'] * MILLION / 1e9:.0f}",
        }
        for cores in CORES:
            line[f"hours, {cores} cores"] = f"{MILLION / (by_core * cores) / 3600:.2g}"
        shown.append(line)
    return shown


def _files(row: dict, samples: int) -> int:
    """Files of a data set of another size: so many for each shard, and metadata."""
    here, there = (math.ceil(n / shard_size(n)) for n in (row["samples"], samples))
    by_shard, metadata = divmod(row["files"], here)
    return by_shard * there + metadata
