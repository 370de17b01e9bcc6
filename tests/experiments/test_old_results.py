"""Which committed results are older than their code."""

import subprocess

import pytest

from experiments import old_results
from experiments.old_results import CODE, ROOT, TABLES, age


def test_folders_that_results_rest_on_exist():
    for paths in (TABLES, *CODE.values()):
        assert [path for path in paths.split() if not (ROOT / path).exists()] == []


@pytest.mark.parametrize(
    ("changed", "told"),
    [("lf_flame/viewer/page.py", "commits since: 1, last 20"), ("README.md", "current")],
)
def test_a_result_is_old_when_its_code_has_changed(tmp_path, monkeypatch, changed, told):
    def git(*words):
        command = ["git", "-c", "user.name=a", "-c", "user.email=a@b", *words]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)

    monkeypatch.setattr(old_results, "ROOT", tmp_path)
    git("init")
    git("commit", "--allow-empty", "-m", "first")
    revision = git("rev-parse", "--short=12", "HEAD").stdout.strip()
    (tmp_path / changed).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / changed).write_text("1\n")
    git("add", ".")
    git("commit", "-m", "second")
    assert age("screenshots/screenshots.json", revision).startswith(told)
    assert age("screenshots/screenshots.json", revision + "+").endswith("of edited files")
    assert age("screenshots/screenshots.json", "0" * 12) == "git does not know this revision"
