"""The paper's tables: one run beside the printed values, and several runs side by side."""

import json
from functools import cache
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from builders import shapes

from experiments.linear import RIDGE, STRENGTHS, Ridge
from experiments.paper import evaluation
from experiments.paper.evaluation import score_baselines, score_windows
from experiments.paper.tables import (
    compare_table,
    compare_with_paper,
    pool_seeds,
    read_paper_values,
    read_result,
    report_tables,
    title_of,
)
from lf_flame import InputError
from lf_flame.datasets.store import split_indices
from lf_flame.learning.scores import score

PRINTED = read_paper_values("table1")
DATA = shapes(12, views=3, sides_mm=(9.0, 9.0))


@cache
def scored(seed, error):
    """Scores, and SSIM by window, of images that are off by `error`."""
    rng = np.random.default_rng(seed)
    targets = rng.uniform(0.2, 0.8, size=(2, 4, 12, 12))
    predictions = targets + error * rng.uniform(size=targets.shape)
    return score(targets, predictions), score_windows(targets, predictions)


def make_record(seed=1, error=0.1, **changed):
    """Record of Table I of a run whose images are off by `error`."""
    scores, windows = scored(seed, error)
    return {
        "seed": seed, "preset": "paper", "split": [0.8, 0.1, 0.1], "epochs": 7, "best_epoch": 6,
        "parts": {"train": 16}, "model": {"dropout": 0.3}, "recipe": {"batch_size": 2},
        "backbone_weights": f"random (seed {seed}), conv5", "train_s": 3.0,
        "machine": f"machine {seed}",
        "table": compare_with_paper(scores, PRINTED).to_dict("records"),
        "ssim_by_window": windows,
    } | changed  # fmt: skip


def make_results(folder, seed=1, error=0.1, **changed):
    """Write that record; an infinite PSNR is null in JSON, as `write_json` writes it."""
    folder.mkdir(exist_ok=True)
    record = json.dumps(make_record(seed, error, **changed)).replace("Infinity", "null")
    (folder / "table1.json").write_text(record)
    return folder


def write_history(folder, psnr):
    rows = pd.DataFrame({"epoch": range(len(psnr)), "seconds": 2.0, "val_psnr_db": psnr})
    rows.to_csv(folder / "table1_history.csv", index=False)


def pools(*folders):
    found = pool_seeds([read_result(folder, "table1", folder.name) for folder in folders])
    return [[result.run for result in pool] for pool in found]


def test_the_paper_prints_these_values():
    assert PRINTED["psnr_db"] == [45.05, 43.73, 45.31, 47.87]
    assert PRINTED["ssim"] == [0.96, 0.96, 0.97, 0.96]
    flames = read_paper_values("table2")
    assert flames["psnr_db"] == [41.64, 39.416, 40.06, 41.87]
    assert flames["ssim"] == [0.91, 0.94, 0.96, 0.95]


@pytest.mark.parametrize("changed", [{"depths_mm": [20, 10]}, {"shuffled_depths": True}], ids=str)
def test_a_run_of_other_scenes_gets_no_table(changed, tmp_path, monkeypatch):
    config = {"kind": "shapes", "depths_mm": [20, 10, 0, -10], "shuffled_depths": False} | changed
    objects = ["rectangle", "triangle", "circle", "square"]
    run = SimpleNamespace(record={}, objects=objects, config=SimpleNamespace(**config))
    monkeypatch.setattr(evaluation, "open_run", lambda folder: run)
    with pytest.raises(InputError, match="must be a run of the paper's .*'rectangle'"):
        evaluation.evaluate_run(tmp_path / "run", tmp_path)


class Scenes(SimpleNamespace):
    """A data set of 40 pictures, and images that are an affine function of them, of 6 numbers."""

    def __init__(self, rng, noise=0.0):
        numbers = rng.uniform(size=(40, 6))
        pictures, images = (
            0.2 + np.tensordot(numbers, rng.uniform(0, 0.1, size=(6, *shape)), 1)
            for shape in ((12, 12, 1), (2, 12, 12))
        )
        pictures += noise * rng.normal(size=pictures.shape)
        images += noise * rng.normal(size=images.shape)
        config = SimpleNamespace(depths_mm=[1, 2])
        super().__init__(inputs=pictures, targets=images, config=config)

    def __len__(self):
        return 40


def test_ridge_learns_what_is_linear_and_the_mean_image_stands_beside_it(rng):
    scenes = Scenes(rng)
    found = score_baselines(scenes, (0.5, 0.25, 0.25), 1)
    parts = split_indices(40, (0.5, 0.25, 0.25), 1)
    assert list(found) == ["mean training image", RIDGE]
    assert min(row["psnr_db"] for row in found[RIDGE]) > 100
    test = scenes.targets[parts["test"]]
    mean = np.broadcast_to(scenes.targets[parts["train"]].mean(axis=0), test.shape)
    psnr = [row["psnr_db"] for row in found["mean training image"]]
    np.testing.assert_allclose(psnr, score(test, mean).psnr_db)


def test_ridge_equals_its_primal_form_and_the_validation_chooses_its_strength(rng):
    """weights = (P^T P + strength k)^-1 P^T I, with noise that only regularisation keeps out."""
    scenes = Scenes(rng, noise=0.05)
    parts = split_indices(40, (0.5, 0.25, 0.25), 1)
    ridge = Ridge(scenes, parts)
    p, i = scenes.inputs.reshape(40, -1), scenes.targets.reshape(40, -1)
    train, losses, drawn = parts["train"], {}, {}
    centred, images = p[train] - p[train].mean(0), i[train] - i[train].mean(0)
    for strength in STRENGTHS:
        k = strength * (centred**2).sum() / len(centred)
        weights = np.linalg.solve(centred.T @ centred + k * np.eye(144), centred.T @ images)
        drawn[strength] = (p - p[train].mean(0)) @ weights + i[train].mean(0)
        losses[strength] = np.mean((drawn[strength] - i)[parts["validation"]] ** 2)
    assert ridge.strength == min(losses, key=losses.get)
    assert STRENGTHS[0] < ridge.strength < STRENGTHS[-1]
    expected = drawn[ridge.strength].reshape(scenes.targets.shape)
    np.testing.assert_allclose(ridge.predict(scenes.inputs), expected, atol=1e-5)


@pytest.mark.slow
def test_seeds_are_pooled_and_missing_runs_are_named(tmp_path):
    folders = [tmp_path / name for name in ("paper", "paper-seed2", "paper-seed3", "none")]
    for seed, (folder, error) in enumerate(zip(folders, (0.1, 0.2, 0.4), strict=False), 1):
        make_results(folder, seed, error)
    folders[3].mkdir()
    write_history(folders[0], [1, 3, 2, 1, 1, 1, 1, 1])
    text = report_tables(folders, tmp_path / "out" / "tables.md")
    assert text == (tmp_path / "out" / "tables.md").read_text(encoding="utf-8")
    endings = {"tables.md", "tables.csv", "tables.png", "tables.json"}
    assert {path.name for path in (tmp_path / "out").iterdir()} == endings
    table = pd.read_csv(tmp_path / "out" / "tables.csv")
    assert list(table.table) == ["table1"] * 4
    assert list(table.n_seeds) == [3] * 4
    assert list(table.paper_psnr_db) == PRINTED["psnr_db"]
    scores = [scored(seed, error)[0] for seed, error in ((1, 0.1), (2, 0.2), (3, 0.4))]
    for name, spread in (("ssim", "ssim_seed_sd"), ("psnr_db", "psnr_seed_sd")):
        means = np.array([s[name] for s in scores])
        np.testing.assert_allclose(table[name], means.mean(axis=0), atol=1e-6)
        np.testing.assert_allclose(table[spread], means.std(axis=0, ddof=1), atol=1e-6)
    cell = table[["psnr_db", "psnr_seed_sd", "ssim", "ssim_seed_sd"]].iloc[2]
    assert "{:.2f} ± {:.2f}, {:.3f} ± {:.3f}".format(*cell) in text
    assert ", all five stages, 3 seeds | 7 of 5,000 |" in " ".join(text.split())
    assert ", 3 seeds: seed 1 (paper), best epoch 6, 3 seconds; seed 2 (paper-seed2), best" in text
    # 3 s for 7 epochs, of 5,000
    assert "7 of the paper's 5,000 epochs on machine 1. All 5,000 " in text
    assert " 5,000 take 35.7 minutes there. The same command resumes" in text
    first, second = text.split("## Table II.")
    assert "No result of this table: none." in first
    assert "No result of this table: paper, paper-seed2, paper-seed3, none." in second


@pytest.mark.parametrize(
    "changed",
    [{"epochs": 8}, {"dataset": {"config": DATA}}, {"backbone_weights": "random (seed 2), conv4"}],
    ids=str,
)
def test_runs_of_other_recipes_are_not_pooled(tmp_path, changed):
    a, c = make_results(tmp_path / "a"), make_results(tmp_path / "c", 3)
    assert pools(a, make_results(tmp_path / "b", 2, **changed), c) == [["a", "c"], ["b"]]


def test_runs_of_earlier_programs_are_pooled(tmp_path):
    """Their records lack options that came later, and have two that change nothing."""
    earlier = {"recipe": {"batch_size": 2, "checkpoint_s": 60.0}, "dataset": {"config": DATA}}
    today = DATA | {"camera": DATA["camera"] | {"layout": "rectangular"}}
    a = make_results(tmp_path / "a", **earlier)
    assert pools(a, make_results(tmp_path / "b", 2, dataset={"config": today})) == [["a", "b"]]


def test_each_seed_of_one_place_counts_once(tmp_path):
    """A user's own run is not pooled with runs of another folder of results."""
    a, again = make_results(tmp_path / "a"), make_results(tmp_path / "again")
    b = make_results(tmp_path / "b", 2)
    (tmp_path / "own").mkdir()
    own = make_results(tmp_path / "own" / "a", 3)
    assert pools(a, again, b, own) == [["a", "b"], ["again"], ["a"]]
    text = report_tables([a, own])
    assert f"- this run, {a}: ResNet-50 (random weights), all five stages: seed 1 ({a})," in text
    assert f": seed 3 ({own})," in text


@pytest.mark.parametrize(
    ("changed", "title"),
    [
        ({"backbone_weights": "imagenet, conv5"}, "ResNet-50 (ImageNet), all five stages"),
        (
            {"backbone_weights": "resnet50_pruned_8bit_keras_names.npz (sha256 0a1b), conv5"},
            "pruned 8-bit ResNet-50 (ImageNet), all five stages",
        ),
        (
            {"backbone_weights": "resnet50_imagenet_conv1-conv4.npz (sha256 0a1b), conv4",
             "model": {"dropout_place": "vector"}},
            "ResNet-50 (ImageNet), first four stages, dropout on the vector",
        ),
        (
            {"backbone_weights": "my, own.h5 (sha256 0a1b), conv3", "preset": "smoke"},
            "ResNet-50 (my, own.h5), first three stages, preset smoke",
        ),
        ({"backbone_weights": "no backbone", "recipe": {"dropout_place": "none"},
          "dataset": {"config": {"input": {"kind": "central"}}}},
         "no backbone, no dropout, input central"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)  # fmt: skip
def test_rows_are_called_by_what_was_run(tmp_path, changed, title):
    result = read_result(make_results(tmp_path / "a", **changed), "table1", "a")
    assert title_of([result]) == f"this run, {tmp_path / 'a'}: {title}"


def test_baselines_are_rows_of_the_table(tmp_path):
    rows = [
        {"depth_mm": z, "ssim": 0.9, "psnr_db": psnr}
        for z, psnr in zip(PRINTED["depth_mm"], (25.0, 24.0, None, 23.5), strict=True)
    ]
    folder = make_results(tmp_path / "a")
    path = folder / "table1_baselines.json"
    path.write_text(json.dumps({"baselines": {"mean training image": rows}}))
    table = " ".join(report_tables([folder]).split())
    row = "| mean training image | none | 25.00, 0.900 | 24.00, 0.900 | inf, 0.900 | 23.50, 0.900 |"
    assert row in table


def test_infinite_psnr_stays_infinite(tmp_path):
    """Two seeds without error, then one with: infinity less infinity is no spread."""
    folders = [make_results(tmp_path / f"{k}", k, e) for k, e in ((1, 0.0), (2, 0.0), (3, 0.1))]
    for among, spread in ((folders[:2], 0), (folders, np.inf)):
        table = compare_table([[read_result(f, "table1", f.name) for f in among]], PRINTED)
        assert np.isinf(table.psnr_db).all()
        assert list(table.psnr_seed_sd) == [spread] * 4


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (
            lambda folder: (folder / "table1.json").write_text("{}"),
            "table1.json is damaged: it must hold preset, split",
        ),
        (lambda folder: (folder / "table1_history.csv").write_text("epoch\n1"), "is damaged"),
        (
            lambda folder: make_results(folder, table=make_record()["table"][:3]),
            "must have the depths of the paper",
        ),
        (lambda folder: (folder / "table1.json").unlink() or folder.rmdir(), "no results folder"),
    ],
    ids=["record", "history", "planes", "folder"],
)
def test_damaged_results_are_one_sentence(tmp_path, damage, words):
    folder = make_results(tmp_path / "a")
    damage(folder)
    with pytest.raises(InputError, match=words):
        report_tables([folder])
