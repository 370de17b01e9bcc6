import json
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from builders import camera, shapes, toml
from click.testing import CliRunner
from programs import without_graphs

from experiments.__main__ import commands
from experiments.linear import Ridge, project
from experiments.studies.study import COLUMNS, read_study, run_study
from lf_flame import InputError
from lf_flame._common import figures
from lf_flame.datasets.store import Dataset, split_indices
from lf_flame.learning.run_folders import open_run
from lf_flame.learning.scores import score
from lf_flame.learning.training import train

ROOT = Path(__file__).parents[3]

TRAINING = """
title = "tiny"
seed = 1
split = [0.5, 0.25, 0.25]
[model]
backbone_weights = "random"
backbone_depth = "none"
[presets.smoke]
epochs = 2
"""

STUDY = """
title = "A tiny study"
data = "data.toml"
training = "training.toml"
preset = "smoke"
samples = 12
[common]
recipe = { batch_size = 3 }
"""

BARS = """
[[variants]]
name = "as it is"
[[variants]]
name = "small: batches of 2"
recipe = { batch_size = 2 }
"""

STILL = """
[[variants]]
name = "still"
data.template = { position_mm = 0.0, objects = [{ size_mm = [9.0, 8.0] }, {}] }
[[variants]]
name = "moving"
"""


def write(folder, variants, study=STUDY):
    """Write a study and the files that it names."""
    coarse = shapes(20, (12, 20)) | {"camera": camera(5, (12, 20), 20)}
    (folder / "data.toml").write_text(toml(coarse))
    (folder / "training.toml").write_text(TRAINING)
    (folder / "tiny.toml").write_text(study + variants)
    return Path("tiny.toml")


UNTRAINED = STUDY.replace('preset = "smoke"', "")


def run(path):
    return run_study(path, Path("out"), Path("work"))


def leave_undrawn(patch):
    """Let figures be empty files: drawing one takes half a second."""
    patch.setattr(figures, "save", lambda figure, path, dpi=150: path.touch())


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty working directory."""
    monkeypatch.chdir(tmp_path)
    leave_undrawn(monkeypatch)
    return tmp_path


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A folder with a study whose second variant could not be trained at first, and then was.

    Also what the report was before that variant, what was printed, and when the first variant's
    model was written.
    """
    folder, before = tmp_path_factory.mktemp("study"), []
    model = folder / "work" / "tiny" / "as it is, 2 epochs" / "model.keras"

    def train_first(config, preset, data, out):
        if out.name != "as it is, 2 epochs":
            before.append(Path("out/tiny.md").read_text())
            raise InputError("No such weights.")
        train(config, preset, data, out)

    with pytest.MonkeyPatch.context() as patch, without_graphs():
        patch.chdir(folder)
        path = write(folder, BARS)
        with pytest.MonkeyPatch.context() as inner, redirect_stdout(StringIO()) as shown:
            leave_undrawn(inner)
            inner.setattr("experiments.studies.study.train", train_first)
            run(path)
        written = model.stat().st_mtime_ns
        run(path)
    return folder, before[0], shown.getvalue(), written


@pytest.mark.slow
def test_networks_and_what_needs_none_are_scored_on_the_same_samples(done, monkeypatch):
    monkeypatch.chdir(done[0])
    assert [path.name for path in Path("work/tiny").glob("*.zarr")] == ["as it is.zarr"]  # shared
    table = pd.read_csv("out/tiny.csv")
    assert list(table.columns) == COLUMNS
    assert list(table["object"]) == ["square", "circle"] * 6
    assert list(table.system) == (["network"] * 2 + ["linear"] * 2 + ["bound"] * 2) * 2
    parts = split_indices(12, (0.5, 0.25, 0.25), 1)
    for folder, (_, rows) in zip(
        ("work/tiny/as it is, 2 epochs", "work/tiny/small: batches of 2, 2 epochs"),
        table.groupby("variant", sort=False), strict=True,
    ):  # fmt: skip
        dataset, indices, predictions = open_run(folder).predict_test_split()
        np.testing.assert_array_equal(indices, parts["test"])
        targets, known = dataset.targets[indices], dataset.targets[parts["train"]]
        ridge = Ridge(dataset, parts).predict(dataset.inputs[indices])
        for system, images in (
            ("network", predictions), ("linear", ridge), ("bound", project(known, targets, 256, 2)),
        ):  # fmt: skip
            found, expected = rows[rows.system == system], score(targets, images)
            np.testing.assert_allclose(found.psnr_db, expected.psnr_db, atol=1e-3)
            np.testing.assert_allclose(found.ssim, expected.ssim, atol=1e-4)


@pytest.mark.slow
def test_a_study_resumes_and_its_report_says_where_it_comes_from(done):
    folder, text, shown, written = done
    assert shown.count("Left out: No such weights.") == 1
    rows = {line.split("|")[1].strip(): line for line in text.splitlines() if "|" in line}
    assert rows["small: batches of 2"].split().count("-") == 4
    assert "-" not in rows["as it is"].split()
    model = folder / "work" / "tiny" / "as it is, 2 epochs" / "model.keras"
    assert model.stat().st_mtime_ns == written
    assert not list(folder.rglob("checkpoint*"))
    table = pd.read_csv(folder / "out/tiny.csv")
    text = (folder / "out/tiny.md").read_text()
    psnr = table.psnr_db[:2]
    assert f" {psnr.mean():.2f}, {psnr.min():.2f}, {table.ssim[:2].mean():.4f} " in text
    assert "Printed in the paper: 45.49, 43.73" in text
    assert "no backbone" in text
    record = json.loads((folder / "out/tiny.json").read_text())
    assert record["results"]["as it is"]["epochs"] == 2
    assert {"versions", "git_revision", "machine", "command"} <= set(record)
    assert (folder / "out/tiny.png").exists()


@pytest.mark.slow
def test_a_study_without_training(folder):
    path = write(folder, STILL, UNTRAINED)
    arguments = ["study", str(path), "--out", "out", "--work", "work", "--workers", "1"]
    shown = CliRunner().invoke(commands, arguments)
    assert shown.exit_code == 0, shown.output
    assert "2 of 2: moving" in shown.output
    assert not list(Path("work").rglob("*.keras"))
    table = pd.read_csv("out/tiny.csv")
    assert set(table.system) == {"linear", "bound"}
    means = table.groupby(["system", "variant"]).psnr_db.mean()
    assert means["bound", "still"] > means["bound", "moving"]
    assert Path("out/tiny.png").exists()
    text = Path("out/tiny.md").read_text()
    assert "epoch" not in text
    sizes = [[o.size_mm for o in one.data.template.objects] for one in read_study(path)[1]]
    assert sizes == [[(9.0, 8.0), (9.0, 9.0)], [(10.0, 10.0), (9.0, 9.0)]]
    centres = Dataset("work/tiny/still.zarr").parameters("centre_mm")
    np.testing.assert_array_equal(centres, np.broadcast_to([[0, -10], [0, 10]], (12, 2, 2)))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("samples = 12", "samples = 12\nspeed = 2", "tiny.toml: speed is not a known key"),
        ("samples = 12", "samples = 3", "3 samples are too few to split"),
        ('preset = "smoke"', 'preset = "fast"', "training.toml has presets smoke, got .fast."),
        ("{ batch_size = 2 }", "{ speed = 1 }", "of 2': presets.smoke.speed is not a known"),
        ("recipe = { batch_size = 2", "data.template = { position = 1", "position is not a known"),
        ("small: batches of 2", "as it is", "needs a unique name, in words, got 'as it is'"),
    ],
)
def test_impossible_studies_are_refused(folder, old, new, message):
    text = STUDY + BARS
    assert text.count(old) == 1
    path = write(folder, "", text.replace(old, new))
    with pytest.raises(InputError, match=message):
        read_study(path)


@pytest.mark.parametrize(
    "path", sorted(ROOT.glob("experiments/studies/*.toml")), ids=lambda path: path.stem
)
def test_every_study_can_be_built(path, monkeypatch):
    monkeypatch.chdir(ROOT)
    study, trials = read_study(path)
    assert len(trials) == len(study.variants)
    assert len({tuple(trial.parts["test"]) for trial in trials}) == 1
    asked = [json.dumps(trial.request) for trial in trials]
    assert len(set(asked)) == len(asked)  # no variant is another under a new name


def bound(train, test, *options):
    """PSNR of the projections, for each plane."""
    return score(test, project(train, test, *options)).psnr_db.to_numpy()


def test_projection_leaves_the_least_error_there_is(rng):
    """On the samples themselves: the singular values left out (Eckart and Young 1936)."""
    targets = rng.uniform(0.3, 0.7, (12, 2, 6, 10)).astype(np.float32)
    values = np.linalg.svd((targets - targets.mean(0)).reshape(12, -1), compute_uv=False)
    for k in (1, 4, 8):
        found = np.sum((project(targets, targets, k) - targets) ** 2)
        assert found == pytest.approx(np.sum(values[k:] ** 2), rel=1e-4)


def test_bands_take_chance_out_of_what_is_independent(rng):
    """Two things side by side, each drawn from 6 pictures, seen 8 times: together they are 12."""
    pictures = rng.uniform(0, 0.1, (2, 6, 1, 12, 10))

    def draw(n):
        weights = rng.uniform(0, 1, (2, n, 6))
        parts = [np.tensordot(w, p, 1) for w, p in zip(weights, pictures, strict=True)]
        return (0.2 + np.concatenate(parts, axis=-1)).astype(np.float32)

    train, test = draw(8), draw(20)
    together, apart = (bound(train, test, 256, b)[0] for b in (1, 2))
    assert together < 50
    assert apart > 110
