import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from skimage.metrics import structural_similarity

from experiments.paper.figures import LENSLETS_ENLARGED, enlarged_part
from experiments.paper.paper_values import read_paper_values
from experiments.paper.tables import (
    COLUMNS,
    compare_with_paper,
    read_tables,
    score_baselines,
    score_windows,
    table_markdown,
    windows_markdown,
    write_table,
)
from lf_flame import InputError
from lf_flame.learning.run_folders import load_run
from lf_flame.learning.scores import psnr, psnr_foreground, score, ssim

PAPER = Path(__file__).parents[3] / "experiments" / "paper_values.toml"

RUN = {
    "preset": "smoke", "epochs": 2, "best_epoch": 1, "recipe": {"batch_size": 2}, "model": {},
    "backbone_weights": "random (seed 1), conv5", "train_s": 3.0, "machine": "a machine",
}  # fmt: skip


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


def test_ssim_of_colours_is_the_mean_over_the_channels(rng):
    truth = rng.uniform(size=(20, 30, 3))
    image = truth + rng.normal(scale=[0.01, 0.05, 0.2], size=truth.shape)
    each = [ssim(truth[..., k], image[..., k]) for k in range(3)]
    assert np.ptp(each) > 0.1
    assert ssim(truth, image) == pytest.approx(np.mean(each), rel=1e-12)


def test_psnr_over_lit_pixels_does_not_see_the_background(rng):
    """The same object and error, in a field nine times as large: PSNR alone rises, by 10 lg 9."""
    truth = rng.uniform(0.02, 1, size=(20, 30))
    image = truth + rng.normal(scale=0.05, size=truth.shape)
    wide, wide_image = (np.pad(x, ((20, 20), (30, 30))) for x in (truth, image))
    assert psnr_foreground(wide, wide_image) == pytest.approx(psnr(truth, image))
    assert psnr(wide, wide_image) == pytest.approx(psnr(truth, image) + 10 * np.log10(9))
    assert psnr_foreground(wide, np.where(wide > 0, wide, 0.5)) == np.inf
    assert np.isnan(psnr_foreground(np.full((5, 5), 0.01), truth[:5, :5]))


def test_foreground_is_what_is_brighter_than_a_hundredth_of_the_peak():
    """Of four pixels, two above: their errors of 0.1 and 0.3 make 10 lg (1 / 0.05) = 13.01 dB."""
    truth = np.array([0.0099, 0.01, 0.0101, 0.9])
    image = truth + np.array([0.7, 0.7, 0.1, -0.3])
    assert psnr_foreground(truth, image) == pytest.approx(10 * np.log10(20), rel=1e-12)


def test_the_mean_baseline_knows_the_training_images_alone(rng):
    """Two training images of grey 0.2 and 0.6, a test image of 0.7: off by 0.3, whatever else."""
    targets = np.empty((4, 2, 16, 20))
    targets[:3] = np.array([0.2, 0.6, 0.7])[:, None, None, None]
    targets[3] = rng.uniform(size=targets.shape[1:])  # neither of the two
    inputs = np.full((4, 16, 20, 1), 0.1)
    inputs[2] = 0.6
    config = SimpleNamespace(depths_mm=[20.0, -10.0])
    dataset = SimpleNamespace(targets=targets, inputs=inputs, config=config)
    table = score_baselines(dataset, np.array([0, 1]), np.array([2]))
    assert list(table.baseline) == 2 * ["mean of the training images"] + 2 * ["the input image"]
    assert list(table.depth_mm) == 2 * [20.0, -10.0]
    expected = np.repeat([-20 * np.log10(0.3), -20 * np.log10(0.1)], 2)
    np.testing.assert_allclose(table.psnr_db, expected)
    np.testing.assert_allclose(table.psnr_foreground_db, expected)
    dataset.inputs = inputs[:, ::2]  # of another size, the input is no image to be compared
    assert len(score_baselines(dataset, np.array([0, 1]), np.array([2]))) == 2


def test_planes_without_lit_pixels_are_left_out_of_the_mean(rng):
    targets = rng.uniform(0.1, 1, size=(4, 2, 16, 20))
    predictions = targets + rng.normal(scale=0.05, size=targets.shape)
    targets[1, 0] = 0
    targets[:, 1] = 0
    table = score(targets, predictions)
    bright = [psnr_foreground(targets[k, 0], predictions[k, 0]) for k in (0, 2, 3)]
    assert table.psnr_foreground_db[0] == pytest.approx(np.mean(bright))
    assert table.psnr_foreground_sd[0] == pytest.approx(np.std(bright, ddof=1))
    assert table[["psnr_foreground_db", "psnr_foreground_sd"]].isna().to_numpy()[1].all()
    assert list(table.n_test) == [4, 4]


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
    text = table_markdown(table, paper, RUN)
    assert f"{table.psnr_db[0] - 45.05:+.2f}" in text
    assert f"{table.psnr_foreground_db[3]:.2f} ± {table.psnr_foreground_sd[3]:.2f}" in text
    assert "random (seed 1), conv5" in text
    assert "2 epochs, best 1, batch 2" in text
    assert "epochs in 3 s on a machine" in text
    text = table_markdown(table, paper, RUN | {"epochs": 0, "start_s": 61.4, "train_s": 0.0})
    assert "another decoder, solved, no epochs" in text
    assert "features and start in 61 s, epochs in 0 s" in text


def test_records_of_equal_images_are_json(rng, tmp_path):
    """JSON has no infinity: null there, while the CSV keeps it."""
    paper = read_paper_values(PAPER, "table1")
    targets = rng.uniform(size=(3, 4, 16, 20))
    predictions = targets.copy()
    predictions[:, 1:] *= 0.9
    scores = score(targets, predictions)
    baselines = scores.assign(baseline="the same", depth_mm=paper["depth_mm"])
    table, windows = compare_with_paper(scores, paper), score_windows(targets, predictions)
    write_table(table, baselines, windows, paper, RUN, "table1", tmp_path)

    def refuse(constant):
        raise AssertionError(f"{constant} is not JSON")

    record = json.loads((tmp_path / "table1.json").read_text(), parse_constant=refuse)
    assert record["table"][0]["psnr_db"] is None
    assert record["table"][1]["psnr_db"] == scores.psnr_db[1]
    assert record["baselines"][0]["psnr_foreground_db"] is None
    kept = pd.read_csv(tmp_path / "table1.csv")
    assert list(kept.columns) == COLUMNS
    assert list(np.isinf(kept.psnr_db)) == [True, False, False, False]


def test_ssim_by_window_starts_with_the_tables(rng):
    targets = rng.uniform(size=(3, 2, 16, 20))
    predictions = targets + 0.2 * rng.uniform(size=targets.shape)
    windows = score_windows(targets, predictions)
    np.testing.assert_allclose(windows.iloc[0], score(targets, predictions).ssim)
    expected = structural_similarity(targets[1, 0], predictions[1, 0], data_range=1.0)  # 7 x 7
    alone = score_windows(targets[1:2, :1], predictions[1:2, :1])
    assert alone.loc["7 x 7, scikit-image's default", 0] == expected
    text = windows_markdown(windows, [20.0, -10.0])
    assert "-10 mm" in text
    assert f"{windows.iloc[2, 1]:.4f}" in text


def test_a_missing_run_shows_as_missing(tmp_path):
    text = read_tables(tmp_path, PAPER)
    assert text.count("missing") == 16
    assert "47.87" in text
    with pytest.raises(InputError, match="There is no finished run"):
        load_run(tmp_path)


def test_a_model_of_other_planes_is_not_put_beside_the_paper():
    with pytest.raises(InputError, match="The paper has 4 planes, the model has 2"):
        compare_with_paper(pd.DataFrame({"ssim": [1, 1]}), read_paper_values(PAPER, "table1"))


def test_micro_images_are_enlarged_where_they_change_both_ways():
    """Not along an edge, where they change one way alone."""
    views = np.zeros((3, 3, 40, 50), np.float32)
    views[1:, :, :20, 25:] = 1  # changes along v, on a quarter of the image
    views[:, 1:, 15:, 30:] = 1  # changes along u; both do where these overlap
    t, s = enlarged_part(views)
    middle = LENSLETS_ENLARGED // 2
    assert 10 <= t + middle <= 25
    assert 30 <= s + middle <= 49
    assert enlarged_part(np.zeros((3, 3, 4, 5), np.float32)) == (0, 0)
