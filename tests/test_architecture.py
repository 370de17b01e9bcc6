"""Imports point one way, and importing stays light."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "lf_flame"

FLOORS = [
    ["errors"],
    ["_common"],
    ["lightfield"],
    ["optics"],
    ["scenes"],
    ["simulation"],
    ["simulation.planning"],
    ["simulation.rendering"],
    ["simulation.assumptions"],
    ["formats", "refocus"],
    ["calibration"],
    ["projection", "tomography", "viewer"],
    ["flame_video"],
    ["datasets"],
    ["learning"],
    ["models", "systems"],
    ["commands"],
    ["__main__"],
]
"""Rooms of the library, from the ground up: each may import those of lower floors, and itself.

A module inside a room has a floor of its own where it uses what the rest of its room must not."""

RANK = {room: floor for floor, rooms in enumerate(FLOORS) for room in rooms}
LIBRARY = sorted(path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py")


def module_of(path):
    """Dotted name of the module in a file."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_of(path) for path in LIBRARY}


def imports_of(path):
    """Modules that a file imports, those inside functions too."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            inner = [name for name in names if name in MODULES]
            yield from inner
            if len(inner) < len(names):
                yield node.module
        elif isinstance(node, ast.Call) and "import_module" in vars(node.func).values():
            yield from (one.value for one in node.args if isinstance(one, ast.Constant))


def room_of(name):
    """Room of the library that a module lies in: the longest name in `FLOORS` that holds it."""
    parts = name.split(".")[1:] if name.startswith("lf_flame.") else []
    heads = (".".join(parts[:count]) for count in range(len(parts), 0, -1))
    return next((head for head in heads if head in RANK), ".".join(parts[:1]))


@pytest.mark.slow
def test_imports_go_down_from_floor_to_floor():
    assert {room_of(module_of(path)) for path in LIBRARY} == set(RANK)
    wrong = []
    for path in LIBRARY:
        here = room_of(module_of(path))
        for name in imports_of(path):
            there, face = room_of(name), name == "lf_flame"
            # The face's names come from everywhere: for users and for the version.
            if name.split(".")[0] in ("experiments", "data_gen", "tests"):
                wrong.append((path, name))
            if face and here not in ("commands", "_common"):
                wrong.append((path, "the package's face"))
            if there and there != here and RANK[there] >= RANK[here]:
                wrong.append((path, f"{here} is not above {there}"))
    assert wrong == []


def test_kernels_import_only_numpy_numba_and_each_other():
    """Compiled code on disk goes stale with these files alone: see `_common.threads`."""
    kernels = [*PACKAGE.rglob("_*kernels.py")]
    assert kernels
    for path in kernels:
        folder = re.escape(module_of(path.parent / "x.py")[:-2])
        known = rf"math|typing|numpy|numba.*|lf_flame\._common\.threads|{folder}\._\w*kernels"
        assert [name for name in imports_of(path) if not re.fullmatch(known, name)] == [], path


def loaded_by(code):
    """Heavy packages that some code loads in a process of its own."""
    heavy = ("numba", "keras", "tensorflow", "matplotlib", "pandas", "zarr", "skimage", "scipy",
             "scipy.fft", "scipy.ndimage", "scipy.signal", "scipy.interpolate")  # fmt: skip
    code = f"import sys; {code}; print([m for m in {heavy} if m in sys.modules])"
    command = [sys.executable, "-c", code]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


LOADS = {
    "import lf_flame; lf_flame.PAPER_CAMERA": set(),
    # Parts of SciPy take longer to import than Numba, which loads no more of it than its name.
    "import numpy as np; from lf_flame.refocus import refocus; refocus(np.ones((2,) * 4), 0.5)":
        {"numba", "scipy", "scipy.fft"},
    "from lf_flame import render": {"numba", "scipy", "scipy.fft", "scipy.ndimage"},
    "import lf_flame.commands.cli, lf_flame.formats": {"numba", "scipy", "scipy.ndimage", "skimage",
                                                       "scipy.fft"},
}  # fmt: skip
"""Code, and heavy packages that it may load."""


@pytest.mark.parametrize(
    "code", [pytest.param(x, marks=[pytest.mark.slow] if LOADS[x] else []) for x in LOADS]
)
def test_heavy_packages_are_loaded_where_they_are_needed(code):
    assert set(eval(loaded_by(code))) <= LOADS[code]


def test_every_public_name_loads():
    """From the top and from every package, which are reached by attribute."""
    import lf_flame

    rooms = {path.parent.name for path in PACKAGE.glob("[a-z]*/__init__.py")}
    for room in rooms - {"commands"}:
        package = getattr(lf_flame, room)
        assert room in dir(lf_flame)
        assert package.__all__, room
        for name in package.__all__:
            assert getattr(package, name) is not None
            assert name in dir(package)
    for name in lf_flame.__all__:
        assert getattr(lf_flame, name) is not None
        assert name in dir(lf_flame)
    assert callable(lf_flame.render)  # the function, never a module of that name
