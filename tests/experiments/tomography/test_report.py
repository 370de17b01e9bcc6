"""The table of emission by depth, and its command."""

import pandas as pd
from click.testing import CliRunner

from experiments.__main__ import commands
from experiments.tomography.report import EMISSION, body
from experiments.tomography.tasks import Row


def test_a_row_shows_what_was_found_beside_what_is_wanted():
    rows = [
        Row("flames", "1 %", "reconstruct", "worst plane's error", 0.00961, 0.015, 0.734),
        Row("flames", "1 %", "focal stack as emission", "worst plane's error", 1.8, None, 0.04),
    ]
    lines = [line.split("|") for line in body(EMISSION, pd.DataFrame(rows))[-1].splitlines()]
    shown = [[cell.strip() for cell in line[1:-1]] for line in lines if len(line) > 2]
    assert [
        "flames",
        "1 %",
        "reconstruct",
        "worst plane's error",
        "0.0096",
        "0.015",
        "0.73",
    ] in shown
    assert shown[-1][-2:] == ["", "0.04"]


def test_the_command_teaches():
    result = CliRunner().invoke(commands, ["emission", "--help"])
    assert result.exit_code == 0
    assert "refocused images" in result.output
