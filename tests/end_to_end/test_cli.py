"""The program as a user runs it: real processes, files, exit statuses."""

import json
import re
import shlex
import shutil
from pathlib import Path

import click
import numpy as np
import pandas as pd
import pytest
from builders import camera, scene_toml
from programs import run_here, without_graphs
from skimage.io import imread, imsave

from experiments import __main__
from lf_flame import PlenopticCamera
from lf_flame._common.threads import COMPILING
from lf_flame.commands import cli
from lf_flame.refocus import shift_and_sum

ROOT = Path(__file__).parents[2]

SCENE = scene_toml(3, (20, 30))


def experiment(*args, cwd=ROOT):
    return run_here(*args, cwd=cwd, program="experiments")


def assert_one_sentence(result, *parts):
    assert result.returncode == 2, result.stderr
    assert "Traceback" not in result.stderr
    said = result.stderr.replace(COMPILING, "").strip().splitlines()
    said = [line for line in said if not line.endswith(" ...")]  # what a slow machine is at
    assert len(said) == 1, result.stderr
    for part in parts:
        assert part in result.stderr


MOST_COMMANDS, MOST_LINES = 20, 42


def test_help_teaches_every_command_on_one_screen():
    """Rare options and details are shown by --help-all, in the same groups."""
    for gathered in (cli.commands, __main__.commands):
        context = gathered.make_context("program", [], resilient_parsing=True)
        shown = " ".join(gathered.get_help(context).split())
        assert len(gathered.commands) <= MOST_COMMANDS
        for name, command in gathered.commands.items():
            own = type(context)(command, parent=context, info_name=name, terminal_width=80)
            lines = command.get_help(own).splitlines()
            sentence = command.help.partition("\n\n")[0]
            assert " ".join(sentence.split()) in shown  # whole, not cut
            assert len(lines) <= MOST_LINES, name
            options = [x for x in command.params if isinstance(x, click.Option) and x.help]
            if any(option.hidden for option in options):
                whole = command.get_whole_help(own)
                assert all(option.opts[0] in whole for option in options), name
                assert command.get_help(own).splitlines() == lines  # it is put back


@pytest.mark.slow
def test_simulate_writes_what_it_says(tmp_path):
    imsave(tmp_path / "card.png", np.full((8, 8), 128, np.uint8), check_contrast=False)
    extra = '[[layers]]\nimage = "card.png"\ndepth_mm = -10.0\nsize_mm = [1.0, 1.0]\n'
    extra += "centre_mm = [0.0, 1.5]\n"
    (tmp_path / "scene.toml").write_text(SCENE + extra)
    result = run_here("simulate", "scene.toml", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    out = tmp_path / "simulated" / "scene"
    with np.load(out / "light_field.npz", allow_pickle=False) as arrays:
        views, refocused, depths = (arrays[k] for k in ("views", "refocused", "depths_mm"))
    assert views.shape == (3, 3, 20, 30)
    assert list(depths) == [5.0, -10.0]
    slopes = PlenopticCamera(**camera(3, (20, 30))).depth_to_slope(depths)
    np.testing.assert_allclose(refocused, shift_and_sum(views, slopes), atol=1e-6)
    raw = imread(out / "raw.tif")
    assert raw.shape == (60, 90)
    np.testing.assert_array_equal(raw[0::3, 1::3], views[0, 1])
    np.testing.assert_array_equal(imread(out / "refocused.tif"), refocused)
    png = imread(out / "refocused_2_-10mm.png")
    white = json.loads((out / "simulation.json").read_text())["radiance_of_white_in_png"]
    assert white == views.max() > 1  # the card and the circle's blur overlap: their light adds
    np.testing.assert_allclose(png / 255, refocused[1] / white, atol=0.003)
    assert {"raw.png", "views.png", "simulation.json"} <= {p.name for p in out.iterdir()}
    assert not list(out.glob(".*"))
    forced = ["--on", "occlusion", "--off", "defocus"]
    planned = run_here("plan", "scene.toml", *forced, cwd=tmp_path).stdout
    assert re.search(r"(?ms)^defocus .* left out, forced .*^occlusion .* kept, forced ", planned)


def test_make_names_folders_after_the_seed_and_sets_others_beside(asked, tmp_path):
    """The seed goes to the training; committed results that are there stand beside, untouched."""
    results = tmp_path / "experiments" / "results"
    alone = asked("tables", "SEED=2")
    assert alone.count("--preset paper --data data/paper/") == 2
    for kind in ("shapes", "flames"):
        assert re.search(rf"--out runs/paper-seed2/{kind} .*--seed 2 *\n", alone)
    assert alone.count("--out results/paper-seed2 --seed 2") == 2  # the baselines' split
    kept = "--out results/paper-seed2/tables.md"
    assert re.search(rf"tables results/paper-seed2 +{kept}$", alone)
    committed = ("paper", "paper-conv5", "paper-seed2", "paper-seed3")
    for name in (*committed, "smoke"):
        (results / name).mkdir(parents=True)
    together = asked("tables", "SEED=2").strip().splitlines()[-1].split()
    at = together.index("tables")
    assert together[at + 1] == "results/paper-seed2"
    assert set(together[at + 2 : -2]) == {f"experiments/results/{name}" for name in committed}
    assert "--seed" not in asked("tables")
    assert asked("tables", "EPOCHS=7").count("--epochs 7\n") == 2


def test_make_passes_any_path_of_weights_as_one_word(asked):
    for path in ("a file.h5", "it's.h5", 'a "b".h5'):
        found = asked("train-flame", f"BACKBONE_WEIGHTS={path}").strip().splitlines()[-1]
        words = shlex.split(found)
        assert words[words.index("--backbone-weights") + 1] == path


def test_make_trains_the_papers_method_by_the_clock_and_goes_on(asked, tmp_path):
    """Flames first; a run that has come to its last epoch is left alone."""

    def trained(*words):
        text = asked(*words)
        pattern = r"lf-flame train experiments/(\w+).toml --preset (\S+) --data"
        return re.findall(pattern, text), text

    found, text = trained("tables")
    assert found == [("flames", "paper"), ("shapes", "paper")]
    assert text.count("--minutes 4 ") == 2
    assert text.count("--preset paper --route rays ") == 2
    assert text.index("lf-flame train") < text.index("lf-flame dataset")
    assert "--minutes 0 " in trained("train-flame", "MINUTES=0")[1]
    made = ["data/paper/flames.zarr/zarr.json", "runs/paper/flames/model.keras", ".venv/installed"]
    for name in made:
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).touch()
    for finished, again in (("false", [("flames", "paper")]), ("true", [])):
        (tmp_path / "runs/paper/flames/run.json").write_text(f' "finished": {finished},\n')
        assert trained("train-flame")[0] == again
        assert trained("results/paper/table2.csv")[0] == again
        assert ("flames", "paper") not in trained("costs")[0]  # measures what is there
    # Weights other than those of a finished run are refused by `train`, not passed over.
    assert trained("train-flame", "BACKBONE_WEIGHTS=random")[0] == [("flames", "paper")]


@pytest.mark.slow
def test_from_data_set_to_table(tmp_path):
    """Every step that make runs, on a data set of twelve samples."""
    text = (ROOT / "data_gen" / "flames.toml").read_text()
    for old, new in (
        ("smoke = 20", "smoke = 12"),
        ("image = [90, 180]", "image = [45, 90]"),
        ("lenslets = [270, 540]", "lenslets = [45, 90]"),
        ("lenslet_focal_mm = 0.4", "lenslet_focal_mm = 2.4"),
        ("= 0.112", "= 0.672"),
        ("views = 15", "views = 5"),
    ):
        assert text.count(old) == 1
        text = text.replace(old, new)
    (tmp_path / "flames.toml").write_text(text)
    shutil.copytree(
        ROOT / "experiments", tmp_path / "experiments", ignore=shutil.ignore_patterns("results")
    )
    data = ["dataset", "flames.toml", "--preset", "smoke", "--out", "flames.zarr", "--workers", "1"]
    assert run_here(*data, cwd=tmp_path).returncode == 0
    again = run_here(*data, cwd=tmp_path)
    assert "is complete: 12 samples" in again.stdout
    rays = run_here(*data, "--route", "exact", cwd=tmp_path)
    assert_one_sentence(rays, "another configuration or size")
    (tmp_path / "flames.toml").write_text(text.replace("seed = 20251", "seed = 1"))
    assert_one_sentence(run_here(*data, cwd=tmp_path), "another configuration or size")
    training = [
        "train", "experiments/flames.toml", "--preset", "smoke", "--data", "flames.zarr",
        "--out", "run", "--backbone-weights", "random", "--backbone-depth", "conv3", "--seed", "2",
    ]  # fmt: skip
    with without_graphs():
        result = run_here(*training, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "Weights of the backbone: random (seed 2), conv3." in result.stderr
    result = experiment("evaluate", "run", "--out", "results", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    table = pd.read_csv(tmp_path / "results" / "table2.csv")
    assert list(table.columns) == [
        "depth_mm", "object", "ssim", "ssim_sd", "psnr_db", "psnr_sd",
        "paper_ssim", "paper_psnr_db", "n_test", "psnr_foreground_db", "psnr_foreground_sd",
    ]  # fmt: skip
    assert list(table.depth_mm) == [20, 10, 0, -10]
    assert f"{table.psnr_db[0]:.3f} |           41.64 |" in result.stdout
    assert table.psnr_db.between(3, 60).all()
    assert (table.psnr_foreground_db != table.psnr_db).all()
    assert imread(tmp_path / "results" / "figure8.png").shape[0] > 500
    fitted = "baselines flames.zarr experiments/flames.toml --seed 2 --out results"
    assert experiment(*fitted.split(), cwd=tmp_path).returncode == 0
    shown = experiment("tables", "results", cwd=tmp_path).stdout
    assert "weights random, conv3. Trained for 2 of the paper's 1,000 epochs" in shown
    assert "| linear: ridge from the picture, no network" in shown
    assert "No result of this table: results." in shown  # Table I was not run
    reference = ROOT / "experiments" / "results" / "paper"
    beside = experiment("tables", "results", reference, "--out", "both.md", cwd=tmp_path).stdout
    assert (tmp_path / "both.md").read_text() == beside.rstrip("\n") + "\n"
    assert imread(tmp_path / "both.png").shape[1] > 1000
    row = "this run, results: ResNet-50 (random weights), first three stages, preset smoke |"
    assert f"{row} 2 of 1,000 |" in " ".join(beside.split())
    record = json.loads((tmp_path / "results" / "table2.json").read_text())
    assert record["seed"] == 2
