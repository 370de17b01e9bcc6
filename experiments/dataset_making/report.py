"""Tables and record of the rates at which data sets are made, and of killed workers."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from pathlib import Path

import pandas as pd

from experiments.dataset_making.kills import Kill, measure_kills
from experiments.dataset_making.rates import Rate, measure_rates, summarise
from experiments.dataset_making.routes import Route, compare_routes
from experiments.paths import DATA_SETS
from lf_flame._common import provenance
from lf_flame._common.atomic_files import together, write_json, write_text
from lf_flame.datasets.config import DatasetConfig, read_config
from lf_flame.datasets.making import shard_size

MILLION = 10**6

CORES = (2, 16, 128)
"""For which the hours of a million samples are worked out."""


def run_dataset_making(
    samples: int,
    processes: int,
    rounds: int,
    kills: int,
    seed: int,
    out: Path,
    progress: Callable[[Iterable, int, int], Iterable],
    configs: Sequence[DatasetConfig] | None = None,
) -> Path:
    """Measure rates and kills, and write the report.

    Parameters
    ----------
    samples, processes, rounds : int
        See `experiments.dataset_making.rates.measure_rates`.
    kills, seed : int
        See `experiments.dataset_making.kills.measure_kills`; of the last data set.
    out : Path
        Gets ``dataset_making.json``, the record, and ``dataset_making.md``.
    progress : callable
        As `lf_flame._common.progress.step_bar`.
    configs : sequence of DatasetConfig, optional
        Default: those of the paper's data sets.

    Returns
    -------
    Path
        ``dataset_making.md``.
    """
    configs = [read_config(path) for path in DATA_SETS] if configs is None else configs
    rates = [
        rate
        for config in configs
        for rate in measure_rates(config, samples, processes, rounds, progress)
    ]
    routes = [
        route
        for config in configs
        for route in compare_routes(config, samples // 8, processes, progress)
    ]
    killed = measure_kills(configs[-1], samples, processes, kills, seed, progress)
    record = {
        "rates": [asdict(rate) for rate in rates],
        "routes": [asdict(route) for route in routes],
        "kills": [asdict(kill) for kill in killed],
        "rounds": rounds,
        "seed": seed,
        **provenance.environment(),
    }
    with together(out, last="dataset_making.md") as aside:
        write_json(aside / "dataset_making.json", record)
        write_text(aside / "dataset_making.md", text(rates, routes, killed))
    return out / "dataset_making.md"


def text(rates: Sequence[Rate], routes: Sequence[Route], kills: Sequence[Kill]) -> str:
    """Put what was measured, and what follows from it, into Markdown."""
    rows = summarise(list(rates))
    same = len({(rate.data, rate.sha256) for rate in rates}) == len({rate.data for rate in rates})
    parts = [
        "# How fast data sets are made",
        f"{rows[0]['samples']} samples; medians of the rounds, which went through the ways in "
        "turn, and in brackets the slowest and the fastest. Whole: with the start of processes and "
        "the search for the slopes. Samples/s: once as many shards are written as there are "
        "processes. One process works on all cores by its threads; each of several on one thread.",
        _rate_table(rows),
        f"All rounds and ways {'gave the same images' if same else 'did NOT give the same images'} "
        "of each data set, by their SHA-256.",
        "## A million samples",
        "Worked out from the rates above: bytes and files grow with the samples, and each core "
        "does as much as in the pool here. No such run was made.",
        _million_table(rows),
    ]
    if routes:
        parts += [
            "## Three routes to the same images",
            f"{routes[0].samples} samples by {routes[0].processes} processes, with the search for "
            "the slopes and for the number of rays. PSNR of all inputs and of all targets, against "
            "light fields in closed form.",
            _route_table(routes),
        ]
    if kills:
        hit = sum(kill.hit and kill.at_sample > 0 for kill in kills)
        spoiled = sum(not kill.same for kill in kills)
        parts += [
            "## Killed workers",
            f"A local Dask cluster of {rows[-1]['processes']} processes made the last of these "
            f"data sets {len(kills)} times; each time one of its workers was killed (SIGKILL) at "
            f"an instant drawn evenly from the time that it takes undisturbed. {hit} came after "
            f"the first shard and before the last; {spoiled} of {len(kills)} data sets differ from "
            "an undisturbed one in any byte of their samples.",
            _kill_table(kills),
        ]
    return "\n\n".join(parts) + "\n"


def _rate_table(rows: Sequence[dict]) -> str:
    shown = [
        {
            "data set": row["data"],
            "by": row["way"],
            "processes": row["processes"],
            "whole (s)": f"{row['seconds']:.1f}",
            "samples/s": f"{row['per_second']:.0f} ({row['lowest']:.0f} to {row['highest']:.0f})",
            "of the pool's": f"{100 * row['of_pool']:.0f} %",
        }
        for row in rows
    ]
    return pd.DataFrame(shown).to_markdown(index=False, disable_numparse=True)


def _route_table(routes: Sequence[Route]) -> str:
    shown = [
        {
            "data set": route.data,
            "route": route.route,
            "rays": "-" if route.rays is None else f"{route.rays} x {route.rays} a pixel",
            "whole (s)": f"{route.seconds:.1f}",
            "inputs (dB)": _decibels(route.input_psnr_db),
            "targets (dB)": _decibels(route.target_psnr_db),
        }
        for route in routes
    ]
    return pd.DataFrame(shown).to_markdown(index=False, disable_numparse=True)


def _decibels(psnr_db: float) -> str:
    return "-" if math.isinf(psnr_db) else f"{psnr_db:.1f}"


def _million_table(rows: Sequence[dict]) -> str:
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
    return pd.DataFrame(shown).to_markdown(index=False, disable_numparse=True)


def _files(row: dict, samples: int) -> int:
    """Files of a data set of another size: so many for each shard, and metadata."""
    here, there = (math.ceil(n / shard_size(n)) for n in (row["samples"], samples))
    by_shard, metadata = divmod(row["files"], here)
    return by_shard * there + metadata


def _kill_table(kills: Sequence[Kill]) -> str:
    shown = [
        {
            "killed after (s)": f"{kill.after_s:.2f}",
            "at sample": kill.at_sample,
            "worker": kill.worker,
            "made after (s)": f"{kill.seconds:.1f}",
            "bytes": "the same" if kill.same else "OTHERS",
        }
        for kill in kills
    ]
    return pd.DataFrame(shown).to_markdown(index=False, disable_numparse=True)
