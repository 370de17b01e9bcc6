import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from builders import shapes, toml
from click.testing import CliRunner

from experiments.__main__ import commands
from experiments.studies import pca_bound
from experiments.studies.pca_bound import principal_component_bound, project
from experiments.studies.report import COLUMNS, MEAN, _findings, find_crossing
from experiments.studies.study import read_study, run_study
from lf_flame import InputError
from lf_flame._common import figures
from lf_flame.datasets.split import split_indices
from lf_flame.datasets.store import Dataset
from lf_flame.learning.decoder import build_refocus_resnet50
from lf_flame.learning.imagenet_weights import ImagenetUnavailable
from lf_flame.learning.run_folders import load_run, predict_test_split, training_indices
from lf_flame.learning.scores import score

ROOT = Path(__file__).parents[3]
PAPER = ROOT / "experiments" / "paper_values.toml"

TRAINING = """
title = "tiny"
seed = 1
split = [0.5, 0.25, 0.25]
[model]
backbone_weights = "random"
backbone_depth = "none"
[presets.smoke]
epochs = 2
[presets.other]
epochs = 1
"""

STUDY = """
title = "A tiny study"
data = "data.toml"
training = "training.toml"
preset = "smoke"
samples = 12
[common]
recipe = { batch_size = 3, neck = "positions" }
"""

TIMED = STUDY.replace("samples = 12", "samples = 12\ntimed = true")

BARS = """
[[variants]]
name = "as it is"
[[variants]]
name = "another preset: 3 to train on"
preset = "other"
training_samples = 3
recipe = { batch_size = 1 }
"""

FOLDERS = {
    "as it is": "as-it-is",
    "another preset: 3 to train on": "another-preset-3-to-train-on",
}

CURVE = """
[x]
label = "movement"
unit = "mm"
scale = "log"
[[variants]]
name = "still"
series = "one curve"
x = 0
data.template = { position_mm = 0.0, objects = [{ size_mm = [9.0, 8.0] }, {}] }
recipe = { epochs = 1 }
[[variants]]
name = "moving"
series = "one curve"
x = 1
recipe = { epochs = 1 }
"""


def write(folder, variants, study=STUDY):
    """Write a study and the files that it names."""
    (folder / "data.toml").write_text(toml(shapes(20)))
    (folder / "training.toml").write_text(TRAINING)
    (folder / "tiny.toml").write_text(study + variants)
    return Path("tiny.toml")


def run(path, **options):
    return run_study(path, Path("out"), Path("work"), PAPER, **options)


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
    """A folder with a study that was cut behind its first variant, and then went on.

    Also what the report said at the cut, and when the first variant's model was written.
    """
    folder = tmp_path_factory.mktemp("study")
    model = folder / "work" / "tiny" / "as-it-is" / "model.keras"
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        path = write(folder, BARS, TIMED)
        with pytest.MonkeyPatch.context() as inner:
            leave_undrawn(inner)
            text = run(path, only=["as it is"]).read_text()
        at_the_cut = text, pd.read_csv("out/tiny.csv"), model.stat().st_mtime_ns
        run(path)
    return folder, *at_the_cut


@pytest.mark.slow
def test_variants_are_trained_alike_and_scored_on_the_same_samples(done, monkeypatch):
    monkeypatch.chdir(done[0])
    assert len(list(Path("work/data").iterdir())) == 1  # both variants share it
    table = pd.read_csv("out/tiny.csv")
    assert list(table.columns) == COLUMNS
    assert list(table["object"]) == ["square", "circle", "mean"] * 2
    assert list(table["training_samples"]) == [6] * 3 + [3] * 3
    assert list(table["epochs"]) == [2] * 3 + [1] * 3
    test = split_indices(12, (0.5, 0.25, 0.25), 1)["test"]
    for name, rows in table.groupby("variant", sort=False):
        dataset, indices, predictions = predict_test_split(f"work/tiny/{FOLDERS[name]}")
        targets = dataset.targets[test]
        scores = score(targets, predictions[[list(indices).index(k) for k in test]])
        np.testing.assert_allclose(rows.psnr_db[:2], scores.psnr_db, atol=1e-3)
        np.testing.assert_allclose(rows.ssim.iloc[2], scores.ssim.mean(), atol=1e-3)
        known = dataset.targets[training_indices(12, load_run(f"work/tiny/{FOLDERS[name]}"))]
        assert len(known) == rows.training_samples.iloc[0]
        mean = np.broadcast_to(known.mean(axis=0), targets.shape)
        assert (rows.bound_db.iloc[:2].to_numpy() > score(targets, mean).psnr_db.to_numpy()).all()


@pytest.mark.slow
def test_the_report_says_what_was_found_and_where_it_comes_from(done, monkeypatch):
    monkeypatch.chdir(done[0])
    table = pd.read_csv("out/tiny.csv")
    text = Path("out/tiny.md").read_text()
    assert f" {table.psnr_db[2]:.2f} |" in text
    assert "45.49 |" in text  # the paper's mean
    assert "missing" not in text
    assert "no backbone" in text
    record = json.loads(Path("out/tiny.json").read_text())
    assert record["results"]["as it is"]["epochs"] == 2
    assert {"versions", "git_revision", "machine", "command"} <= set(record)
    curves = pd.read_csv("out/tiny_time.csv")
    assert list(curves.epoch) == [0, 1, 2, 0, 1]
    seconds = pd.read_csv("work/tiny/as-it-is/history.csv").seconds.sum()
    found = record["results"]["as it is"]
    assert curves.seconds[2] == pytest.approx(seconds, abs=1e-3)
    assert found["start_s"] + found["train_s"] == pytest.approx(seconds, abs=0.02)
    assert {"tiny.png", "tiny_time.png"} <= {path.name for path in Path("out").iterdir()}


@pytest.mark.slow
def test_a_study_goes_on_where_it_was_cut_off(done):
    folder, text, table, written = done
    assert "missing" in text
    means = table[table["object"] == "mean"].set_index("variant")["psnr_db"]
    assert list(means.isna()) == [False, True]
    assert (folder / "work" / "tiny" / "as-it-is" / "model.keras").stat().st_mtime_ns == written
    assert not list(folder.rglob("checkpoint-*"))


@pytest.mark.slow
def test_a_changed_variant_is_refused(done, monkeypatch):
    monkeypatch.chdir(done[0])
    path = write(done[0], BARS.replace("batch_size = 1", "batch_size = 2"), TIMED)
    with pytest.raises(InputError, match="holds a run with another recipe"):
        run(path)


@pytest.mark.slow
def test_a_study_along_an_axis(folder):
    path = write(folder, CURVE)
    arguments = ["study", str(path), "--out", "out", "--work", "work", "--workers", "1"]
    shown = CliRunner().invoke(commands, [*arguments, "--paper", str(PAPER)])
    assert shown.exit_code == 0, shown.output
    assert "2 of 2: moving" in shown.output
    assert "one curve: above the paper's mean of 45.49 dB nowhere." in shown.output
    table = pd.read_csv("out/tiny.csv")
    means = table[table["object"] == "mean"]
    assert list(means["x"]) == [0, 1]
    assert means["bound_db"].iloc[0] > means["bound_db"].iloc[1]
    assert Path("out/tiny.png").exists()
    assert not Path("out/tiny_time.png").exists()
    assert "seconds" not in Path("out/tiny.md").read_text()
    still, moving = read_study(path)[1]
    sizes = [[o.size_mm for o in trial.data.template.objects] for trial in (still, moving)]
    assert sizes == [[(9.0, 8.0), (9.0, 9.0)], [(10.0, 10.0), (9.0, 9.0)]]
    centres = Dataset(f"work/data/{still.dataset_name}").parameters("centre_mm")
    np.testing.assert_array_equal(centres, np.broadcast_to([[0, -10], [0, 10]], (12, 2, 2)))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("samples = 12", "samples = 12\nspeed = 2", "tiny.toml: speed is not a known key"),
        ("samples = 12", "samples = 0", "needs variants, and samples up to 1000000, got 2 and 0"),
        ("samples = 12", "samples = 3", "3 samples are too few to split"),
        ('"data.toml"', '"none.toml"', "none.toml cannot be read"),
        ('preset = "smoke"', 'preset = "fast"', "preset must be one of smoke, other, got 'fast'"),
        ("{ batch_size = 1 }", "{ speed = 1 }", "train on': presets.other.speed is not a known"),
        ("{ batch_size = 1 }", "{ batch_size = 0 }", "train on': presets.other: batch_size must"),
        ("recipe = { batch_size = 1", "model = { depth = 1", "model.depth is not a known key"),
        ("recipe = { batch_size = 1", "data.template = { position = 1", "position is not a known"),
        ("recipe = { batch_size = 1", "data = { colour = 1", "colour is not a known key"),
        ("training_samples = 3", "training_samples = 7", "training_samples must be 1 to 6, got 7"),
        ("training_samples = 3", "x = 3", "to every variant, or to none; variant 'another"),
        ("another preset: 3 to train on", "as it, is", "Two variants are called 'as it is'"),
        ("as it is", "...", "needs a name with a letter or a digit, got '...'"),
    ],
)
def test_impossible_studies_are_refused(folder, old, new, message):
    text = STUDY + BARS
    assert text.count(old) == 1
    path = write(folder, "", text.replace(old, new))
    with pytest.raises(InputError, match=message.replace("...", r"\.\.\.")):
        read_study(path)


IMAGENET = """
[[variants]]
name = "pre-trained"
model = { backbone_weights = "imagenet" }
[[variants]]
name = "random"
"""


@pytest.mark.slow
def test_variants_without_their_imagenet_weights_show_as_missing(folder, monkeypatch, capsys):
    def build(*args, backbone_weights, **options):
        if backbone_weights == "imagenet":
            raise ImagenetUnavailable("The ImageNet weights are far away;")
        return build_refocus_resnet50(*args, backbone_weights=backbone_weights, **options)

    monkeypatch.setattr("lf_flame.learning.training.build_refocus_resnet50", build)
    path = write(folder, IMAGENET, STUDY.replace("batch_size = 3", "epochs = 1"))
    text = run(path).read_text()
    rows = {line.split("|")[1].strip(): line for line in text.splitlines() if "|" in line}
    assert "missing" in rows["pre-trained"]
    assert "missing" not in rows["random"]
    assert "Left out: Keras cannot get its ImageNet weights" in capsys.readouterr().out


@pytest.mark.slow
def test_a_file_may_stand_in_for_keras_imagenet_weights(folder, monkeypatch):
    path = write(folder, IMAGENET)
    asked = []
    monkeypatch.setattr(
        "experiments.studies.study.train",
        lambda config, *_: asked.append(config.model.backbone_weights),
    )
    Path("weights.npz").touch()
    _, trials = read_study(path)
    for trial in trials:
        Path("work/data", trial.dataset_name).mkdir(parents=True, exist_ok=True)  # made before
        words = "study", str(path), "--work", "work", "--imagenet", "weights.npz"
        ended = CliRunner().invoke(commands, [*words, "--only", trial.variant.name])
        assert isinstance(ended.exception, InputError)
        assert "no finished run" in str(ended.exception)
    assert asked == ["weights.npz", "random"]
    # What is asked for stays, so that what is done with a file is done without naming it again.
    assert trials[0].request["training"]["model"]["backbone_weights"] == "imagenet"


def test_an_unknown_variant_is_named(folder):
    with pytest.raises(InputError, match="no variant 'moving'; it has as it is, another"):
        run(write(folder, BARS), only=["moving"])


@pytest.mark.parametrize(
    "path", sorted(ROOT.glob("experiments/studies/*.toml")), ids=lambda path: path.stem
)
def test_every_study_can_be_built(path, monkeypatch):
    monkeypatch.chdir(ROOT)
    study, trials = read_study(path)
    assert len(trials) == len(study.variants)
    tests = {tuple(trial.test) for trial in trials}
    assert len(tests) == 1
    asked = [json.dumps(trial.request) for trial in trials]
    assert len(set(asked)) == len(asked)  # no variant is another under a new name


def test_make_knows_every_study():
    text = (ROOT / "Makefile").read_text()
    for path in ROOT.glob("experiments/studies/*.toml"):
        assert f" {path.stem}.study" in text


def test_projection_leaves_the_least_error_there_is(rng):
    """On the samples themselves: the singular values left out (Eckart and Young 1936)."""
    targets = rng.uniform(0.3, 0.7, (12, 2, 6, 10)).astype(np.float32)
    values = np.linalg.svd((targets - targets.mean(0)).reshape(12, -1), compute_uv=False)
    for k in (1, 4, 8):
        found = np.sum((project(targets, targets, k) - targets) ** 2)
        assert found == pytest.approx(np.sum(values[k:] ** 2), rel=1e-4)


def test_bound_is_reached_by_what_is_drawn_from_k_pictures(rng):
    pictures = rng.uniform(0, 0.1, (5, 2, 8, 12))
    train, test = (
        (0.3 + np.tensordot(rng.uniform(0, 1, (n, 5)), pictures, 1)).astype(np.float32)
        for n in (30, 7)
    )
    bounds = [principal_component_bound(train, test, k) for k in (3, 5, 256)]
    assert bounds[0].max() < 50
    assert bounds[1].min() > 110  # rounding of float32
    np.testing.assert_allclose(bounds[2], bounds[1], atol=1.0)


def test_bands_take_chance_out_of_what_is_independent(rng):
    """Two things side by side, each drawn from 6 pictures, seen 8 times: together they are 12."""
    pictures = rng.uniform(0, 0.1, (2, 6, 1, 8, 10))

    def draw(n):
        weights = rng.uniform(0, 1, (2, n, 6))
        parts = [np.tensordot(w, p, 1) for w, p in zip(weights, pictures, strict=True)]
        return (0.2 + np.concatenate(parts, axis=-1)).astype(np.float32)

    train, test = draw(8), draw(20)
    together, apart = (principal_component_bound(train, test, 256, b)[0] for b in (1, 2))
    assert together < 50
    assert apart > 110


def test_bound_of_targets_that_never_change_is_that_of_their_mean(rng):
    train = np.broadcast_to(rng.uniform(size=(2, 6, 10)).astype(np.float32), (5, 2, 6, 10))
    test = rng.uniform(size=(3, 2, 6, 10)).astype(np.float32)
    np.testing.assert_allclose(project(train, test, 256), train[:3], atol=1e-6)


def test_crossing_is_where_a_curve_falls_through_a_level():
    x, y = np.array([0.0, 1.0, 2.0, 4.0]), np.array([50.0, 48.0, 44.0, 40.0])
    assert find_crossing(x, y, 45.0) == pytest.approx(1.75)
    assert find_crossing(x, y, 48.0) == pytest.approx(1.0)
    assert np.isnan(find_crossing(x, y, 39.0))
    assert np.isnan(find_crossing(x, y, 51.0))


@pytest.mark.parametrize(
    ("psnr", "words"),
    [
        ([46, 41, 40], "up to 330"),
        ([40, 41, 47], "from 1,900 on"),
        ([46, 47, 50], "everywhere"),
        ([40, 41, 42], "nowhere"),
    ],
)
def test_the_text_says_where_a_curve_is_above_the_paper(psnr, words):
    study = SimpleNamespace(x=SimpleNamespace(unit=""))
    rows = pd.DataFrame({"series": "a", "object": MEAN, "x": [250.0, 640.0, 2560.0]})
    (found,) = _findings(study, rows.assign(psnr_db=np.asarray(psnr, float)), 45.0)
    assert found.endswith(f"{words}.")


def test_the_bound_comes_from_the_first_training_targets(rng, monkeypatch):
    train, test = rng.uniform(size=(12, 1, 6, 8)), rng.uniform(size=(3, 1, 6, 8))
    whole, of_some = project(train, test, 4), project(train[:7], test, 4)
    assert np.abs(whole - of_some).max() > 0.01
    monkeypatch.setattr(pca_bound, "MOST_SAMPLES", 7)
    np.testing.assert_array_equal(project(train, test, 4), of_some)
