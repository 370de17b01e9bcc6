"""The benchmark's rivals do the same task, its floors count all work, and its report is written."""

import numpy as np
import pandas as pd
import pytest

from experiments import bench

pytestmark = [pytest.mark.slow, pytest.mark.jit]


@pytest.fixture(scope="module")
def rows():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench, "STEPS", 3)
        return pd.DataFrame(bench.measure(small=True)["rows"])


def test_every_task_has_a_floor_and_a_rival_with_the_same_output(rows, tmp_path):
    for _, task in rows.groupby("task"):
        assert task["other"].str.startswith("floor").any()
    said = rows.groupby("task")["outputs"].unique().map(" ".join)
    assert all(float(x) <= 1e-6 for x in said["refocusing"].split() if "e-" in x)
    assert all(float(x) > 0.999 for x in said["decoding"].split() if x.startswith(("0.", "1.")))
    assert all(float(x) <= 1e-3 for x in said["rendering"].split() if "e-" in x)
    assert all(float(x) <= 1e-4 for x in said["training"].split() if "e-" in x)
    assert all("differ" in x or "correlate" in x for x in said)
    assert (rows[["ours_ms", "other_ms", "ratio"]] > 0).all(axis=None)
    path = bench.write(tmp_path, {"threads": 2, "wall_s": 1.0, "rows": rows.to_dict("records")})
    assert "## Training" in path.read_text()
    assert {x.name for x in tmp_path.iterdir()} == {f"bench.{x}" for x in ("md", "csv", "json")}


def test_outputs_that_differ_are_seen(rng):
    image = rng.random((5, 5, 9, 10), np.float32)
    assert bench.largest_difference(image, 1.01 * image) == "differ by 1e-02 at most"
    assert bench.error(np.ones(4), np.full(4, 1.01)) == "rms difference 1e-02"
    assert bench.correlation(image, image[::-1]) != "views correlate by 1.0000"
    assert bench.largest_difference(0.5, 0.505) == "differ by 1e-02 at most"
