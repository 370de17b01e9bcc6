"""Finished training runs: their records and networks.

A run is self-contained: its record has the part of the data set's description that its network
needs for use, so that the data set may be elsewhere, or deleted.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lf_flame._common.config import build
from lf_flame._common.input_files import read_record
from lf_flame.datasets.config import DatasetConfig, config_from_json
from lf_flame.datasets.store import Dataset
from lf_flame.errors import InputError
from lf_flame.learning.keras_loading import load_model

if TYPE_CHECKING:
    import keras


@dataclass(frozen=True)
class RunRecord:
    """Required content of a run's record; that of the paper's network has no `system`."""

    epochs: int
    train_s: float
    system: str | None = None


@dataclass(frozen=True)
class DatasetFacts:
    """Content of a run's record on its data set, see `describe_dataset`."""

    config: dict[str, Any]
    slopes: list[float]
    objects: list[str]


@dataclass(frozen=True)
class PaperRunRecord:
    """Further required content of the record of a finished run of the paper's network."""

    title: str
    preset: str
    seed: int
    best_epoch: int
    recipe: dict[str, Any]
    machine: str
    backbone_weights: str
    model: dict[str, Any]
    split: tuple[float, float, float]
    parts: dict[str, int]
    test_indices: list[int]
    data: str
    dataset: DatasetFacts

    def __post_init__(self):
        if min(self.test_indices, default=-1) < 0 or not {"train", "test"} <= self.parts.keys():
            raise InputError("test_indices must be samples, and parts contain train and test.")
        if not all(0 < share < 1 for share in self.split):
            raise InputError(f"split must be three fractions between 0 and 1, got {self.split}.")
        if "batch_size" not in self.recipe:
            raise InputError("recipe.batch_size is missing.")


@dataclass(frozen=True, eq=False)
class TrainedRun:
    """A finished run of the paper's network: its record, and the description of its data set.

    `slopes`, in lenslets per view step, and `objects` have an entry for each refocused image.
    """

    folder: Path
    record: dict
    config: DatasetConfig
    slopes: list[float]
    objects: list[str]

    @property
    def data(self) -> Path:
        """Path of the data set when the network was trained."""
        return (self.folder / self.record["data"]).resolve()

    def load_network(self) -> "keras.Model":
        """Load the network; see `lf_flame.learning.keras_loading.load_model`."""
        shown, image = self.config.input.shape(self.config.image), self.config.image
        shapes = shown, (len(self.slopes), *image, 1)
        return load_model(self.folder / "model.keras", shapes)

    def open_dataset(self) -> Dataset:
        """Open the data set; refuse one that is missing or has changed."""
        dataset = Dataset(self.data)
        same = describe_dataset(dataset) == self.record["dataset"]
        if not same or max(self.record["test_indices"]) >= len(dataset):
            raise InputError(
                f"{self.data} is not the data set that {self.folder} was trained on; "
                f"train it again."
            )
        return dataset

    def predict_test_split(self) -> tuple[Dataset, np.ndarray, np.ndarray]:
        """Return the data set, indices [n] of its test samples, and images [n, planes, h, w]."""
        dataset, indices = self.open_dataset(), np.array(self.record["test_indices"])
        stack = self.load_network().predict(dataset.inputs[indices], batch_size=8, verbose=0)
        return dataset, indices, stack[..., 0]


def describe_dataset(dataset: Dataset) -> dict:
    """Part of a data set's description that its network needs for use, as JSON values."""
    names = ("config", "slopes", "objects")
    return {name: dataset.attrs[name] for name in names}


def load_run(folder: str | Path) -> dict:
    """Read the record of any run with a network; refuse a missing or damaged one."""
    folder = Path(folder)
    if not (folder / "model.keras").exists() or not (folder / "run.json").exists():
        raise InputError(f"There is no finished run in {folder}; train it first.")
    record = read_record(folder / "run.json")
    build(RunRecord, record, folder / "run.json")
    return record


def open_run(folder: str | Path) -> TrainedRun:
    """Read a finished run of the paper's network.

    Parameters
    ----------
    folder : str or Path
        Run folder, as `train` fills it.

    Returns
    -------
    TrainedRun

    Raises
    ------
    InputError
        If the run is missing, has no network or not the paper's, or its record is damaged.
    """
    folder, record = Path(folder), load_run(folder)
    if "data" not in record:
        held = f"a run of the system {record.get('system')}" if record.get("system") else "no run"
        raise InputError(
            f"{folder} contains {held}; it must be of the paper's network, by `lf-flame train`."
        )
    source = folder / "run.json"
    known = build(PaperRunRecord, record, source).dataset
    config = config_from_json(known.config, f"{source}: dataset")
    if not len(known.slopes) == len(known.objects) == len(config.depths_mm):
        raise InputError(f"{source}: slopes and objects must be as many as the depths of its data.")
    return TrainedRun(folder, record, config, known.slopes, known.objects)
