"""Examples in the docstrings of all public names: each has one, and it runs."""

import doctest
import inspect
import re
from pathlib import Path

import pytest
from builders import scene_toml

import lf_flame

ROOT = Path(__file__).parents[1]

PACKAGE = ROOT / "lf_flame"

ROOMS = sorted(path.parent.name for path in PACKAGE.glob("[a-z]*/__init__.pyi"))

SCENE = scene_toml(9, (20, 30), depth_mm=10.0, side_mm=1.0)

WITHOUT_EXAMPLE = {
    "load_system", "open_run", "predict", "read_systems_config", "train", "train_system",
}  # fmt: skip
"""Names that need a trained network, or take longer than an example may."""


NAMES = ["projection.Projector"] + [
    f"{room}.{name}"
    for room in ROOMS
    for name in re.findall(
        r"^from \S+ import (\w+) as", (PACKAGE / room / "__init__.pyi").read_text(), re.MULTILINE
    )
]
"""Public names, from the packages' faces: importing all of them takes many seconds."""

assert {name.split(".")[1] for name in NAMES} >= WITHOUT_EXAMPLE


@pytest.fixture
def folder(tmp_path, monkeypatch, coarse_data):
    """The files that examples read, in the working folder."""
    (tmp_path / "scene.toml").write_text(SCENE)
    coarse = coarse_data[0].read_text().replace("views = 9", "views = 3")
    (tmp_path / "dataset.toml").write_text(coarse)
    training = (ROOT / "experiments" / "shapes.toml").read_text()
    (tmp_path / "training.toml").write_text(training)
    monkeypatch.chdir(tmp_path)


def examples_of(found):
    finder = doctest.DocTestFinder(recurse=False)
    return [test for test in finder.find(found, found.__name__) if test.examples]


SLOW = {
    "simulation.measure_changes", "viewer.demo_scene", "viewer.demo_light_field",
    "tomography.write_emission", "learning.build_refocus_resnet50",
    "systems.refocus_regions", "tomography.ReconstructionPlan", "datasets.make_dataset",
    "calibration.fit_targets",
}  # fmt: skip


@pytest.mark.parametrize(
    "name", [pytest.param(x, marks=[pytest.mark.slow] if x in SLOW else []) for x in NAMES]
)
def test_every_public_function_has_an_example_that_runs(name, folder):
    """And of the classes those that have one, as results need none."""
    found = getattr(getattr(lf_flame, name.split(".")[0]), name.split(".")[1])
    if not (inspect.isfunction(found) or inspect.isclass(found)):
        return
    tests = examples_of(found)
    assert tests or inspect.isclass(found) or name.split(".")[1] in WITHOUT_EXAMPLE
    for test in tests:
        assert doctest.DocTestRunner().run(test).failed == 0
