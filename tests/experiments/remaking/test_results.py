"""Which results are old, and how they are made again."""

import json
import subprocess

import pytest

from experiments.paths import REFERENCE
from experiments.remaking import steps
from experiments.remaking.steps import ROOT, Step, read_steps

STEPS = read_steps()

SINGLE = {"refocus", "regions", "effects"}
"""Folders of pictures and records that are no step's, or not whole."""


def test_every_committed_record_has_its_command():
    """And one alone."""
    for record in REFERENCE.glob("**/*.json"):
        if record.relative_to(REFERENCE).parts[0] not in SINGLE:
            makers = [step.command for step in STEPS if record in step.files(REFERENCE)]
            assert len(makers) == 1, (record, makers)


@pytest.mark.parametrize("step", STEPS, ids=[step.command for step in STEPS])
def test_what_a_step_measures_is_there(step):
    assert all((ROOT / path).exists() for path in step.measures)
    assert not any(name in step.measures for name in ("simulation", "data", "training"))


@pytest.mark.parametrize("step", STEPS, ids=[step.command for step in STEPS])
def test_records_name_their_revisions(step):
    assert all(len(one.rstrip("+")) == 12 for one in step.revisions(REFERENCE))


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """A checkout of two files, and a folder with a result that was made on its revision."""

    def git(*words):
        found = subprocess.run(
            ["git", "-c", "user.name=a", "-c", "user.email=a@b", *words],
            cwd=tmp_path, capture_output=True, text=True, check=True,
        )  # fmt: skip
        return found.stdout.strip()

    for name in ("measured.py", "other.py"):
        (tmp_path / name).write_text("1\n")
    git("init")
    git("add", ".")
    git("commit", "-m", "first")
    monkeypatch.setattr(steps, "ROOT", tmp_path)
    steps._changed.cache_clear()
    mine = tmp_path / "results"
    (mine / "some").mkdir(parents=True)
    record = {"git_revision": git("rev-parse", "--short=12", "HEAD")}
    (mine / "some" / "a.json").write_text(json.dumps(record))
    (mine / "some" / "a.md").write_text("# A\n\n## The reference result\n\nother\n")
    return tmp_path, mine


STEP = Step(["some/a.*"], "true", ["measured.py"], 1.0)


@pytest.mark.parametrize(
    ("changed", "state"), [(None, "current"), ("other.py", "current"), ("measured.py", "old")]
)
def test_a_result_is_old_when_what_it_measures_has_changed(checkout, changed, state):
    root, mine = checkout
    if changed:
        (root / changed).write_text("2\n")
    assert STEP.state(mine) == state


def test_a_result_of_changed_files_or_of_an_unknown_revision_is_old(checkout):
    _, mine = checkout
    record = mine / "some" / "a.json"
    revision = json.loads(record.read_text())["git_revision"]
    for other in (revision + "+", "0" * 12):
        record.write_text(json.dumps({"git_revision": other}))
        assert STEP.state(mine) == "old"
    record.unlink()
    assert STEP.state(mine) == "missing"


def test_what_is_adopted_is_the_result_alone(checkout, tmp_path):
    _, mine = checkout
    STEP.adopt(mine, tmp_path / "reference")
    kept = tmp_path / "reference" / "some"
    assert (kept / "a.md").read_text() == "# A\n"
    assert (kept / "a.json").read_bytes() == (mine / "some" / "a.json").read_bytes()
