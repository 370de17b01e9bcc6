"""A user's report stands above the committed one, which no run of his writes."""

from experiments import reference
from experiments.reference import is_reference, set_beside


def test_the_committed_report_comes_under_the_users(tmp_path, monkeypatch):
    committed = tmp_path / "committed" / "costs"
    committed.mkdir(parents=True)
    (committed / "costs.md").write_text("# Costs\n\n3 ms\n\n![picture](costs.png)\n\n## More\n")
    monkeypatch.setattr(reference, "REFERENCE", tmp_path / "committed")
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
    assert is_reference(reference.REFERENCE / "quick")
    assert not is_reference(tmp_path / "quick")
