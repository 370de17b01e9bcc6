"""The page on data sets, done as it says, in an empty folder."""

import re
from pathlib import Path

import pytest
from programs import run_here

PAGE = (Path(__file__).parents[2] / "docs" / "data_sets.md").read_text(encoding="utf-8")

FEWER = (("small = 64", "small = 16"), ("# (64, ", "# (16, "), ("cluster 2", "cluster 1"))
"""What is done with fewer samples and processes than the page says."""


def blocks(text, language):
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


@pytest.mark.slow
def test_the_page_does_what_it_says(tmp_path, monkeypatch, capsys):
    pytest.importorskip("distributed")
    monkeypatch.chdir(tmp_path)
    text = PAGE
    for old, new in FEWER:
        assert old in text
        text = text.replace(old, new)
    (settings,) = blocks(text, "toml")
    (tmp_path / "two_flames.toml").write_text(settings)
    commands = [line.split() for block in blocks(text, "sh") for line in block.splitlines()]
    assert len(commands) == 2
    for program, *arguments in commands:
        assert program == "lf-flame"
        done = run_here(*arguments, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    example, fresh = blocks(text, "py")
    last = {}
    exec(fresh, last)
    assert (last["inputs"].shape, last["targets"].shape) == ((16, 30, 60, 1), (16, 2, 30, 60))
    capsys.readouterr()
    exec(example, {})
    printed = capsys.readouterr().out.splitlines()
    promised = re.findall(r"# (\(.*?\)):", example)
    assert printed[:2] == promised
    one, other = (
        {
            str(file.relative_to(folder)): file.read_bytes()
            for file in folder.rglob("*")
            if file.is_file() and file.name != "zarr.json"
        }
        for folder in (tmp_path / "two_flames.zarr", tmp_path / "again.zarr")
    )
    assert one == other
