"""The wheel, installed aside: the viewer works from it as from a checkout."""

import os
import re
import shutil
import subprocess
import sys
import urllib.request
import zipfile
from pathlib import Path

import numpy as np
import pytest

from lf_flame.scenes.dead_leaves import DeadLeaves

ROOT = Path(__file__).parents[2]

pytestmark = pytest.mark.slow

PIP = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A folder in which the wheel of this checkout is unpacked, and nothing else."""
    pytest.importorskip("setuptools", reason="a wheel is built by setuptools")
    folder = tmp_path_factory.mktemp("wheel")
    for name in ("setup.cfg", "pyproject.toml", "README.md", "LICENSE"):
        (folder / "source").mkdir(exist_ok=True)
        shutil.copy(ROOT / name, folder / "source" / name)
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "lf_flame", folder / "source" / "lf_flame", ignore=ignored)
    words = ["wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", folder, folder / "source"]
    subprocess.run([*PIP, *words], check=True)
    (wheel,) = folder.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(folder / "site")  # all that an installer does, but scripts
    return folder / "site"


@pytest.fixture(scope="module")
def program(site, tmp_path_factory):
    """Start the installed program in a folder of its own; what it compiles is tested elsewhere."""
    folder = tmp_path_factory.mktemp("work")

    def start(*words, module=("-m", "lf_flame")):
        return subprocess.Popen(
            [sys.executable, *module, *words],
            cwd=folder, env={**os.environ, "PYTHONPATH": str(site), "NUMBA_DISABLE_JIT": "1"},
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip

    start.folder = folder
    return start


def output(process):
    """What a program prints; it must end well."""
    said, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors
    return said


@pytest.fixture(scope="module")
def sources(program):
    """A folder with a lenslet image."""
    leaves = DeadLeaves().draw((3, 3), (20, 30), np.random.default_rng(3)).views
    np.save(program.folder / "leaves.npy", leaves.clip(0, 1))
    output(program("convert", "leaves.npy", "lenslets.png"))
    return program.folder


def test_nothing_of_the_checkout_is_used(program, site):
    code = "import lf_flame, lf_flame.refocus as r; print(lf_flame.__file__, r.shift_and_sum)"
    assert output(program(module=("-c", code))).startswith(str(site))


VIEW = ("view", "lenslets.png", "--views=3", "--slopes", "-2", "2", "--no-map")


def test_light_fields_are_shown(program, sources):
    process = program(*VIEW, "--no-browser")
    try:
        url = process.stdout.readline().strip()
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/[\w-]{16,}/", url), process.stderr.read()
        with urllib.request.urlopen(url) as answer:
            page = answer.read().decode()
        for name in re.findall(r'"(static/[^"]+)"', page):
            with urllib.request.urlopen(url + name) as answer:
                assert answer.read()
        with urllib.request.urlopen(url + "views/0") as answer:
            assert np.ptp(np.frombuffer(answer.read(), "u1")) > 0
    finally:
        process.kill()
        process.communicate()


def test_light_fields_are_written_as_one_file(program, sources):
    said = output(program(*VIEW, "--single-file", "page.html"))
    assert "page.html is written" in said
    text = (sources / "page.html").read_text()
    assert 'id="lf-piece-0"' in text
    assert "data:text/javascript;base64," in text


def test_a_notebook_has_its_widget(program):
    pytest.importorskip("anywidget", reason="needs anywidget")
    code = (
        "import numpy, lf_flame\n"
        "from lf_flame.viewer import show\n"
        "widget = show(lf_flame.LightField(numpy.eye(9).reshape(3, 3, 3, 3)), with_map=False)\n"
        "print(len(widget._esm), widget.metadata['views'])"
    )
    length, views = output(program(module=("-c", code))).split(" ", 1)
    assert int(length) > 10_000
    assert views == "[3, 3]\n"
