"""Finished training runs: their records, and their networks on the test split.

A run stands alone: its record says of the data set what its network needs to be used, so that the
data set may lie elsewhere, or be gone. Only scores on the test split need the data set itself.
"""

from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile, ZipFile

import numpy as np

from lf_flame._common.checksums import file_sha256
from lf_flame._common.input_files import read_record
from lf_flame._common.keras_loading import load_model
from lf_flame.datasets.config import DatasetConfig, config_from_json
from lf_flame.datasets.split import split_indices
from lf_flame.datasets.store import Dataset
from lf_flame.errors import InputError


@dataclass(frozen=True, eq=False)
class TrainedRun:
    """A finished run of the paper's network, and what it was trained on.

    Attributes
    ----------
    folder : Path
    record : dict
    config : DatasetConfig
        Of the data set.
    slopes : list of float
        Of the planes, in lenslets per view step.
    objects : list of str
        What stood at the depths of the planes.
    """

    folder: Path
    record: dict
    config: DatasetConfig
    slopes: list[float]
    objects: list[str]

    @property
    def data(self) -> Path:
        """Where the data set was when the network was trained."""
        return _data_of(self.folder, self.record)

    def open_dataset(self) -> Dataset:
        """Open the data set.

        Raises
        ------
        InputError
            If it is no longer there, or no longer the same.
        """
        dataset = Dataset(self.data)
        if dataset.attrs["sha256"] != self.record["data_sha256"]:
            raise InputError(
                f"{self.data} is not the data set that {self.folder} was trained on; "
                f"train it again."
            )
        return dataset


def _data_of(folder: Path, record: dict) -> Path:
    stated = Path(record["data"])  # in older records from the working folder
    beside = folder / stated
    return beside if beside.exists() or not stated.exists() else stated


def describe_dataset(dataset: Dataset) -> dict:
    """Keep, for a run's record, what its network needs to be used: JSON values."""
    names = ("config", "slopes", "objects")
    return {name: dataset.attrs[name] for name in names}


def load_run(folder: str | Path) -> dict:
    """Read the record of a finished run, of whatever network.

    Raises
    ------
    InputError
        If the run is missing or not finished, its record is damaged, or its network is not the
        one that the record was written for.
    """
    folder = Path(folder)
    if not (folder / "model.keras").exists() or not (folder / "run.json").exists():
        raise InputError(f"There is no finished run in {folder}; train it first.")
    record = read_record(folder / "run.json")
    if not is_whole(folder / "model.keras", record.get("model_sha256")):
        raise InputError(
            f"{folder / 'model.keras'} is not the network that run.json was written for; train it "
            f"again: what is there goes on."
        )
    return record


def is_whole(model: Path, sha256: str | None) -> bool:
    """Whether a network is the one that was written, by its hash; older records know none."""
    if sha256 is not None:
        return file_sha256(model) == sha256
    try:
        with ZipFile(model) as archive:
            return archive.testzip() is None
    except BadZipFile:
        return False


def open_run(folder: str | Path) -> TrainedRun:
    """Read a finished run of the paper's network.

    Raises
    ------
    InputError
        If the run is missing or not finished, is of something else, or its record is damaged; or,
        of a run whose record does not say what it was trained on, if its data set is gone.
    """
    folder, record = Path(folder), load_run(folder)
    if "data" not in record:
        raise InputError(f"{folder} holds no run of the paper's network.")
    known = record.get("dataset")
    if known is None:  # a run from before records said so
        known = describe_dataset(Dataset(_data_of(folder, record)))
    try:
        config = config_from_json(known["config"], folder / "run.json")
        return TrainedRun(folder, record, config, list(known["slopes"]), list(known["objects"]))
    except (KeyError, TypeError, AttributeError):
        raise InputError(f"{folder / 'run.json'} is damaged; train the network again.") from None


def predict_test_split(folder: str | Path) -> tuple[Dataset, np.ndarray, np.ndarray]:
    """Run the whole trained network, backbone included, over the test split of its data set.

    Returns
    -------
    Dataset
    ndarray of int, shape (n,)
        Indices of the test samples.
    ndarray of float32, shape (n, planes, h, w)
    """
    run = open_run(folder)
    dataset, indices = run.open_dataset(), np.array(run.record["test_indices"])
    model = load_model(run.folder / "model.keras")
    stack = model.predict(dataset.inputs[indices], batch_size=8, verbose=0)
    return dataset, indices, stack[..., 0]


def training_indices(samples: int, run: dict) -> np.ndarray:
    """Find the samples that a run was trained on."""
    return split_indices(samples, run["split"], run["seed"])["train"]
