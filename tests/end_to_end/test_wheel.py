"""The wheel, installed elsewhere: the viewer works from it as from a checkout."""

import os
import shutil
import subprocess
import sys
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


def run(site, folder, *words):
    """Run Python with the installed package; what it compiles is tested elsewhere."""
    known = {**os.environ, "PYTHONPATH": str(site), "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(
        [sys.executable, *words], cwd=folder, env=known, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_light_field_is_written_as_one_page(site, tmp_path):
    """With the viewer's scripts, and nothing of the checkout."""
    code = "import lf_flame; print(lf_flame.__file__)"
    assert run(site, tmp_path, "-c", code).startswith(str(site))
    leaves = DeadLeaves().draw((3, 3), (20, 30), np.random.default_rng(3)).views
    np.save(tmp_path / "leaves.npy", leaves.clip(0, 1))
    options = ("--slopes", "-2", "2", "--no-map", "--single-file", "page.html")
    said = run(site, tmp_path, "-m", "lf_flame", "view", "leaves.npy", *options)
    assert "page.html is written" in said
    text = (tmp_path / "page.html").read_text()
    assert 'id="lf-piece-0"' in text
    assert "data:text/javascript;base64," in text
