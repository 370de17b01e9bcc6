"""Each hard case: the package is right, the obvious formula is not, and the report says both."""

import math

import pytest

from experiments.hard_cases import report
from experiments.hard_cases.report import CASES, Values, all_cases, hard_case, measure


@pytest.mark.jit
@pytest.mark.slow
@pytest.mark.parametrize("case", all_cases(), ids=lambda case: case.find.__name__)
def test_the_package_is_right_where_the_obvious_formula_is_not(case):
    found = measure(case)
    assert found["our_error"] <= case.allowed
    assert found["obvious_error"] > case.fails_by * case.allowed


def test_errors_are_the_largest_of_all_places_and_reported(tmp_path, monkeypatch):
    for values, errors in (
        (Values([0.0, 2.0], [0.5, math.nan], [0.0, 3.0], scale=2.0), (math.inf, 0.5)),
        (Values(math.inf, 100.0, math.inf), (math.inf, 0)),
    ):
        case = hard_case("", "", "", 0.0)
        case.find = lambda values=values: values
        found = measure(case)
        assert (found["obvious_error"], found["our_error"]) == errors
    monkeypatch.setattr(report, "all_cases", lambda: CASES[:3])
    text = report.run_hard_cases(tmp_path).read_text()
    assert all(case.name in text for case in CASES[:3])
    assert " fails |" in text
    assert (tmp_path / "hard_cases.csv").read_text().count("\n") == 4
