import json
import re
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from experiments.histories import extrapolate, read_history, trend
from experiments.paper.comparison import (
    ASKED,
    compare_table,
    learning_markdown,
    pool_seeds,
    read_histories,
    read_result,
    report_tables,
    tabulate_learning,
)
from experiments.paper.figures import learning_figure
from experiments.paper.paper_values import read_paper_values
from experiments.paper.tables import compare_with_paper, read_tables, score_windows, write_table
from lf_flame import InputError
from lf_flame.learning.scores import score

PAPER = Path(__file__).parents[3] / "experiments" / "paper_values.toml"
RESULTS = Path(__file__).parents[3] / "experiments" / "results"
PRINTED = read_paper_values(PAPER, "table1")


@cache
def scored(seed, error):
    """Scores, and those by window, of images that are off by `error`."""
    rng = np.random.default_rng(seed)
    targets = rng.uniform(0.2, 0.8, size=(2, 4, 12, 12))
    predictions = targets + error * rng.uniform(size=targets.shape)
    return score(targets, predictions), score_windows(targets, predictions)


def make_results(folder, seed=1, error=0.1, **changed):
    """Write Table I of a run whose images are off by `error`; return its scores."""
    scores, windows = scored(seed, error)
    run = {
        "seed": seed, "preset": "paper", "split": [0.8, 0.1, 0.1], "epochs": 7, "best_epoch": 6,
        "model": {"dropout": 0.3}, "recipe": {"batch_size": 2}, "data_sha256": "c0ffee00" * 8,
        "backbone_weights": f"random (seed {seed}), conv5", "train_s": 3.0 + seed,
        "machine": f"machine {seed}", "scenes_sha256": "5ce9e5" * 8,
    }  # fmt: skip
    baselines = scores.assign(baseline="the same", depth_mm=PRINTED["depth_mm"])
    table = compare_with_paper(scores, PRINTED)
    write_table(table, baselines, windows, PRINTED, run | changed, "table1", folder)
    return scores


def read(*folders):
    return [read_result(f, "table1", f.name, PRINTED["depth_mm"]) for f in folders]


def names(pools):
    return [[result.run for result in pool] for pool in pools]


@pytest.mark.slow
def test_tables_and_their_picture_appear_together(tmp_path, monkeypatch):
    make_results(tmp_path / "a", 1, 0.1)
    out = tmp_path / "new" / "tables.md"
    with monkeypatch.context() as patch:

        def full(_figure, path):
            path.write_bytes(b"half")
            raise OSError(28, "No space left on device")

        patch.setattr("lf_flame._common.figures.save", full)
        with pytest.raises(OSError, match="No space"):
            report_tables([tmp_path / "a"], PAPER, out)
    assert not out.exists()
    report_tables([tmp_path / "a"], PAPER, out)
    assert sorted(p.name for p in out.parent.iterdir()) == ["tables.csv", "tables.md", "tables.png"]


@pytest.mark.slow
def test_seeds_of_one_recipe_are_pooled(tmp_path):
    folders = [tmp_path / name for name in ("paper", "paper-seed2", "paper-seed3")]
    scores = [
        make_results(f, seed, error)
        for f, seed, error in zip(folders, (1, 2, 3), (0.1, 0.2, 0.4), strict=True)
    ]
    text = report_tables(folders, PAPER, tmp_path / "tables.md")
    assert text == (tmp_path / "tables.md").read_text(encoding="utf-8")
    table = pd.read_csv(tmp_path / "tables.csv", index_col="table").loc["table1"]
    assert list(table.n_seeds) == [3] * 4
    assert list(table.paper_psnr_db) == PRINTED["psnr_db"]
    for name, spread in (("ssim", "ssim_seed_sd"), ("psnr_db", "psnr_seed_sd")):
        means = np.array([s[name] for s in scores])
        np.testing.assert_allclose(table[name], means.mean(axis=0), atol=1e-6)
        np.testing.assert_allclose(table[spread], means.std(axis=0, ddof=1), atol=1e-6)
    cell = table[["ssim", "ssim_seed_sd", "psnr_db", "psnr_seed_sd"]].iloc[2]
    assert "{:.3f} ± {:.3f} / {:.2f} ± {:.2f}".format(*cell) in text
    assert "paper, 3 seeds, 7 epochs" in text
    assert "1 (paper), 2 (paper-seed2), 3 (paper-seed3); preset paper, 7 epochs" in text
    assert "0.97 / 45.31" in text


@pytest.mark.parametrize(
    "changed",
    [
        {"preset": "other"},
        {"recipe": {"batch_size": 4}},
        {"model": {"dropout": 0.0}},
        {"scenes_sha256": "0ddba115" * 8},
        {"backbone_weights": "imagenet, conv5"},
        {"backbone_weights": "random (seed 2), conv4"},
    ],
    ids=str,
)
def test_other_recipes_stand_apart(tmp_path, changed):
    make_results(tmp_path / "a")
    make_results(tmp_path / "b", 2, **changed)
    make_results(tmp_path / "c", 3)
    pools = pool_seeds(read(tmp_path / "a", tmp_path / "b", tmp_path / "c"))
    assert names(pools) == [["a", "c"], ["b"]]


def test_the_papers_method_comes_first_whatever_its_preset_is_called(tmp_path):
    solved = {"neck": "positions", "warm_start": True, "epochs": 0, "batch_size": 2}
    make_results(tmp_path / "solved", preset="paper", recipe=solved, epochs=0)
    make_results(tmp_path / "trained", preset="mine", recipe={"batch_size": 2, "epochs": 1000})
    make_results(tmp_path / "both", recipe=solved | {"batch_size": 16})
    text = report_tables([tmp_path / name for name in ("solved", "both", "trained")], PAPER)
    blocks = re.findall(r"\*\*(.*?):.*?\*\*\n\n\|.*?printed \|(.*?)\n", text)
    assert [title for title, _ in blocks[:2]] == ["The paper's method", "Closed form"]
    assert ["trained, 7 epochs" in columns for _, columns in blocks[:2]] == [True, False]
    assert "**Other recipes**" in text.partition("Closed form")[2]
    assert "- trained, 7 epochs: seed 1; preset mine, 7 of 1,000 epochs, batch 2" in text


def test_the_same_scenes_from_another_machine_are_pooled(tmp_path):
    """Whose rounding differs, and so the hash of the data."""
    make_results(tmp_path / "a")
    make_results(tmp_path / "b", 2, data_sha256="0ddba115" * 8)
    assert names(pool_seeds(read(tmp_path / "a", tmp_path / "b"))) == [["a", "b"]]
    assert "data set c0ffee00, 0ddba115;" in report_tables([tmp_path / "a", tmp_path / "b"], PAPER)


def test_a_seed_counts_once(tmp_path):
    for name, seed in (("a", 1), ("again", 1), ("b", 2)):
        make_results(tmp_path / name, seed)
    results = read(*(tmp_path / name for name in ("a", "again", "b")))
    assert names(pool_seeds(results)) == [["a", "b"], ["again"]]
    assert "± " not in report_tables([tmp_path / "a", tmp_path / "again"], PAPER)


@pytest.mark.slow
def test_missing_runs_show_as_missing(tmp_path):
    folders = [tmp_path / name for name in ("none", "a", "nothing")]
    for folder in folders:
        folder.mkdir()
    make_results(tmp_path / "a")
    text = report_tables(folders, PAPER, tmp_path / "tables.md")
    assert "missing" not in text
    first, second = text.split("### Table II.")
    assert "No finished run of this table: none, nothing." in first
    assert "No finished run of this table: none, a, nothing." in second
    assert "| printed |" in re.sub(" +", " ", second)
    numbers = pd.read_csv(tmp_path / "tables.csv")
    assert list(numbers.n_seeds) == [0] * 4 + [1] * 4 + [0] * 16
    assert numbers[numbers.n_seeds == 0].psnr_db.isna().all()


def test_histories_count_seconds_from_the_start(tmp_path):
    for name in ("short", "other"):
        make_results(tmp_path / name, epochs=2)
    rows = pd.DataFrame({"epoch": [0, 1, 2], "seconds": [3.0, 1.0, 1.5], "val_psnr_db": [1, 2, 3]})
    rows.to_csv(tmp_path / "short" / "table1_history.csv", index=False)
    found = read_histories([tmp_path / "short", tmp_path / "other"], "table1")
    assert list(found) == ["short"]
    assert list(found["short"].seconds) == [3.0, 4.0, 5.5]


def test_seeds_of_one_recipe_have_one_name_and_colour():
    curve = pd.DataFrame({"seconds": [1.0, 9.0], "val_psnr_db": [30.0, 40.0]})
    runs = {"paper": "by Adam", "paper-seed2": "by Adam", "solved": "in closed form"}
    figure = learning_figure({"one": dict.fromkeys(runs, curve)}, {"one": [38.0, 41.0]}, runs)
    drawn = {line.get_label(): line.get_color() for line in figure.axes[0].lines[::2]}
    assert drawn == {"by Adam": "C0", "in closed form": "C1"}
    words = [text.get_text() for text in figure.legends[0].get_texts()]
    assert sorted(words[1:]) == ["by Adam", "in closed form"]


@pytest.mark.slow
@pytest.mark.parametrize(("first", "last"), [(0.2, 3e4), (41, 44)])
def test_labels_of_seconds_stand_apart(first, last):
    curve = pd.DataFrame({"seconds": np.geomspace(first, last, 9), "val_psnr_db": np.arange(9.0)})
    figure = learning_figure({"one": {"run": curve}, "two": {"run": curve}},
                             {"one": [3, 4], "two": [3, 4]})  # fmt: skip
    figure.canvas.draw()
    for axis in figure.axes:
        low, high = axis.get_xlim()
        ticks = axis.xaxis.get_major_ticks() + axis.xaxis.get_minor_ticks()
        shown = [x.label1 for x in ticks if x.label1.get_text() and low <= x.get_loc() <= high]
        spans = sorted((x.get_window_extent().x0, x.get_window_extent().x1) for x in shown)
        assert len(spans) >= 2
        assert all(right < left for (_, right), (left, _) in zip(spans, spans[1:], strict=False))


def test_runs_are_timed_to_where_the_weakest_ended():
    slow = pd.DataFrame({"epoch": [0, 1, 2], "seconds": [1, 51, 101], "val_psnr_db": [1, 8, 6]})
    fast = pd.DataFrame({"epoch": [0, 1, 2], "seconds": [9, 19, 29], "val_psnr_db": [7, 9, 10]})
    rows = [
        [cell.strip() for cell in line.split("|")[1:-1]]
        for line in learning_markdown(tabulate_learning({"slow": slow, "fast": fast})).splitlines()
        if line.startswith("|")
    ]
    assert rows[0][3] == "to 8.00 dB, the best of slow"
    assert rows[2:] == [
        ["slow", "8.00", "51 (1)", "51 (1)", "-", "-"],
        ["fast", "10.00", "29 (2)", "19 (1)", "-", "-"],
    ]


@pytest.mark.slow
def test_a_run_that_stalls_does_not_rise(rng):
    """Of a line with noise the slope is found, within two errors of it as often as it should be."""
    epochs = np.arange(101)
    for rise in (0.0, 0.03):
        held = []
        for _ in range(200):
            # What came before the second half says nothing.
            psnr = rise * epochs + rng.normal(0, 0.5, 101) - 40 * (epochs < 50)
            found, error = trend(pd.DataFrame({"epoch": epochs, "val_psnr_db": psnr}))
            held.append(abs(found - 10 * rise) < error)
        assert 0.9 < np.mean(held) < 0.99
    assert error == pytest.approx(2 * 10 * 0.5 / np.sqrt(51 * (51**2 - 1) / 12), rel=0.3)


def test_a_later_psnr_is_that_of_the_logarithm(rng):
    epochs = np.arange(401)
    psnr = 30 + 1.5 * np.log(np.maximum(epochs, 1)) + rng.normal(0, 0.2, 401) - 9 * (epochs < 100)
    history = pd.DataFrame({"epoch": epochs, "val_psnr_db": psnr})
    assert extrapolate(history, 5000) == pytest.approx(30 + 1.5 * np.log(5000), abs=0.4)
    assert np.isnan(extrapolate(history[:15], 5000))


def test_committed_trainings_stayed_below_the_logarithm():
    """As the function and the page on the reproduction say, drawn after 400 epochs and more."""
    for name in ("paper/table1", "paper/table2", "paper-seed2/table2", "paper-seed3/table2"):
        whole = read_history(RESULTS / f"{name}_history.csv")
        last = whole.val_psnr_db[-50:].mean()
        for epochs in (400, len(whole) // 2):
            assert extrapolate(whole[: epochs + 1], len(whole) - 25) > last


def test_learning_names_accelerators_and_what_unfinished_runs_could_reach():
    epochs = np.arange(101)
    rows = pd.DataFrame({"epoch": epochs, "seconds": 1.0 * epochs, "val_psnr_db": 0.1 * epochs})
    unfinished = rows.copy()
    unfinished.attrs = {ASKED: 200, "devices": "A card"}
    text = learning_markdown(tabulate_learning({"a": unfinished, "b": rows}))
    first, second = (line.split("|") for line in text.splitlines()[-2:])
    assert first[1].strip() == "a, on A card"
    assert float(first[-2]) == pytest.approx(extrapolate(rows, 200), abs=0.01)
    assert (second[1].strip(), second[-2].strip()) == ("b", "-")


@pytest.mark.slow
def test_how_runs_learnt_is_kept_as_numbers(tmp_path):
    make_results(tmp_path / "a", epochs=2)
    rows = pd.DataFrame({"epoch": [0, 1, 2], "seconds": [3.0, 1.0, 1.5], "val_psnr_db": [1, 3, 2]})
    rows.to_csv(tmp_path / "a" / "table1_history.csv", index=False)
    report_tables([tmp_path / "a"], PAPER, tmp_path / "tables.md")
    (kept,) = pd.read_csv(tmp_path / "tables_learning.csv").to_dict("records")
    assert (kept["table"], kept["run"], kept["best_psnr_db"]) == ("table1", "a", 3)
    assert (kept["best_s"], kept["best_epoch"], kept["there_epoch"]) == (4.0, 1, 1)
    assert np.isnan(kept["rise_db"])


def test_one_folder_is_printed_as_it_was_written(tmp_path):
    make_results(tmp_path / "a")
    text = report_tables([tmp_path / "a", tmp_path / "a"], PAPER)
    assert text == read_tables(tmp_path / "a", PAPER)
    assert (tmp_path / "a" / "table1.md").read_text(encoding="utf-8") in text


def test_infinite_psnr_stays_infinite(tmp_path):
    """Two seeds without error, then one that has some: infinity less infinity is no spread."""
    for seed, error in ((1, 0.0), (2, 0.0), (3, 0.1)):
        make_results(tmp_path / str(seed), seed, error)
    folders = [tmp_path / str(seed) for seed in (1, 2, 3)]
    for among, spread in ((folders[:2], 0), (folders, np.inf)):
        table = compare_table([read(*among)], PRINTED)
        assert np.isinf(table.psnr_db).all()
        assert list(table.psnr_seed_sd) == [spread] * 4


def test_folders_of_one_name_are_told_apart_by_their_path(tmp_path):
    folders = [tmp_path / "here" / "paper", tmp_path / "there" / "paper"]
    make_results(folders[0])
    make_results(folders[1], preset="other")
    text = report_tables(folders, PAPER)
    assert all(f"- {folder}, 7 epochs: seed 1" in text for folder in folders)


def test_what_is_no_result_is_one_sentence(tmp_path):
    make_results(tmp_path / "a")
    folders = [tmp_path / "a", tmp_path / "a"]
    with pytest.raises(InputError, match=r"must end in .md, got tables.csv"):
        report_tables(folders, PAPER, Path("tables.csv"))
    with pytest.raises(InputError, match="There is no results folder .*none"):
        report_tables([tmp_path / "none"], PAPER)
    record = json.loads((tmp_path / "a" / "table1.json").read_text())
    del record["seed"]
    (tmp_path / "a" / "table1.json").write_text(json.dumps(record))
    with pytest.raises(InputError, match=r"a/table1.json: seed is missing"):
        report_tables(folders, PAPER)


@pytest.mark.parametrize("ending", [".csv", ".md", "_history.csv"])
def test_a_file_that_was_cut_within_a_number_is_not_read_as_another(tmp_path, ending):
    history = "epoch,seconds,val_psnr_db\n" + "".join(f"{k},1.5,3{k}.25\n" for k in range(8))
    (tmp_path / "table1_history.csv").write_text(history)
    make_results(tmp_path)
    assert len(read_histories([tmp_path], "table1")) == 1
    path = tmp_path / f"table1{ending}"
    path.write_bytes(path.read_bytes()[:-3])
    for call in (read, lambda x: read_histories([x], "table1"), lambda x: read_tables(x, PAPER)):
        with pytest.raises(InputError, match=f"table1{ending} is damaged"):
            call(tmp_path)


def test_a_history_that_lost_its_last_lines_is_noticed(tmp_path):
    make_results(tmp_path, epochs=2)
    rows = "epoch,seconds,val_psnr_db\n0,1.5,30.0\n1,1.5,31.0\n"
    (tmp_path / "table1_history.csv").write_text(rows)
    with pytest.raises(InputError, match=r"table1_history\.csv is damaged: .* epochs 0 to 2"):
        read_histories([tmp_path], "table1")


def test_the_committed_results_are_read():
    folders = [path.parent for path in RESULTS.glob("*/table2.csv")]
    assert len(folders) > 3
    for folder in folders:
        assert read_result(folder, "table2", folder.name, PRINTED["depth_mm"]).request
        assert len(read_histories([folder], "table2")) == 1
