"""One writer of a results folder at a time, and the others wait."""

import threading

import pytest

from experiments.paper import result_files
from experiments.paper.result_files import results_aside
from lf_flame.errors import InputError


def test_a_second_writer_waits_for_the_first(tmp_path):
    inside, may_end, seen = threading.Event(), threading.Event(), []

    def first():
        with results_aside(tmp_path, last="table1.csv") as aside:
            inside.set()
            may_end.wait(60)
            (aside / "table1.csv").write_text("1")

    def second():
        with results_aside(tmp_path, last="table2.csv") as aside:
            seen.extend(path.name for path in tmp_path.glob("*.csv"))
            (aside / "table2.csv").write_text("2")

    one = threading.Thread(target=first)
    one.start()
    assert inside.wait(60)
    two = threading.Thread(target=second)
    two.start()
    two.join(0.3)
    assert two.is_alive()
    may_end.set()
    one.join(60)
    two.join(60)
    assert seen == ["table1.csv"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["table1.csv", "table2.csv"]


def test_who_waits_too_long_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(result_files, "WRITING_S", 0.1)
    with (
        results_aside(tmp_path, last="table1.csv"),
        pytest.raises(InputError, match="is being written by another process"),
        results_aside(tmp_path, last="table2.csv"),
    ):
        pass
