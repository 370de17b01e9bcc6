"""The revision in a record is that of this package's checkout, or none."""

import subprocess
import sys
from types import SimpleNamespace

import pytest

from lf_flame._common import provenance


@pytest.fixture
def git(tmp_path, monkeypatch):
    """Run git in somebody's repository, in which a copy of the package lies."""
    (tmp_path / "provenance.py").touch()
    (tmp_path / "notes.txt").touch()
    monkeypatch.setattr(provenance, "__file__", str(tmp_path / "provenance.py"))

    def call(*words):
        command = ["git", "-c", "user.name=a", "-c", "user.email=a@b", *words]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
        return done.stdout.strip()

    call("init", "-q")
    call("add", "notes.txt")
    call("commit", "-qm", "notes")
    return call


def test_only_programs_of_the_packages_own_repository_make_a_revision(git, tmp_path):
    assert provenance.environment()["git_revision"] is None  # somebody else's
    git("add", ".")
    git("commit", "-qm", "all")
    known = git("rev-parse", "--short=12", "HEAD")
    assert provenance.environment()["git_revision"] == known
    (tmp_path / "provenance.py").write_text("# changed")
    assert provenance.environment()["git_revision"] == f"{known}+"


@pytest.mark.parametrize(
    ("spec", "named"),
    [(SimpleNamespace(name="tool.__main__"), "python -m tool"), (None, "tool.py")],
)
def test_a_module_is_named_as_it_is_called(monkeypatch, spec, named):
    monkeypatch.setitem(sys.modules, "__main__", SimpleNamespace(__spec__=spec))
    monkeypatch.setattr(sys, "argv", ["/some/tool.py", "--out", "here\udce9"])  # not in UTF-8
    assert provenance.environment()["command"] == f"{named} --out 'here?'"
