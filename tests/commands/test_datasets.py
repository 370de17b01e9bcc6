"""`lf-flame dataset`: what it refuses, and the same bytes by the workers of a Dask cluster."""

import os
import signal
import threading
import time

import pytest
from builders import DATA, shapes, toml

from lf_flame import InputError
from lf_flame.commands import options as command_options
from lf_flame.commands.cli import commands
from lf_flame.commands.options import WorkerOptions
from lf_flame.datasets.config import config_from_json
from lf_flame.datasets.making import make_dataset
from lf_flame.datasets.store import Dataset

SAMPLES = 120


def test_an_image_too_small_for_the_network_is_refused_at_once(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.toml").write_text(toml(shapes(2, (30, 60), 3)))
    with pytest.raises(InputError, match=r"a.toml: .* 30 x 60 pixels, and ResNet-50 needs 32"):
        commands(["dataset", "a.toml", "--preset", "smoke", "--out", "a.zarr"])
    assert [path.name for path in tmp_path.iterdir()] == ["a.toml"]


@pytest.mark.slow
# Dask's processes and sockets end by themselves, and some of its imports are old.
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning")
@pytest.mark.filterwarnings("ignore::FutureWarning")
def test_a_cluster_that_loses_a_worker_makes_the_same_bytes(tmp_path):
    distributed = pytest.importorskip("distributed")
    config, killed = config_from_json(DATA, "here"), []
    make_dataset(config, SAMPLES, tmp_path / "alone.zarr")
    options = {"threads_per_worker": 1, "dashboard_address": "127.0.0.1:0"}
    with (
        distributed.LocalCluster(n_workers=2, **options) as cluster,
        WorkerOptions(scheduler=cluster.scheduler_address).executor() as executor,
    ):

        def kill():
            while not list(tmp_path.glob("a.zarr.part/complete/c/*")):
                time.sleep(0.01)
            killed.append(next(iter(cluster.workers.values())).pid)
            os.kill(killed[0], signal.SIGKILL)

        thread = threading.Thread(target=kill)
        thread.start()
        make_dataset(config, SAMPLES, tmp_path / "a.zarr", executor=executor)
        thread.join()
    assert killed
    assert len(Dataset(tmp_path / "a.zarr").targets) == SAMPLES
    one, other = (
        {
            file.relative_to(tmp_path / name): file.read_bytes()
            for file in (tmp_path / name).rglob("*")
            if file.is_file() and file.name != "zarr.json"
        }
        for name in ("alone.zarr", "a.zarr")
    )
    assert one == other


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")
def test_a_scheduler_without_workers_or_an_answer_is_one_sentence(monkeypatch):
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(command_options, "START_S", 1)
    with (
        pytest.raises(InputError, match=r"tcp://127\.0\.0\.1:9 does not answer"),
        WorkerOptions(scheduler="tcp://127.0.0.1:9").executor(),
    ):
        pass
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address="127.0.0.1:0") as cluster,
        pytest.raises(InputError, match="has no workers: start some with `dask worker tcp://"),
        WorkerOptions(scheduler=cluster.scheduler_address).executor(),
    ):
        pass
