"""A copy of what make needs, in which nothing is made."""

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def asked(tmp_path):
    """What make would do in a copy of this checkout without results, which is `tmp_path`."""
    for name in ("Makefile", "setup.cfg", "pyproject.toml"):
        shutil.copy(ROOT / name, tmp_path)
    for folder in ("data_gen", "experiments"):
        ignored = shutil.ignore_patterns("results", "__pycache__")
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=ignored)

    def ask(*words):
        command = ["make", "--no-print-directory", "-n", *words]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
        return done.stdout.replace("\\\n", "")  # lines that go on

    return ask
