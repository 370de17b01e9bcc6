"""Imports point one way, the library knows nothing of the repository, and importing stays light."""

import ast
import re
import subprocess
import sys
from functools import cache
from graphlib import CycleError, TopologicalSorter
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
EXPERIMENTS = sorted((ROOT / "experiments").rglob("*.py"))


def module_of(path):
    """Dotted name of the module in a file."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_of(path) for path in (*LIBRARY, *EXPERIMENTS)}


@cache
def imports_of(path):
    """Modules that a file imports, those inside functions too."""
    return tuple(_imports_of(path))


def _imports_of(path):
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


def circle_in(graph):
    """Find modules that import each other in a circle; none where there is no circle."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return error.args[1]
    return []


def test_no_two_files_import_each_other():
    """Neither inside a room nor around a corner, in the library or in the experiments."""
    graph = {}
    for path in (*LIBRARY, *EXPERIMENTS):
        me = module_of(path)
        graph[me] = {name for name in imports_of(path) if name in MODULES and name != me}
    assert circle_in(graph) == []


def test_every_room_has_a_floor_and_tells_what_it_holds():
    rooms = {room_of(module_of(path)) for path in LIBRARY}
    assert rooms == set(RANK)
    for path in (*PACKAGE.rglob("__init__.py"), *(ROOT / "experiments").rglob("__init__.py")):
        assert ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))), path


def test_the_library_knows_nothing_of_the_repository():
    """No path of it, no Make target, no table of the paper."""
    known = (
        r"experiments[/.]|data_gen/|python -m experiments|`make |\bmake [a-z]+`|Tables? I|"
        r"[A-Z]+=FILE|RUN=|PRESET="
    )
    found = [
        (path, line)
        for path in LIBRARY
        for line in path.read_text(encoding="utf-8").splitlines()
        if re.search(known, line)
    ]
    assert found == []


@pytest.mark.parametrize(
    "name", sorted(str(path.relative_to(PACKAGE)) for path in PACKAGE.rglob("_*kernels.py"))
)
def test_kernels_import_only_numpy_and_numba(name):
    """And other kernels of their folder, which import no third ones: see `_common.threads`."""
    shared = ("lf_flame._common.threads",)
    beside = {
        f"lf_flame.{'.'.join(path.relative_to(PACKAGE).with_suffix('').parts)}": path
        for path in (PACKAGE / name).parent.glob("_*kernels.py")
    }
    used = {
        next(
            (known for known in (*shared, *beside) if module.startswith(known)),
            module.split(".")[0],
        )
        for module in imports_of(PACKAGE / name)
    }
    assert used <= {"math", "typing", "numpy", "numba", *shared, *beside}
    for other in used & set(beside):
        assert not any(module.startswith("lf_flame") for module in imports_of(beside[other]))


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
    from lf_flame import (  # noqa: F401
        PAPER_CAMERA,
        InputError,
        Layer,
        LightField,
        PlenopticCamera,
        Scene,
        Sensor,
        plan_effects,
        read_light_field,
        render,
    )

    assert callable(lf_flame.render)  # the function, never a module of that name
