"""The page on data sets, done as it says, in an empty folder."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from programs import run_here

PAGE = (Path(__file__).parents[2] / "docs" / "data_sets.md").read_text(encoding="utf-8")


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)


@pytest.mark.slow
def test_the_page_does_what_it_says(tmp_path):
    pytest.importorskip("distributed")

    def run(*arguments):
        command = [sys.executable, *arguments]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout

    (settings,) = blocks("toml")
    (tmp_path / "two_flames.toml").write_text(settings)
    commands = [line.split() for block in blocks("sh") for line in block.splitlines()]
    assert len(commands) == 3
    for program, *arguments in commands:
        assert program == "lf-flame"
        done = run_here(*arguments, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    example, fresh = blocks("py")
    run("-c", fresh + "assert inputs.shape == (16, 30, 60, 1) and targets.shape == (16, 2, 30, 60)")
    printed = run("-c", example).splitlines()
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
