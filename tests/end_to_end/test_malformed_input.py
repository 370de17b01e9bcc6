"""What cannot be used ends every command in one sentence, with status 2 and nothing written."""

import json
import os
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from builders import RUN, camera, scene_toml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from experiments import __main__
from lf_flame.commands import cli, program

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "experiments" / "results"

SCENE = scene_toml(3, (6, 8), depth_mm=0.5, side_mm=0.4)

CAMERA = camera(3, (6, 8))


def ended(arguments, gathered=cli.commands):
    """Run a command as a program; give its status, and what it says on standard error."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Image, "MAX_IMAGE_PIXELS", Image.MAX_IMAGE_PIXELS)
        patch.setattr(os, "environ", os.environ.copy())
        patch.setattr(sys, "argv", ["program", *map(str, arguments)])
        with pytest.raises(SystemExit) as caught:
            program.run(gathered, "program")
    return caught.value.code


def content():
    """Every file below the working folder, by its size and when it was written."""
    found = {path: path.lstat() for path in Path().rglob("*") if not path.is_dir()}
    return {path: (status.st_size, status.st_mtime_ns) for path, status in found.items()}


@pytest.fixture
def refuse(tmp_path, monkeypatch, capfd):
    """Run a command that must refuse what it is given, in a folder of its own."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments, gathered=cli.commands):
        before = content()
        capfd.readouterr()
        assert ended(arguments, gathered) == 2
        told = capfd.readouterr().err
        assert "Traceback" not in told
        assert len(told.encode()) < 1000
        sentence = told.splitlines()[-1]  # before it, what was found so far, or how it is used
        assert sentence.startswith(("program: ", "Error: "))
        assert content() == before
        return sentence

    return call


def scene(**changes):
    """Write a scene file with some of its lines changed or added to the layer."""
    text = SCENE
    for name, value in changes.items():
        line = f"{name} = {value}"
        text, found = re.subn(rf"{name} = .*", lambda _, line=line: line, text)
        text += "" if found else line + "\n"
    Path("scene.toml").write_text(text)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"views": 10**10}, "of 1 to 100000 each"),
        ({"lenslets": "[90000, 90000]"}, "The light field would need"),
        ({"views": "[1"}, "is not a TOML file"),
        ({"shape": "[" * 5000}, "is not a TOML file: maximum recursion depth"),
    ],
    ids=lambda value: str(value)[:40],
)
def test_scenes(refuse, changes, words):
    scene(**changes)
    assert words in refuse("simulate", "scene.toml")


@pytest.mark.parametrize(
    "command",
    [["camera", "{}"], ["dataset", "{}", "--out", "o"], ["refocus", "views.npy", "--camera", "{}"]],
    ids=lambda command: " ".join(command),
)
@pytest.mark.parametrize("name", ["pipe", "deep.toml", "large.toml"])
def test_configurations(refuse, tmp_path, command, name):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "deep.toml").write_text("a = " + "[" * 10_000)
    (tmp_path / "large.toml").touch()
    os.truncate(tmp_path / "large.toml", (1 << 26) + 1)
    np.save(tmp_path / "views.npy", np.zeros((3, 3, 6, 8), np.float32))
    assert f"{name} " in refuse(*(name if word == "{}" else word for word in command))


TRAIN = f"train {ROOT}/experiments/shapes.toml --out r"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("simulate none.toml", "does not exist"),
        (f"tables {RESULTS / 'paper'} none", "There is no results folder"),
        (f"{TRAIN} --data x --preset smoke", "There is no data set at"),
        (f"{TRAIN} --data . --preset big", "one of paper, smoke, got 'big'"),
        (f"{TRAIN} --data . --seed 1000001", "seed must be 0 to 1000000, got 1000001"),
    ],
)
def test_what_is_not_there(refuse, words, said):
    ours = words.startswith("tables")
    assert said in refuse(*words.split(), gathered=(__main__ if ours else cli).commands)


def test_names_and_links(refuse, tmp_path):
    (tmp_path / "loop").symlink_to("loop")
    scene()
    np.save(tmp_path / "views.npy", np.zeros((3, 3, 6, 8), np.float32))
    for command in (["simulate", "scene.toml"], ["refocus", "views.npy"],
                    ["predict", "a.png", "--model", "m"], ["dataset", "scene.toml"]):  # fmt: skip
        assert "symbolic links" in refuse(*command, "--out", "loop")
        assert "must be a folder" in refuse(*command, "--out", "/dev/null")
    assert "symbolic links" in refuse("refocus", "loop")
    assert "symbolic links" in refuse("convert", "views.npy", "loop")


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.sampled_from(["views", "layers", "kind", "a"]), inner, max_size=3)
    ),
    max_leaves=6,
)


@pytest.mark.slow
@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(key=st.sampled_from(sorted(RUN)), value=VALUES)
def test_any_value_in_a_record_is_taken_or_refused(tmp_path_factory, key, value):
    """Never a traceback: `ended` would raise what is no exit."""
    folder = tmp_path_factory.mktemp("run")
    (folder / "run.json").write_text(json.dumps(RUN | {key: value}))
    (folder / "model.keras").write_bytes(b"")
    assert ended(["predict", "a.png", "--model", folder, "--out", folder / "o"]) == 2


@pytest.mark.slow
@settings(max_examples=20, deadline=None, suppress_health_check=list(HealthCheck))
@given(name=st.sampled_from(sorted(CAMERA)), value=VALUES)
def test_any_value_in_a_camera_is_taken_or_refused(tmp_path_factory, name, value):
    folder = tmp_path_factory.mktemp("camera")
    path = folder / "simulation.json"
    path.write_text(json.dumps({"camera": {**CAMERA, name: value}}))
    np.save(folder / "views.npy", np.zeros((3, 3, 6, 8), np.float32))
    options = ["--camera", path, "--depth-mm", "1", "--out", folder / "o"]
    assert ended(["refocus", folder / "views.npy", *options]) in (0, 2)
