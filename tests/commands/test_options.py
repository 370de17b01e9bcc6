"""Paths and names are looked at before a command begins."""

import click
import pytest
from click.testing import CliRunner

from lf_flame.commands.options import FILE, FOLDER, PATH, PlainName


@click.command()
@click.option("--name", type=PlainName(), default="a")
@click.option("--out", type=FOLDER)
@click.option("--file", type=FILE)
@click.option("--path", type=PATH)
def command(**options):
    click.echo({k: v for k, v in options.items() if v is not None})


@pytest.mark.parametrize("name", ["", "../x", "a/b", "/x", ".", "..", " ", "...", "a/"])
def test_a_name_leads_nowhere_else(name):
    result = CliRunner().invoke(command, ["--name", name])
    assert result.exit_code == 2
    assert f"{name!r} is no plain name of a file" in result.output


@pytest.mark.parametrize("name", ["figure7", "a.b", "ä 1", ".hidden"])
def test_plain_names_are_taken(name):
    assert f"'name': '{name}'" in CliRunner().invoke(command, ["--name", name]).output


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
