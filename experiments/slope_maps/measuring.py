"""How far slope maps are off, on scenes whose slopes their geometry tells."""

import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pandas as pd

from experiments.slope_maps.rivals import WAYS
from experiments.slope_maps.scenes import (
    CAMERA,
    KINDS,
    NOISE,
    SLOPES,
    Kind,
    Sample,
    make_sample,
    with_noise,
)
from lf_flame._common.config import to_json
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.refocus.focus_map import MAP_STEPS

SEEDS = (1, 2)
"""Of the scenes of each kind; the map's numbers were chosen on others."""

MARGIN = 0.3
"""By how much the search reaches beyond the scenes."""

WRONG = 0.07
"""Error beyond which a pixel is wrong (4D Light Field Benchmark)."""

SCORES = ("mse_x100", "wrong_percent", "certain_percent", "wrong_of_certain_percent")

ALL = "all"
"""In place of a kind or a noise: the mean over them."""


def score(slope: np.ndarray, certain: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Compare a map with the truth.

    Returns
    -------
    dict
        ``mse_x100``, a hundred mean squared errors; ``wrong_percent``, pixels that are off by more
        than 0.07; ``certain_percent``; ``wrong_of_certain_percent``, NaN where none is certain.
    """
    error = np.abs(slope - truth)
    wrong = error > WRONG
    of_certain = 100 * wrong[certain].mean() if certain.any() else np.nan
    values = 100 * np.mean(error**2), 100 * wrong.mean(), 100 * certain.mean(), of_certain
    return dict(zip(SCORES, map(float, values), strict=True))


def measure(
    progress: Callable | None = None,
    kinds: Mapping[str, Kind] = KINDS,
    seeds: Sequence[int] = SEEDS,
    camera: PlenopticCamera = CAMERA,
) -> tuple[dict, Sample]:
    """Make and score maps of all scenes in all ways.

    Parameters
    ----------
    progress : callable, optional
        Passes on an iterable of steps, given how many are done and how many there are.
    kinds, seeds, camera : optional

    Returns
    -------
    dict
        The record; in ``rows`` one for each way, kind and noise, means over the seeds; and for
        each way one of all.
    Sample
        The first of the last kind, with noise, for a picture.
    """
    started = time.perf_counter()
    scenes = [(name, seed) for name in kinds for seed in seeds]
    rows, shown = [], None
    for name, seed in progress(scenes, 0, len(scenes)) if progress else scenes:
        clean = make_sample(kinds[name], seed, camera)
        noisy = with_noise(clean, NOISE, seed)
        for noise, sample in ((0.0, clean), (NOISE, noisy)):
            rows += [{"scene": name, "noise": noise, **row} for row in _rows(sample)]
        shown = noisy if seed == seeds[0] else shown
    record = {
        "camera": to_json(camera),
        "slopes": list(search_slopes()[[0, -1]]),
        "steps": MAP_STEPS,
        "seeds": list(seeds),
        "wall_s": time.perf_counter() - started,
        "rows": _means(pd.DataFrame(rows)).to_dict("records"),
    }
    return record, shown


def search_slopes() -> np.ndarray:
    """Give the slopes that every way searches."""
    return np.linspace(SLOPES[0] - MARGIN, SLOPES[1] + MARGIN, MAP_STEPS)


def _rows(sample: Sample) -> list[dict]:
    rows = []
    for name, way in WAYS.items():
        start = time.perf_counter()
        slope, certain = way(sample.views, search_slopes())
        seconds = time.perf_counter() - start
        rows.append({"map": name, **score(slope, certain, sample.slopes), "seconds": seconds})
    return rows


def _means(table: pd.DataFrame) -> pd.DataFrame:
    """Means over the seeds; and over all, for each way, at the end."""
    keys, values = ["map", "scene", "noise"], [*SCORES, "seconds"]
    each = table.groupby(keys, sort=False)[values].mean().reset_index()
    each["noise"] = each["noise"].map("{:g}".format)
    whole = table.groupby("map", sort=False)[values].mean().reset_index()
    whole["scene"] = whole["noise"] = ALL
    return pd.concat([each, whole], ignore_index=True)[keys + values]
