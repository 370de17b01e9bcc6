"""The revision in a record is that of this package's checkout, or none."""

import subprocess
import sys
from pathlib import Path

import pytest

from lf_flame._common import provenance


def git(folder, *args):
    settings = ("-c", "user.name=a", "-c", "user.email=a@b")
    return subprocess.run(
        ["git", *settings, *args], cwd=folder, capture_output=True, text=True, check=True
    ).stdout.strip()


@pytest.fixture
def checkout(tmp_path):
    """A repository of somebody's, in which a copy of the package lies."""
    package = Path(provenance.__file__).parents[1]
    (tmp_path / "lf_flame" / "_common").mkdir(parents=True)
    for name in ("__init__.py", "_common/__init__.py", "_common/provenance.py"):
        source = package / name
        (tmp_path / "lf_flame" / name).write_text(
            "" if name == "__init__.py" else source.read_text()
        )
    git(tmp_path, "init", "-q")
    (tmp_path / "notes.txt").write_text("mine")
    git(tmp_path, "add", "notes.txt")
    git(tmp_path, "commit", "-qm", "notes")
    return tmp_path


def revision(folder):
    code = "from lf_flame._common.provenance import environment as e; print(e()['git_revision'])"
    command = [sys.executable, "-c", code]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout


def test_somebody_elses_repository_is_not_the_revision(checkout):
    assert revision(checkout).strip() == "None"


def test_results_and_texts_do_not_make_a_revision_another_programs_do(checkout):
    git(checkout, "add", ".")
    git(checkout, "commit", "-qm", "all")
    known = git(checkout, "rev-parse", "--short=12", "HEAD")
    (checkout / "notes.txt").write_text("changed")
    assert revision(checkout).strip() == known
    (checkout / "lf_flame" / "__init__.py").write_text("# changed")
    assert revision(checkout).strip() == f"{known}+"


@pytest.mark.parametrize(
    ("arguments", "named"),
    [(("-m", "tool"), "python -m tool"), (("tool/__main__.py",), "__main__.py")],
)
def test_a_module_is_named_as_it_is_called(tmp_path, arguments, named):
    code = "from lf_flame._common.provenance import environment; print(environment()['command'])"
    (tmp_path / "tool").mkdir()
    (tmp_path / "tool" / "__init__.py").touch()
    (tmp_path / "tool" / "__main__.py").write_text(code)
    command = [sys.executable, *arguments, "--out", "here"]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert result.stdout.strip() == f"{named} --out here"
