"""Without what learning needs, all else works, and what needs it says so in one sentence."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from builders import scene_toml

from lf_flame._common.threads import COMPILING

ROOT = Path(__file__).parents[2]

ABSENT = ("keras", "tensorflow", "jax", "pandas", "zarr", "anywidget")

BLOCKER = f"""
import sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {ABSENT}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name.partition(".")[0])

sys.meta_path.insert(0, Absent())
"""


@pytest.fixture(scope="module")
def light(tmp_path_factory):
    """A folder in which the program runs as if only the base were installed."""
    folder = tmp_path_factory.mktemp("light")
    (folder / "site").mkdir()
    (folder / "site" / "sitecustomize.py").write_text(BLOCKER)
    return folder


def run(folder, *args, program=("-m", "lf_flame")):
    paths = os.pathsep.join([str(folder / "site"), str(ROOT)])
    return subprocess.run(
        [sys.executable, *program, *map(str, args)],
        cwd=folder, env={**os.environ, "PYTHONPATH": paths}, capture_output=True, text=True,
    )  # fmt: skip


SCENE = scene_toml(5, (40, 50), "triangle")


@pytest.mark.slow
def test_simulation_and_refocusing_work(light):
    (light / "scene.toml").write_text(SCENE)
    field = "simulated/scene/light_field.npz"
    calls = (
        ["camera"],
        ["plan", "scene.toml"],
        ["simulate", "scene.toml"],
        ["refocus", field, "--search", "--map", "-2", "2"],
        ["refocus-regions", field, "--region", "8", "30", "8", "30", "--slopes", "-2", "2"],
        ["convert", field, "views"],
        ["view", field, "--single-file", "page.html"],
    )
    one_by_one = (
        "import json, sys; from lf_flame.commands import cli\n"
        "for words in json.loads(sys.argv[1]): cli.commands.main(words, standalone_mode=False)"
    )
    result = run(light, json.dumps(calls), program=("-c", one_by_one))
    assert result.returncode == 0, result.stderr
    assert (light / "page.html").exists()
    assert (light / "refocused" / "light_field" / "slope_map.png").exists()
    assert len(list((light / "views").iterdir())) == 25


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments",
    [
        ["dataset", ROOT / "data_gen" / "shapes.toml", "--out", "shapes.zarr"],
        ["train", ROOT / "experiments" / "shapes.toml", "--data", "x", "--out", "run"],
        ["train-system", "refocusnet", "--config", ROOT / "experiments" / "systems.toml",
         "--out", "run"],
        ["export", "run", "--out", "network.keras"],
        ["predict", "picture.png", "--model", "run"],
        ["refocus", "field.npy", "--slope", "1", "--network", "."],
    ],
    ids=lambda arguments: str(arguments[0]),
)  # fmt: skip
def test_what_needs_learning_says_what_to_install(light, arguments):
    result = run(light, *arguments)
    assert result.returncode == 2, result.stderr
    said = result.stderr.replace(COMPILING, "").strip().splitlines()
    assert len([line for line in said if not line.endswith(" ...")]) == 1, result.stderr
    assert "pip install 'lf_flame[learn]'" in result.stderr
    assert not (light / "run").exists()
