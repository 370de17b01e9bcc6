"""What the texts promise: examples that run, commands and targets, links and headings."""

import csv
import json
import re
import shutil
from collections import Counter
from pathlib import Path

import click
import pytest
from programs import code_blocks, without_graphs

from lf_flame.commands import cli

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
RESULTS = ROOT / "experiments" / "results"
USER_TEXTS = [README, *sorted((ROOT / "docs").glob("*.md"))]
TEXTS = [
    *USER_TEXTS,
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "experiments").glob("*.md")),
    ROOT / "data_gen" / "README.md",
]
"""Not CHANGELOG.md: it names commands as they were."""


def names(paths):
    return [str(path.relative_to(ROOT)) for path in paths]


def without_code(text):
    """Leave out fenced blocks and code between backticks, which hold no links."""
    return re.sub(
        r"`[^`\n]*`", "", re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    )


def anchors(text):
    """Anchors of the headings of a text, as GitHub makes them."""
    found, seen = set(), Counter()
    for heading in re.findall(r"(?m)^#{1,6} +(.*?) *$", re.sub(r"(?ms)^```.*?^```", "", text)):
        plain = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", heading)
        slug = re.sub(r"[^\w\- ]", "", plain.lower()).replace(" ", "-")
        found.add(f"{slug}-{seen[slug]}" if seen[slug] else slug)
        seen[slug] += 1
    return found


@pytest.mark.slow
def test_python_examples_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # some write files
    examples = [
        (path, example)
        for path in USER_TEXTS
        for example in code_blocks(path.read_text(encoding="utf-8"), "python")
    ]
    assert examples
    for path, example in examples:
        assert "assert " in example, path  # it checks its own result
        with without_graphs():
            exec(compile(example, str(path), "exec"), {})


def test_the_table_of_the_readme_holds_the_committed_numbers():
    with (RESULTS / "paper" / "tables.csv").open(encoding="utf-8") as file:
        record = list(csv.DictReader(file))

    def cells(table, run, seeds, before="", digits=3):
        wanted = (table, run, seeds)
        rows = [row for row in record if (row["table"], row["run"], row["n_seeds"]) == wanted]
        assert len(rows) == 4
        numbers = [(float(row[f"{before}psnr_db"]), float(row[f"{before}ssim"])) for row in rows]
        return " | ".join(f"{psnr:.2f}, {ssim:.{digits}f}" for psnr, ssim in numbers)

    text = README.read_text(encoding="utf-8")
    epochs = json.loads((RESULTS / "paper" / "table1.json").read_text(encoding="utf-8"))["epochs"]
    four = "ResNet-50 (ImageNet), first four stages"
    linear = "linear: ridge from the picture, no network"  # in the record
    for row in (
        f"| Table I (shapes), printed | {cells('table1', 'paper', '1', 'paper_', 2)} |",
        f"| {four}, {epochs:,} of 5,000 epochs | {cells('table1', 'paper', '1')} |",
        f"| linear: ridge from the network's input | {cells('table1', linear, '0', digits=4)} |",
        f"| Table II (flames), printed | {cells('table2', 'paper', '3', 'paper_', 2)} |",
        f"| {four}, 1,000 epochs, three seeds | {cells('table2', 'paper', '3')} |",
        f"| linear: ridge from the network's input | {cells('table2', linear, '0', digits=4)} |",
    ):
        assert row in text, row


@pytest.mark.parametrize("path", TEXTS, ids=names(TEXTS))
def test_links_lead_to_files_and_headings(path):
    text = path.read_text(encoding="utf-8")
    for link in re.findall(r"\]\(([^)\s]+)\)", without_code(text)):
        if re.match(r"[a-z]+:", link):
            continue
        target, _, anchor = link.partition("#")
        file = (path.parent / target).resolve() if target else path
        assert file.is_relative_to(ROOT), link
        assert file.exists(), link
        if anchor:
            assert anchor in anchors(file.read_text(encoding="utf-8")), link


def check_commands(group, program, text):
    """Check the commands and options that a text names of a program."""
    text = re.sub(r" \\\n +", " ", text)  # lines that go on
    for name, behind in re.findall(rf"{program} ([a-z][a-z-]*)\b([^`#\n]*)", text):
        command = group.commands.get(name)
        assert command is not None, name
        assert not command.hidden, f"{name} is not what it is called any more"
        known = {one for param in command.params for one in (*param.opts, *param.secondary_opts)}
        for option in re.findall(r" (--[a-z][a-z-]*)", behind):
            assert option in known, f"{name} {option}"


@pytest.mark.parametrize("path", TEXTS, ids=names(TEXTS))
def test_commands_of_the_program_exist(path):
    assert isinstance(cli.commands, click.Group)
    check_commands(cli.commands, "(?:lf-flame|-m lf_flame)", path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("path", TEXTS, ids=names(TEXTS))
def test_commands_of_the_experiments_exist(path):
    program = pytest.importorskip("experiments.__main__")
    check_commands(program.commands, "-m experiments", path.read_text(encoding="utf-8"))


def test_tables_are_made_in_a_fresh_clone(asked, tmp_path):
    """Results that came with the clone do not stand for runs that are not there."""
    shutil.copytree(RESULTS / "paper", tmp_path / "experiments" / "results" / "paper")
    for table in ("table1.csv", "table2.csv"):
        (tmp_path / "experiments" / "results" / "paper" / table).touch()
    steps = asked("tables")
    for step in ("dataset", "train", "evaluate"):
        for kind in ("shapes", "flames"):
            assert re.search(rf"(lf-flame|-m experiments) {step} \S*{kind}", steps), (step, kind)
    assert "--out experiments/" not in steps  # what came with the clone stays as it is
