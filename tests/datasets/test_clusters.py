"""A cluster makes the same bytes as one process, whichever of its workers die meanwhile."""

import hashlib
import os
import signal
import threading
import time

import pytest
from builders import DATA

from lf_flame import InputError
from lf_flame.datasets.clusters import cluster_executor
from lf_flame.datasets.config import config_from_json
from lf_flame.datasets.making import make_dataset
from lf_flame.datasets.store import Dataset

pytest.importorskip("distributed")
pytestmark = [
    pytest.mark.slow,
    # Dask's processes and sockets end by themselves, and some of its imports are old.
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::FutureWarning"),
]

SAMPLES = 400


@pytest.fixture(scope="module")
def config():
    return config_from_json(DATA, "here")


@pytest.fixture(scope="module")
def alone(config, tmp_path_factory):
    path = tmp_path_factory.mktemp("alone") / "a.zarr"
    make_dataset(config, SAMPLES, path)
    return hashes(path)


def hashes(path):
    """SHA-256 of every file of samples, by its place."""
    assert len(Dataset(path).targets) == SAMPLES
    return {
        str(file.relative_to(path)): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in path.rglob("*")
        if file.is_file() and file.name != "zarr.json"
    }


def test_a_local_cluster_makes_the_same_bytes(config, alone, tmp_path):
    with cluster_executor(local=2) as executor:
        make_dataset(config, SAMPLES, tmp_path / "a.zarr", executor=executor)
    assert hashes(tmp_path / "a.zarr") == alone


def test_two_local_clusters_get_along():
    with cluster_executor(local=1) as one, cluster_executor(local=1) as other:
        assert one.submit(abs, -1).result() == other.submit(abs, -1).result() == 1


def test_a_cluster_that_loses_workers_makes_the_same_bytes(config, alone, tmp_path):
    with cluster_executor(local=2) as executor:
        nannies, killed = list(executor._client.cluster.workers.values()), []

        def kill():
            for nanny in [*nannies, nannies[0]]:
                time.sleep(0.3)
                if nanny.pid is not None:
                    os.kill(nanny.pid, signal.SIGKILL)
                    killed.append(nanny.pid)

        thread = threading.Thread(target=kill)
        thread.start()
        make_dataset(config, SAMPLES, tmp_path / "a.zarr", executor=executor)
        thread.join()
    assert killed
    assert hashes(tmp_path / "a.zarr") == alone


def test_a_scheduler_that_does_not_answer_is_one_sentence(monkeypatch):
    monkeypatch.setattr("lf_flame.datasets.clusters.START_S", 1)
    with (
        pytest.raises(InputError, match=r"tcp://127\.0\.0\.1:9 does not answer"),
        cluster_executor("tcp://127.0.0.1:9"),
    ):
        pass
