from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from lf_flame import InputError
from lf_flame.evaluation import (
    COLUMNS,
    compare_with_paper,
    load_run,
    psnr,
    read_tables,
    score,
    ssim,
    table_markdown,
)
from lf_flame.paper import read_paper_values

PAPER = Path(__file__).parents[1] / "experiments" / "paper_values.toml"


def test_psnr_is_the_papers_equation_7(rng):
    truth = rng.uniform(size=(20, 30))
    image = truth + rng.normal(scale=0.02, size=truth.shape)
    assert psnr(truth, image) == pytest.approx(10 * np.log10(1 / np.mean((truth - image) ** 2)))
    assert psnr(truth, truth) == np.inf


def test_ssim_of_flat_images_is_its_luminance_term():
    """No structure: (2 m1 m2 + c1) / (m1^2 + m2^2 + c1), c1 = 0.01^2."""
    flat = np.full((20, 30), 0.4), np.full((20, 30), 0.5)
    expected = (2 * 0.4 * 0.5 + 1e-4) / (0.4**2 + 0.5**2 + 1e-4)
    assert ssim(*flat) == pytest.approx(expected, rel=1e-6)
    assert ssim(flat[0], flat[0]) == pytest.approx(1)


def test_scores_are_means_and_spreads_over_the_samples(rng):
    targets = rng.uniform(size=(5, 2, 16, 20))
    predictions = targets + rng.normal(scale=0.05, size=targets.shape)
    table = score(targets, predictions)
    plane = [psnr(a, b) for a, b in zip(targets[:, 1], predictions[:, 1], strict=True)]
    assert table.psnr_db[1] == pytest.approx(np.mean(plane))
    assert table.psnr_sd[1] == pytest.approx(np.std(plane, ddof=1))
    assert list(table.n_test) == [5, 5]


def test_paper_values_are_those_printed():
    table1, table2 = (read_paper_values(PAPER, name) for name in ("table1", "table2"))
    assert table1["psnr_db"] == [45.05, 43.73, 45.31, 47.87]
    assert table1["ssim"] == [0.96, 0.96, 0.97, 0.96]
    assert table2["psnr_db"] == [41.64, 39.416, 40.06, 41.87]
    assert table2["ssim"] == [0.91, 0.94, 0.96, 0.95]
    with pytest.raises(InputError, match="no table 'table9'; it has table1"):
        read_paper_values(PAPER, "table9")


def test_table_puts_the_paper_beside_ours(rng):
    paper = read_paper_values(PAPER, "table1")
    targets = rng.uniform(size=(3, 4, 16, 20))
    table = compare_with_paper(score(targets, targets * 0.99), paper)
    assert list(table.columns) == COLUMNS
    assert list(table.object) == ["rectangle", "triangle", "circle", "square"]
    run = {
        "preset": "smoke", "epochs": 2, "best_epoch": 1, "recipe": {"batch_size": 2},
        "backbone_weights": "random (seed 1), conv5", "train_s": 3.0, "machine": "a machine",
    }  # fmt: skip
    text = table_markdown(table, paper, run)
    assert f"{table.psnr_db[0] - 45.05:+.2f}" in text
    assert "random (seed 1), conv5" in text


def test_a_missing_run_shows_as_missing(tmp_path):
    text = read_tables(tmp_path, PAPER)
    assert text.count("missing") == 16
    assert "47.87" in text
    with pytest.raises(InputError, match="There is no finished run"):
        load_run(tmp_path)


def test_a_model_of_other_planes_is_not_put_beside_the_paper():
    with pytest.raises(InputError, match="The paper has 4 planes, the model has 2"):
        compare_with_paper(pd.DataFrame({"ssim": [1, 1]}), read_paper_values(PAPER, "table1"))
