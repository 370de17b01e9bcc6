"""Dependencies point one way, and importing the optics stays light."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "lf_flame"

LAYERS = [
    {"errors", "files", "keras_loading"},
    {"_kernels", "_leaves_kernels", "transfer", "sensor", "diffraction"},
    {"camera", "footprint", "conventions"},
    {"scene", "shapes", "flames", "leaves", "lightfield", "formats"},
    {"planes", "integrators"},
    {"survey", "effects", "plan"},
    {"render", "forward", "closed_form", "refocus"},
    {"config", "provenance", "templates", "scenefile", "paper"},
    {"encodings", "datasets", "cases"},
    {"backbone", "models", "_adam", "checkpoints", "runs", "trainers", "ridge", "warmstart"},
    {"training", "evaluation", "comparison", "bottleneck"},
    {"figures", "simulate", "refocusing", "report", "costs"},
    {"costs_report", "refocus_costs"},
    {"refocus_costs_report"},
    {"studies", "studies_report"},
    {"systems"},
    {"swaptest", "swaptest_report"},
    {"network", "prediction"},
    {"latency"},
    {"latency_report"},
    {"light_field_commands", "model_commands", "study_commands", "system_commands"},
    {"cli"},
]
"""A module imports only from its own layer and from those above it in this list."""

RANK = {module: rank for rank, modules in enumerate(LAYERS) for module in modules}
FILES = sorted(path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py")


def module_of(path):
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imports_of(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_dependencies_point_one_way(path):
    rank = RANK[module_of(path)]
    for name in imports_of(path):
        parts = name.split(".")
        assert parts[0] not in ("experiments", "data_gen", "tests"), name
        if parts[0] == "lf_flame" and len(parts) > 1 and parts[1] in RANK:
            assert RANK[parts[1]] <= rank, f"{path.name} must not import {name}"


@pytest.mark.parametrize(
    "name", sorted(str(path.relative_to(PACKAGE)) for path in PACKAGE.rglob("_*kernels.py"))
)
def test_kernels_import_only_numpy_and_numba(name):
    used = {module.split(".")[0] for module in imports_of(PACKAGE / name)}
    assert used <= {"math", "numpy", "numba"}


def test_importing_the_package_loads_neither_numba_nor_keras():
    code = (
        "import sys, lf_flame; lf_flame.PAPER_CAMERA; "
        "print([m for m in ('numba', 'keras', 'tensorflow', 'matplotlib') if m in sys.modules])"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert shown.stdout.strip() == "[]"


def test_every_public_name_loads():
    import lf_flame

    for name in (
        "PlenopticCamera",
        "PAPER_CAMERA",
        "Scene",
        "Layer",
        "LightField",
        "render",
        "Sensor",
        "plan_effects",
    ):
        assert getattr(lf_flame, name) is not None
        assert name in dir(lf_flame)
