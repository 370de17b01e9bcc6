"""Light fields that no network was trained on."""

from dataclasses import dataclass
from pathlib import Path

from experiments.histories import epochs_in_words
from lf_flame.datasets.config import DatasetConfig
from lf_flame.errors import InputError
from lf_flame.learning.run_folders import open_run

SAMPLES = 3
"""Light fields of each data set."""


@dataclass(frozen=True)
class HeldOut:
    """Light fields of a data set that no network was trained on, and slopes to refocus them at.

    Samples are known by their indices; the run is the folder of the network, if there is one, and
    the origin says what network it is, or why there is none.
    """

    name: str
    config: DatasetConfig
    slopes: tuple[float, ...]
    indices: tuple[int, ...]
    run: Path | None
    origin: str


def find_scenes(config: DatasetConfig, run: Path, samples: int = SAMPLES) -> HeldOut:
    """Take the test split of a finished run, or, without a run, the last samples of a preset.

    The configuration says which data set it is, and what it is made of where there is no run.
    """
    try:
        found = open_run(run)
    except InputError as error:
        count = min(config.samples.values())
        slopes = tuple(config.camera.depth_to_slope(z) for z in config.depths_mm)
        indices = tuple(range(max(count - samples, 0), count))
        return HeldOut(config.kind, config, slopes, indices, None, f"missing. {error}")
    record = found.record
    origin = (
        f"preset {record['preset']}, {epochs_in_words(record)}, backbone "
        f"{record['backbone_weights']}"
    )
    indices = tuple(record["test_indices"][:samples])
    slopes = tuple(found.slopes)
    return HeldOut(config.kind, found.config, slopes, indices, run, origin)
