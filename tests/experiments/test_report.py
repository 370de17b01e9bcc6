"""The report writer: its files and tables, and the committed tables made again from records."""

import importlib
import json
import math
import re
from pathlib import Path

import pandas as pd
import pytest

from experiments.report import markdown, origin, write_report
from lf_flame._common.figures import subplots

REFERENCE = Path(__file__).parents[2] / "experiments" / "results"


def read(name):
    return json.loads((REFERENCE / f"{name}.json").read_text())


def body(module, name):
    return importlib.import_module(f"experiments.{module}").body(read(name))


def compare():
    from experiments.systems.comparison import body

    scores, costs = (
        pd.read_csv(REFERENCE / f"compare/{name}.csv") for name in ("compare", "systems")
    )
    return body(scores, costs, read("compare/compare"))


REMADE = {
    "compare/compare": compare,
    "emission/emission": lambda: body("emission.report", "emission/emission"),
    "effects/effects": lambda: body("effects.effects", "effects/effects"),
    "hard_cases/hard_cases": lambda: body("hard_cases.report", "hard_cases/hard_cases"),
    "slope_maps/slope_maps": lambda: body("slope_maps.measuring", "slope_maps/slope_maps"),
}
"""Committed reports whose tables follow from their records, with what makes them."""

NUMBER = re.compile(r"(?:(?<![\w.])[-+])?\d+(?:\.\d+)?(?:e[-+]\d+)?|\binf\b")


def numbers(text):
    """Numbers of each line of the tables of a text, in their order."""
    rows = [NUMBER.findall(line) for line in text.splitlines() if line.startswith("|")]
    return [[float(x) for x in row] for row in rows if row]


@pytest.mark.parametrize("name", REMADE)
def test_committed_tables_follow_from_their_records(name):
    remade = numbers("\n".join(REMADE[name]()))
    committed = numbers((REFERENCE / f"{name}.md").read_text())
    assert len(remade) == len(committed) > 0
    for row in remade:
        # A CSV table has fewer digits than the numbers that a text was written from.
        assert any(line == pytest.approx(row, rel=2e-3) for line in committed), row


def test_a_table_is_written_as_its_columns_say():
    rows = [{"a": "x", "b": 0.125, "c": None, "d": math.inf}, {"a": "y", "b": 2, "c": 3.0, "d": 1}]
    columns = {
        "b": ("number", ".2f"),
        "a": ("word", ""),
        "c": ("number", "g"),
        "d": ("number", lambda x: "exact" if math.isinf(x) else f"{x:g}"),
    }
    lines = markdown(rows, columns, missing="none").splitlines()
    assert lines[1:] == [
        "|---------:|:-------|---------:|---------:|",
        "|     0.12 | x      |     none |    exact |",
        "|     2.00 | y      |        3 |        1 |",
    ]
    assert [cell.strip() for cell in lines[0].split("|")[1:-1]] == [
        "number", "word", "number", "number",
    ]  # fmt: skip
    assert markdown(pd.DataFrame({"z": [1.5]})).splitlines()[-1] == "| 1.5 |"


def test_a_report_is_its_text_tables_pictures_and_a_record_that_json_can_hold(tmp_path):
    picture, _ = subplots()
    record = {"rows": [{"psnr_db": math.inf, "ssim": 1.0}], "wall_s": 12.4}
    path = write_report(
        tmp_path / "out", "name", "A title", record, ["Some words.", "| 1 |"],
        tables={"one": pd.DataFrame(record["rows"])}, pictures={"two": picture},
    )  # fmt: skip
    assert {file.name for file in path.parent.iterdir()} == {
        "name.md", "name.json", "one.csv", "two.png",
    }  # fmt: skip
    written = json.loads((tmp_path / "out/name.json").read_text(), parse_constant=pytest.fail)
    assert written["rows"] == [{"psnr_db": None, "ssim": 1.0}]
    assert {"command", "date", "git_revision", "machine", "versions"} < set(written)
    assert path.read_text() == f"# A title\n\n{origin(written)}\n\nSome words.\n\n| 1 |\n"
    assert origin(written).endswith("; 12 s.")
