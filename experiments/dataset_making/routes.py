"""Seconds of each route to a data set's images, and distance from the exact images."""

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from lf_flame.datasets.config import DatasetConfig
from lf_flame.datasets.making import make_dataset
from lf_flame.datasets.store import Dataset

ROUTES = ("exact", "rays", "direct")
"""In closed form through a light field, which the others are held against; by traced rays through a
light field; straight from the scene."""


@dataclass(frozen=True)
class Route:
    """A data set that was made by one route.

    Attributes
    ----------
    data, route : str
    samples, processes : int
    rays : int or None
        Rays per pixel along each axis; None where none are traced.
    seconds : float
        Whole, with the search for the slopes and, by rays, for their number.
    input_psnr_db, target_psnr_db : float
        PSNR of all images against those of the exact route; infinite for itself.
    """

    data: str
    route: str
    samples: int
    processes: int
    rays: int | None
    seconds: float
    input_psnr_db: float
    target_psnr_db: float


def compare_routes(
    config: DatasetConfig,
    samples: int,
    processes: int,
    progress: Callable[[Iterable, int, int], Iterable],
) -> list[Route]:
    """Make a data set by each of `ROUTES`.

    Parameters
    ----------
    config : DatasetConfig
    samples, processes : int
    progress : callable
        Passes on an iterable of steps, given how many are done and how many there are.

    Returns
    -------
    list of Route
    """
    found = []
    with TemporaryDirectory() as folder:
        exact = None
        for name in progress(ROUTES, 0, len(ROUTES)):
            path, started = Path(folder) / f"{name}.zarr", time.perf_counter()
            make_dataset(replace(config, route=name), samples, path, processes)
            seconds, made = time.perf_counter() - started, Dataset(path)
            exact = made if exact is None else exact
            psnr = [
                _psnr(some[:], best[:])
                for some, best in ((made.inputs, exact.inputs), (made.targets, exact.targets))
            ]
            rays = made.attrs.get("rays")
            found.append(Route(config.kind, name, samples, processes, rays, seconds, *psnr))
    return found


def _psnr(images: np.ndarray, exact: np.ndarray) -> float:
    error = np.square(images - exact, dtype=np.float64).mean()
    return float(-10 * np.log10(error)) if error > 0 else np.inf
