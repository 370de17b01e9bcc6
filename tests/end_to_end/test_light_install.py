"""Without what learning needs, all else works, and what needs it says so in one sentence."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from builders import scene_toml

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


PROGRAM = """
import json, sys
from lf_flame.commands import cli

for words in json.loads(sys.argv[1]):
    sys.argv = ["lf-flame", *words]
    try:
        cli.main()
    except SystemExit as ended:
        print("status", ended.code, file=sys.stderr)
"""


def run(folder, *calls):
    """Run calls in one process; give the status of each and what it says on standard error."""
    paths = os.pathsep.join([str(folder / "site"), str(ROOT)])
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, json.dumps(calls)],
        cwd=folder, env={**os.environ, "PYTHONPATH": paths}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    *said, rest = re.split(r"^status (\d+)\n", done.stderr, flags=re.MULTILINE)
    assert rest == ""
    return list(zip(map(int, said[1::2]), said[::2], strict=True))


SCENE = scene_toml(5, (40, 50), "triangle")


@pytest.mark.slow
def test_what_needs_no_learning_works_and_the_rest_says_what_to_install(light):
    (light / "scene.toml").write_text(SCENE)
    field = "simulated/scene/light_field.npz"
    shapes, systems = f"{ROOT}/experiments/shapes.toml", f"{ROOT}/experiments/systems.toml"
    working = (
        ["camera"],
        ["plan", "scene.toml"],
        ["simulate", "scene.toml"],
        ["refocus", field, "--search", "--map", "-2", "2"],
        ["convert", field, "views"],
        ["view", field, "--single-file", "page.html"],
    )
    learning = (
        ["dataset", f"{ROOT}/data_gen/shapes.toml", "--out", "shapes.zarr"],
        ["train", shapes],
        ["train-system", "refocusnet", "--config", systems, "--out", "run"],
        ["refocus", "field.npy", "--slope", "1", "--network", "."],
    )
    results = run(light, *working, *learning)
    for status, said in results[: len(working)]:
        assert status == 0, said
    assert (light / "page.html").exists()
    assert list((light / "refocused").glob("light_field*/slope_map.png"))
    assert len(list((light / "views").iterdir())) == 25
    for (status, said), words in zip(results[len(working) :], learning, strict=True):
        assert status == 2, (words, said)
        assert len([x for x in said.strip().splitlines() if not x.endswith(" ...")]) == 1, said
        assert "'.[learn]'" in said
    assert not (light / "run").exists()


@pytest.mark.slow
def test_help_and_inspect_see_all_names(light):
    code = "import inspect, pydoc, lf_flame as x; names = dict(inspect.getmembers(x)); "
    code += "print('models' in names, 'reconstruct' in pydoc.render_doc(x))"
    paths = os.pathsep.join([str(light / "site"), str(ROOT)])
    shown = subprocess.run(
        [sys.executable, "-c", code],
        cwd=light, env={**os.environ, "PYTHONPATH": paths}, capture_output=True, text=True,
    )  # fmt: skip
    assert shown.stdout == "True True\n", shown.stderr
