"""Each hard case: the package is right, the obvious formula is not, and the report says both."""

import json
import math

import pytest

pytest.importorskip("pyproximal")

from experiments.hard_cases.case import CASES, HardCase, Values, measure
from experiments.hard_cases.report import all_cases, run_hard_cases


def marked(case):
    """A case; slow where kernels have to be compiled, which `tests/stability` tests as well."""
    slow = case.find.__module__.endswith((".light", ".refocusing", ".tomography"))
    return pytest.param(case, id=case.find.__name__, marks=[pytest.mark.slow] * slow)


@pytest.mark.jit
@pytest.mark.parametrize("case", [marked(case) for case in all_cases()])
def test_the_package_is_right_where_the_obvious_formula_is_not(case):
    found = measure(case)
    assert found["our_error"] <= case.allowed
    assert found["obvious_error"] > case.fails_by * case.allowed


@pytest.mark.parametrize(
    ("values", "obvious_error", "our_error"),
    [
        (Values("none", "2.00", "none"), math.inf, 0),
        (Values([0.0, 2.0], [0.5, math.nan], [0.0, 3.0], scale=2.0), math.inf, 0.5),
        (Values(math.inf, 100.0, math.inf), math.inf, 0),
        (Values([1.0, 4.0], [1.5, 5.0], [1.0, 4.0]), 0.5, 0),
    ],
)
def test_errors_are_the_largest_of_all_places(values, obvious_error, our_error):
    found = measure(HardCase("", "", "", 0.0, lambda: values))
    assert (found["obvious_error"], found["our_error"]) == (obvious_error, our_error)


def test_the_report_holds_every_case(tmp_path, monkeypatch):
    monkeypatch.setattr("experiments.hard_cases.report.all_cases", lambda: CASES[:3])
    text = run_hard_cases(tmp_path).read_text()
    record = json.loads((tmp_path / "hard_cases.json").read_text())
    assert [case["case"] for case in record["cases"]] == [case.name for case in CASES[:3]]
    assert all(case.name in text for case in CASES[:3])
    assert " fails |" in text
    assert (tmp_path / "hard_cases.png").stat().st_size > 1000
