"""Paths and names are looked at before a command begins."""

import importlib
import sys
import time
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from lf_flame._common import progress
from lf_flame.commands.cli import commands
from lf_flame.commands.options import FILE, FOLDER, PATH, Program, result_name
from lf_flame.commands.reading_options import Reading


@click.command()
@click.option("--out", type=FOLDER)
@click.option("--file", type=FILE)
@click.option("--path", type=PATH)
def command(**options):
    click.echo({k: v for k, v in options.items() if v is not None})


@pytest.mark.parametrize("option", ["--out", "--file", "--path"])
def test_a_link_to_itself_is_refused(option, tmp_path):
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "a").mkdir()
    for name in ("loop", "loop/x", "n" * 300):
        result = CliRunner().invoke(command, [option, str(tmp_path / name)])
        assert result.exit_code == 2
        assert "cannot be used" in result.output
    (tmp_path / "link").symlink_to(tmp_path / "a")
    assert CliRunner().invoke(command, ["--out", str(tmp_path / "link")]).exit_code == 0
    assert CliRunner().invoke(command, ["--out", str(tmp_path / "new")]).exit_code == 0


def test_a_relative_path_that_is_missing_is_named_with_its_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, end in (("a.toml", f" in the folder {tmp_path}."), (str(tmp_path / "a"), ".")):
        result = CliRunner().invoke(command, ["--file", name])
        assert result.exit_code == 2
        assert f"File {name!r} does not exist{end}\n" in result.output
    assert CliRunner().invoke(command, ["--path", "new"]).exit_code == 0


@pytest.mark.parametrize("imports", [True, False])
def test_a_command_that_loads_for_long_says_so(tmp_path, monkeypatch, caplog, imports):
    """Only where it is importing: what works for long has words of its own."""
    (tmp_path / "slow_to_load.py").write_text("import time; time.sleep(0.3)")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "slow_to_load", raising=False)
    monkeypatch.setattr(progress, "PATIENCE", 0.05)

    @click.command()
    def work():
        importlib.import_module("slow_to_load") if imports else time.sleep(0.3)

    progress.show()
    with caplog.at_level("INFO"):
        result = CliRunner().invoke(Program(commands={"work": work}), ["work"])
    progress.show(False)
    assert result.exit_code == 0, result.output
    assert caplog.messages == ["Loading what this command needs ..."] * imports


def test_results_are_named_after_their_source(tmp_path, monkeypatch):
    """A point in a folder's name is no ending, and "." has the current folder's name."""
    (tmp_path / "run1.5" / "a.zarr").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "run1.5")
    names = [result_name(Path(name)) for name in (".", "a.zarr", "raw.1.png")]
    assert names == ["run1.5", "a", "raw.1"]


def test_every_option_says_what_it_is_for():
    for name, each in commands.commands.items():
        for option in each.params:
            hidden = isinstance(option, click.Argument) or option.hidden
            assert hidden or option.help, f"{name} {option.opts[0]}"


def test_that_pictures_are_gamma_coded_is_said_once(tmp_path, capfd):
    for name in ("a.png", "b.png"):
        Image.fromarray(np.arange(64, dtype=np.uint8).reshape(8, 8)).save(tmp_path / name)
    reading = Reading(views=2)
    for name in ("a.png", "b.png"):
        reading.read(tmp_path / name)
    assert capfd.readouterr().err.count("Such files usually contain gamma-coded") == 1
    assert "a.png is a PNG file of 8 bits" in reading.coded[0]
    assert reading == Reading(views=2)
