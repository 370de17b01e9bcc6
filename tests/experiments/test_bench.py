"""The benchmark's rivals do the same task, its floors count all work, and its report is written."""

import math

import numpy as np
import pandas as pd
import pytest

from experiments import bench

pytestmark = [pytest.mark.slow, pytest.mark.jit]


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    return pd.DataFrame(bench.measure(small=True)["rows"])


def test_every_task_has_a_floor_and_a_rival_with_the_same_output(rows, tmp_path):
    for _, task in rows.groupby("task"):
        assert task["other"].str.startswith("floor").any()
    said = rows.groupby("task")["outputs"].unique().map(" ".join)
    assert all(float(x) <= 1e-6 for x in said["refocusing"].split() if "e-" in x)
    assert all(float(x) > 0.999 for x in said["decoding"].split() if x.startswith(("0.", "1.")))
    assert all(float(x) <= 1e-3 for x in said["rendering"].split() if "e-" in x)
    assert all(float(x) <= 1e-4 for x in said["training"].split() if "e-" in x)
    assert [x.count("e-") + x.count("correlate") > 0 for x in said] == [True] * 4
    assert (rows[["ours_ms", "other_ms", "ratio"]] > 0).all(axis=None)
    path = bench.write(tmp_path, {"threads": 2, "wall_s": 1.0, "rows": rows.to_dict("records")})
    assert "## Training" in path.read_text()
    assert {x.name for x in tmp_path.iterdir()} == {
        f"bench.{x}" for x in ("md", "csv", "json", "png")
    }


def test_outputs_that_differ_are_seen(rng):
    image = rng.random((5, 5, 9, 10), np.float32)
    assert bench.largest_difference(image, 1.01 * image) == "pixels differ by 1e-02 at most"
    assert bench.error(np.ones(4), np.full(4, 1.01)) == "rms difference 1e-02"
    assert bench.correlation(image, image[::-1]) != "views correlate by 1.0000"
    assert bench.losses(0.5, 0.505) == "losses differ by 1e-02"


def test_a_step_counts_what_adam_moves_and_the_layers_multiply():
    """By hand, for the feature map 3 x 6 x 32, two samples, and the image 9 x 18 x 4."""
    decoder = bench.build_decoder((3, 6, 32), (9, 18), 4, 0.3)
    size = sum(math.prod(x.shape) for x in decoder.trainable_variables)
    first, second, dense = 36 * 9 * 32 * 512, 36 * 9 * 512 * 256, 2 * 256 * 9 * 18 * 4
    planes = decoder.get_layer("planes")
    last = 2 * math.prod(planes.output.shape[1:-1]) * math.prod(planes.kernel.shape)
    products = 2 * first + 3 * (second + dense + last)
    assert bench.step_work(decoder, 2) == (24 * size, products)
