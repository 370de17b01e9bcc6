import shutil
from pathlib import Path

import pytest
from builders import DATA, toml

from lf_flame.datasets.config import read_config
from lf_flame.datasets.making import make_dataset


@pytest.fixture(scope="session")
def whole(tmp_path_factory):
    """A data set of three samples, and its configuration beside it."""
    folder = tmp_path_factory.mktemp("data")
    (folder / "a.toml").write_text(toml(DATA))
    make_dataset(read_config(folder / "a.toml"), 3, folder / "a.zarr")
    return folder / "a.zarr"


@pytest.fixture
def path(whole, tmp_path):
    """A copy of the data set that a test may damage."""
    return Path(shutil.copytree(whole, tmp_path / "a.zarr"))
