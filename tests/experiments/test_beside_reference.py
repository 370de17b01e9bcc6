"""A user's report stands above the committed one, which no run of his writes."""

import re
from pathlib import Path

from experiments import beside_reference
from experiments.beside_reference import is_reference, set_beside


def test_the_committed_report_comes_under_the_users(tmp_path, monkeypatch):
    committed = tmp_path / "committed" / "costs"
    committed.mkdir(parents=True)
    (committed / "costs.md").write_text("# Costs\n\n3 ms\n\n![picture](costs.png)\n\n## More\n")
    monkeypatch.setattr(beside_reference, "REFERENCE", tmp_path / "committed")
    mine = tmp_path / "costs.md"
    mine.write_text("# Costs\n\n5 ms\n")
    first = set_beside(mine, "costs/costs.md")
    assert mine.read_text() == first
    assert first.index("5 ms") < first.index("The reference result") < first.index("3 ms")
    assert "picture" not in first  # it lies elsewhere
    assert [line for line in first.splitlines() if line.startswith("#")] == [
        "# Costs", "## The reference result", "### Costs", "#### More",
    ]  # fmt: skip
    assert set_beside(mine, "costs/costs.md") == first  # once, however often it is called
    assert set_beside(committed / "costs.md", "costs/costs.md").count("3 ms") == 1
    before = mine.read_text()
    assert set_beside(mine, "costs/none.md") == before.partition("\n## The reference")[0]


def test_results_are_known_by_where_they_lie(tmp_path):
    assert is_reference(beside_reference.REFERENCE / "closed-form")
    assert not is_reference(tmp_path / "closed-form")


def test_every_report_has_a_committed_one():
    experiments = Path(beside_reference.__file__).parent
    named = set()
    for path in (*experiments.rglob("commands.py"), experiments / "benchmarks" / "report.py"):
        named |= set(re.findall(r' show\(.*, "([^"]+)"\)', path.read_text()))
    assert {"compare", "costs", "depth_test", "benchmarks", "emission"} <= named
    for name in named:
        assert list((beside_reference.REFERENCE / name).glob("*.md")), name
    for path in beside_reference.REFERENCE.rglob("*.md"):
        assert beside_reference.HEADING not in path.read_text(encoding="utf-8"), path
