"""The report of how data sets are made: rates of a small one, and what follows."""

import json

import pytest
from builders import DATA

from experiments.dataset_making.rates import summarise
from experiments.dataset_making.report import body, run_dataset_making
from lf_flame.datasets.config import config_from_json


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.filterwarnings("ignore::FutureWarning")
def test_rates_are_measured_and_written(tmp_path):
    pytest.importorskip("distributed")
    config = config_from_json(DATA, "here")
    path = run_dataset_making(48, 1, 1, tmp_path, [config])
    record = json.loads((tmp_path / "dataset_making.json").read_text())
    assert [rate["way"] for rate in record["rates"]] == [
        "one process", "process pool", "Dask cluster",
    ]  # fmt: skip
    assert len({rate["sha256"] for rate in record["rates"]}) == 1
    assert all(rate["per_second"] > 0 for rate in record["rates"])
    exact, rays, direct = record["routes"]
    assert exact["target_psnr_db"] is None  # of itself
    assert rays["rays"] > 0
    # The number of rays is chosen on the mean scene, which has less contrast than any other.
    assert 50 < rays["target_psnr_db"] < direct["target_psnr_db"]
    assert "gave the same images" in path.read_text()


def rate(way, processes, per_second, sha256="a"):
    return {
        "data": "flames", "way": way, "processes": processes, "samples": 1600, "seconds": 9.0,
        "per_second": per_second, "sha256": sha256, "files": 720, "size": 1_600_000,
    }  # fmt: skip


def text(rates):
    return "\n".join(body({"rates": rates, "routes": []}))


def test_a_million_samples_follow_from_the_rates():
    """1,000 bytes and 7 files a shard; at 100 samples a second and core, 1.4 hours on 2."""
    found = text([rate("one process", 1, 110.0), rate("process pool", 2, 200.0)])
    below = found.partition("## A million samples")[2]
    line = next(line for line in below.splitlines() if "flames" in line)
    cells = [cell.strip() for cell in line.split("|")[1:-1]]
    assert cells == ["flames", "7,020", "1", "1.4", "0.17", "0.022"]


def test_rates_are_medians_beside_the_pools():
    rates = [rate("process pool", 2, value) for value in (190.0, 210.0, 200.0)]
    rates += [rate("Dask cluster", 2, value) for value in (150.0, 180.0, 500.0)]
    pool, cluster = summarise(rates)
    assert (pool["per_second"], cluster["per_second"]) == (200.0, 180.0)
    assert cluster["of_pool"] == pytest.approx(0.9)
    assert (cluster["lowest"], cluster["highest"]) == (150.0, 500.0)


def test_other_bytes_are_not_called_the_same():
    rates = [rate("one process", 1, 1.0), rate("process pool", 2, 1.0, "b")]
    assert "did NOT give the same images" in text(rates)
