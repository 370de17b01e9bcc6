"""Systems that stop at different times are compared where all of them still learn."""

import pytest

from experiments.systems.learning import learning_figure, learning_table, learning_text

ABOUT = {
    "quick": {"curve": {"steps": [0, 100, 200, 300], "seconds": [0, 1, 2, 3],
                        "psnr_db": [5.0, 30.0, 29.0, 33.0]}},
    "slow": {"curve": {"steps": [0, 100, 200], "seconds": [0, 2, 4], "psnr_db": [4.0, 20.0, 35.0]}},
    "a formula": {},
}  # fmt: skip


def test_all_have_had_as_many_seconds_and_as_many_steps():
    table = learning_table(ABOUT).set_index("system")
    assert list(table.index) == ["quick", "slow"]
    assert set(table.at_seconds) == {3}
    assert set(table.at_steps) == {200}
    # The best weights are kept, so a later, worse epoch does not count.
    assert list(table.after_steps_db) == [30, 35]
    assert list(table.after_seconds_db) == [33, 20]
    assert list(table.end_db) == [33, 35]
    assert list(table.steps) == [300, 200]


def test_table_and_picture_say_what_they_compare():
    text = learning_text(ABOUT)
    assert "after 3 s" in text
    assert "after 200 steps" in text
    assert learning_text({"a formula": {}}) == ""
    seconds, steps = learning_figure(ABOUT).axes
    assert [line.get_label() for line in steps.lines] == ["quick", "slow"]
    assert seconds.lines[1].get_xdata() == pytest.approx([2, 4])
