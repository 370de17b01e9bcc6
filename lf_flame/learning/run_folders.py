"""Finished training runs: their records, and their networks on the test split."""

from pathlib import Path

import numpy as np

from lf_flame._common.config import read_record
from lf_flame._common.keras_loading import load_model
from lf_flame.datasets.store import Dataset, split_indices
from lf_flame.errors import InputError


def load_run(folder: str | Path) -> dict:
    """Read the record of a finished run.

    Raises
    ------
    InputError
        If the run is missing or not finished, or its record is damaged.
    """
    folder = Path(folder)
    if not (folder / "model.keras").exists() or not (folder / "run.json").exists():
        raise InputError(f"There is no finished run in {folder}; train it first.")
    return read_record(folder / "run.json")


def open_run(folder: str | Path) -> tuple[dict, Dataset]:
    """Read the record of a finished run, and open the data set that it was trained on.

    Raises
    ------
    InputError
        If the run is missing or not finished, is of something else, or the data set is no longer
        the same.
    """
    run = load_run(folder)
    if "data" not in run:
        raise InputError(f"{folder} holds no run of the paper's network.")
    dataset = Dataset(run["data"])
    if dataset.attrs["sha256"] != run["data_sha256"]:
        raise InputError(
            f"{run['data']} is not the data set that {folder} was trained on; train it again."
        )
    return run, dataset


def predict_test_split(folder: str | Path) -> tuple[Dataset, np.ndarray, np.ndarray]:
    """Run the whole trained network, backbone included, over the test split of its data set.

    Returns
    -------
    Dataset
    ndarray of int, shape (n,)
        Indices of the test samples.
    ndarray of float32, shape (n, planes, h, w)
    """
    run, dataset = open_run(folder)
    indices = np.array(run["test_indices"])
    model = load_model(Path(folder) / "model.keras")
    stack = model.predict(dataset.inputs[indices], batch_size=8, verbose=0)
    return dataset, indices, stack[..., 0]


def training_indices(samples: int, run: dict) -> np.ndarray:
    """Find the samples that a run was trained on."""
    return split_indices(samples, run["split"], run["seed"])["train"]
