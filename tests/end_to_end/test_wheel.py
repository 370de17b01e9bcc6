"""The wheel, installed aside: the viewer works from it as from a checkout."""

import os
import re
import shutil
import subprocess
import sys
import urllib.request
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]

pytestmark = pytest.mark.slow

PIP = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A folder in which the wheel of this checkout is installed, and nothing else."""
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
    subprocess.run([*PIP, "install", "--no-deps", "--target", folder / "site", wheel], check=True)
    return folder / "site"


@pytest.fixture(scope="module")
def program(site, tmp_path_factory):
    """Start the installed program in a folder of its own."""
    folder = tmp_path_factory.mktemp("work")

    def start(*words, module=("-m", "lf_flame")):
        return subprocess.Popen(
            [sys.executable, *module, *words],
            cwd=folder, env={**os.environ, "PYTHONPATH": str(site)},
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
    """A packaged scene, a folder of views and a lenslet image."""
    output(program("demo", "--save", "demo.npy", "--single-file", "demo.html"))
    output(program("convert", "demo.npy", "views", "--bits", "8"))
    output(program("convert", "demo.npy", "lenslets.png"))
    return program.folder


def test_nothing_of_the_checkout_is_used(program, site):
    code = "import lf_flame, lf_flame.refocus as r; print(lf_flame.__file__, r.shift_and_sum)"
    assert output(program(module=("-c", code))).startswith(str(site))


CALLS = [["lenslets.png", "--views=9"], ["views", "--interpolation=sinc"]]


@pytest.mark.parametrize("words", CALLS, ids=" ".join)
def test_light_fields_are_shown(program, sources, words):
    process = program("view", *words, "--no-browser", "--slopes", "-2", "2")
    try:
        url = process.stdout.readline().strip()
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/[\w-]{16,}/", url), process.stderr.read()
        with urllib.request.urlopen(url) as answer:
            page = answer.read().decode()
        for name in re.findall(r'"(static/[^"]+)"', page):
            with urllib.request.urlopen(url + name) as answer:
                assert answer.read()
        sinc = "--interpolation=sinc" in words
        query = "plane?slope=1&shape=square&width=1&ring=0&v=0&u=0&block=1"
        with urllib.request.urlopen(url + (query if sinc else "views/0")) as answer:
            assert np.ptp(np.frombuffer(answer.read(), "<f4" if sinc else "u1")) > 0
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize("words", CALLS[:1], ids=" ".join)
def test_light_fields_are_written_as_one_file(program, sources, words):
    said = output(program("view", *words, "--single-file", "page.html", "--slopes", "-2", "2"))
    assert "page.html is written" in said
    text = (sources / "page.html").read_text()
    assert 'id="lf-piece-0"' in text
    assert "data:text/javascript;base64," in text


def test_the_demo_is_one_file(sources):
    assert "Three flames before a wall" in (sources / "demo.html").read_text()


def test_a_notebook_has_its_widget(program):
    pytest.importorskip("anywidget", reason="needs anywidget")
    code = (
        "from lf_flame.viewer import demo_light_field, show\n"
        "widget = show(demo_light_field(), with_map=False)\n"
        "print(len(widget._esm), widget.metadata['views'])"
    )
    length, views = output(program(module=("-c", code))).split(" ", 1)
    assert int(length) > 10_000
    assert views == "[9, 9]\n"
