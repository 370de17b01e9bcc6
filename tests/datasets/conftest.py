import shutil
from pathlib import Path

import pytest
from builders import DATA, shapes

from lf_flame.datasets.config import config_from_json
from lf_flame.datasets.making import make_dataset


@pytest.fixture
def tiny():
    """Two shapes in images of 8 x 12 pixels, 3 x 3 lenslets in each."""
    values = shapes(5, (8, 12), 5, coarser=5, sides_mm=(6.0, 6.0), off_axis_mm=5.5)
    values["camera"]["lenslets"] = [24, 36]
    return config_from_json(values, "here")


@pytest.fixture(scope="session")
def whole(tmp_path_factory):
    """A data set of three samples."""
    path = tmp_path_factory.mktemp("data") / "a.zarr"
    make_dataset(config_from_json(DATA, "here"), 3, path)
    return path


@pytest.fixture
def path(whole, tmp_path):
    """A copy of the data set that a test may damage."""
    return Path(shutil.copytree(whole, tmp_path / "a.zarr"))


@pytest.fixture
def samples_of():
    """Function that gives the bytes of every file of samples of a data set, by its place."""

    def read(folder):
        files = [file for file in folder.rglob("*") if file.is_file() and file.name != "zarr.json"]
        return {file.relative_to(folder).as_posix(): file.read_bytes() for file in files}

    return read
