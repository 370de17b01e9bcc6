"""Errors of slope maps, on scenes whose slopes follow from their geometry."""

import time
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from experiments.command_parts import step_bar
from experiments.slope_maps.rivals import WAYS
from experiments.slope_maps.scenes import (
    KINDS,
    REPORTED,
    SIZE,
    SLOPES,
    TUNED,
    Kind,
    Sample,
    make_sample,
    photographs,
)
from lf_flame.refocus.focus_map import MAP_STEPS

SEEDS = (11, 12, 13, 14)
"""Seeds of the scenes of each kind; the map's numbers were chosen with others."""

MARGIN = 0.3
"""Slope by which the search reaches beyond the scenes."""

WRONG = 0.07, 0.03, 0.01
"""Errors beyond which a pixel is wrong (4D Light Field Benchmark)."""

SCORES = ("bad_07", "bad_03", "bad_01", "mse_x100", "certain_percent", "bad_07_of_certain")

WORST = "worst_bad_07_of_certain"
"""The last of these in the worst scene."""

ALL = "all"
"""In place of a kind: the mean over all with a true slope."""


def score(slope: np.ndarray, certain: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Compare a map with the truth.

    Percent of pixels that are off by more than 0.07, 0.03 and 0.01; a hundred mean squared errors;
    percent of certain pixels, and percent of these that are off by more than 0.07. NaN where there
    is no truth, or no certain pixel.
    """
    error = np.abs(slope - truth)
    known = np.isfinite(truth).all()
    bad = [100 * np.mean(error > wrong) if known else np.nan for wrong in WRONG]
    of_certain = np.mean(error[certain] > WRONG[0]) if known and certain.any() else np.nan
    values = *bad, 100 * np.mean(error**2), 100 * certain.mean(), 100 * of_certain
    return dict(zip(SCORES, map(float, values), strict=True))


def measure(kinds: Mapping[str, Kind] = KINDS, seeds: Sequence[int] = SEEDS) -> tuple[dict, dict]:
    """Make and score maps of all scenes by all methods.

    Returns the record, in ``rows`` one for each method and kind, means over the seeds, and for each
    method one of all; and for the first scene of each kind the sample and the slopes by each
    method.
    """
    for way in WAYS.values():  # whatever is compiled
        way(np.zeros((3, 3, 40, 40), np.float32), search_slopes())
    started = time.perf_counter()
    scenes = [(name, seed) for name in kinds for seed in seeds]
    pictures = photographs(REPORTED)
    rows, shown = [], {}
    for name, seed in step_bar(scenes):
        sample = make_sample(kinds[name], seed, pictures)
        some, maps = _rows(sample)
        rows += [{"scene": name, **row} for row in some]
        shown.setdefault(name, (sample, maps))
    record = {
        "size": list(SIZE),
        "slopes": list(search_slopes()[[0, -1]]),
        "steps": MAP_STEPS,
        "seeds": list(seeds),
        "photographs": list(REPORTED),
        "tuned_on": list(TUNED),
        "wall_s": time.perf_counter() - started,
        "rows": _means(pd.DataFrame(rows)).to_dict("records"),
    }
    return record, shown


def search_slopes() -> np.ndarray:
    """Slopes that every method searches."""
    return np.linspace(SLOPES[0] - MARGIN, SLOPES[1] + MARGIN, MAP_STEPS)


def _rows(sample: Sample) -> tuple[list[dict], dict[str, np.ndarray]]:
    rows, maps = [], {}
    views = sample.views.astype(np.float32) / np.float32(255)
    for name, way in WAYS.items():
        start = time.perf_counter()
        maps[name], certain = way(views, search_slopes())
        seconds = time.perf_counter() - start
        rows.append({"map": name, **score(maps[name], certain, sample.slopes), "seconds": seconds})
    return rows, maps


def _means(table: pd.DataFrame) -> pd.DataFrame:
    """Means over the seeds, and the worst of them; at the end those over all with a truth."""
    keys, certain = ["scene", "map"], SCORES[-1]
    ways = {name: (name, "mean") for name in (*SCORES, "seconds")} | {WORST: (certain, "max")}
    each = table.groupby(keys, sort=False).agg(**ways).reset_index()
    known = table[table[certain].notna()]
    whole = known.groupby("map", sort=False).agg(**ways).reset_index().assign(scene=ALL)
    return pd.concat([each, whole], ignore_index=True)[[*keys, *SCORES, WORST, "seconds"]]
