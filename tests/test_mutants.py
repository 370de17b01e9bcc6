"""The planter of errors, on programs of a few lines."""

import shutil
import subprocess
import tomllib

import mutants
import pytest
from mutator import draw_mutants, find_mutants

PROGRAM = '''"""A program with 1 + 1 in its docstring."""

from math import floor

LIMIT: "at most 3" = 2.5


def area(width: float, height: float = 3) -> "1 + 2":
    """Not 4 * 5."""
    if width < 0 or not height:
        raise ValueError(f"{width + 1} is too small: {1 - 2}")
    sides = [width, -height]
    return sides[0] * floor(sides[1])  # a * b
'''

EXPECTED = {
    ('LIMIT: "at most 3" = 2.5', 'LIMIT: "at most 3" = 2.525'),
    ('LIMIT: "at most 3" = 2.5', 'LIMIT: "at most 3" = 5.0'),
    ("height: float = 3)", "height: float = 4)"),
    ("if width < 0 or not height:", "if width <= 0 or not height:"),
    ("if width < 0 or not height:", "if width < 1 or not height:"),
    ("if width < 0 or not height:", "if width < 0 and not height:"),
    ("if width < 0 or not height:", "if width < 0 or height:"),
    ("sides = [width, -height]", "sides = [width, height]"),
    ("sides[0] * floor", "sides[1] * floor"),
    ("sides[0] * floor", "sides[0] / floor"),
    ("return sides[0] * floor(sides[1])", "return sides[0]"),
    ("return sides[0] * floor(sides[1])", "return floor(sides[1])"),
    ("floor(sides[1])  #", "ceil(sides[1])  #"),
    ("floor(sides[1])  #", "floor(sides[0])  #"),
}


def test_errors_are_planted_in_numbers_and_operators_and_nowhere_else():
    found = find_mutants(PROGRAM, "area.py")
    assert {m.apply(PROGRAM) for m in found} == {PROGRAM.replace(*pair, 1) for pair in EXPECTED}
    assert len(found) == len(EXPECTED)
    for mutant in found:
        compile(mutant.apply(PROGRAM), "area.py", "exec")
        before, after = mutant.lines(PROGRAM)
        assert before != after
        assert PROGRAM.splitlines()[mutant.line - 1].strip() == before
    kinds = {m.lines(PROGRAM)[1]: m.kind for m in found}
    assert kinds["return sides[0]  # a * b"] == "factor"
    assert kinds['LIMIT: "at most 3" = 5.0'] == "module constant"


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("a = (b  # + c\n     + c)", "a = (b  # + c\n     - c)"),
        ("a = (b + c) / (d)", "a = (b + c) * (d)"),
        ("a = (b - c) * d", "a = (b - c)"),
        ("a += é * b", "a -= é * b"),
        ("a = b <= c < d", "a = b <= c <= d"),
        ("a = x[1:]", "a = x[0:]"),
        ("a = x[-2]", "a = x[2]"),
        ("a = np.minimum(b, c)", "a = np.maximum(b, c)"),
        ("a = 0.0", "a = 1.0"),
        ("a = b and c and d", "a = b and c or d"),
    ],
)
def test_an_error_is_planted_in_its_place(before, after):
    assert after in [m.apply(before) for m in find_mutants(before, "a.py")]


def test_sabotage_raises_where_the_expression_is_worked_out():
    for mutant in find_mutants("a = 2 * 3\n", "a.py"):
        with pytest.raises(ZeroDivisionError):
            exec(mutant.sabotage("a = 2 * 3\n"))


def test_the_same_seed_draws_the_same_and_all_kinds_in_turn():
    found = find_mutants(PROGRAM, "area.py")
    kinds = {m.kind for m in found}
    drawn = draw_mutants(found, len(kinds), seed=3)
    assert {m.kind for m in drawn} == kinds
    assert draw_mutants(found, len(kinds), seed=3) == drawn
    assert draw_mutants(found, len(kinds), seed=4) != drawn
    assert draw_mutants(found, 100, seed=3) == found
    assert draw_mutants([], 5, seed=3) == []


@pytest.mark.parametrize(
    ("status", "output", "outcome"),
    [
        (0, "3 passed", ("survived", None)),
        (None, "", ("timed out", None)),
        (1, "F\nFAILED tests/a.py::test_b[1 - 2] - x", ("killed", "tests/a.py::test_b[1")),
        (1, "ERROR tests/a.py::test_b - fixture", ("killed", "tests/a.py::test_b")),
        (1, "ERROR tests/a.py - ImportError: a::b", ("not started", None)),
        (4, "ImportError while loading conftest", ("not started", None)),
        (-11, "Fatal Python error: Segmentation fault", ("killed", "a crash by signal 11")),
    ],
)
def test_pytest_tells_what_became_of_a_mutant(status, output, outcome):
    assert mutants.judge(status, output) == outcome


def test_every_file_of_the_core_has_tests():
    for file in mutants.CORE:
        assert (mutants.ROOT / "lf_flame" / file).is_file(), file
        assert mutants.tests_of(file), file
        for test in mutants.tests_of(file):
            assert (mutants.ROOT / test).exists(), test


@pytest.mark.slow
def test_what_is_explained_can_still_be_planted():
    entries = tomllib.loads(mutants.EXPLAINED.read_text(encoding="utf-8"))["explained"]
    for entry in entries:
        source = (mutants.ROOT / entry["file"]).read_text(encoding="utf-8")
        found = find_mutants(source, entry["file"], entry["line"])
        lines = [mutant.lines(source) for mutant in found]
        assert (entry["line"], entry["mutant"]) in lines, entry
        assert entry["why"].endswith("."), entry


COUNTDOWN = """def count_down(n):
    while n > 3:
        n -= 1
    return n


def never_called(n):
    return n + 1
"""

TESTS = """from lf_flame.countdown import count_down


def test_it_stops():
    assert [count_down(5), count_down(3)] == [3, 3]
"""


@pytest.fixture
def small_project(tmp_path, monkeypatch):
    """A checkout with one file, whose tests do not notice everything."""
    if shutil.which("git") is None:
        pytest.skip("needs git")
    root = tmp_path / "checkout"
    for name, text in {
        "lf_flame/__init__.py": "",
        "lf_flame/countdown.py": COUNTDOWN,
        "tests/test_countdown.py": TESTS,
        "tests/conftest.py": (
            "from hypothesis import settings\nsettings.register_profile('first_failure')\n"
        ),
        "tests/reference.py": "",
        "setup.cfg": "[tool:pytest]\nmarkers = slow\n",
    }.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    subprocess.run(["git", "init", "--quiet", root], check=True)
    monkeypatch.setattr(mutants, "ROOT", root)
    monkeypatch.setattr(mutants, "CORE", {"countdown.py": ()})
    monkeypatch.setattr(mutants, "LEAST_LIMIT_S", 20.0)
    monkeypatch.setattr(mutants, "PATIENCE", 0.0)
    monkeypatch.setattr(mutants, "read_explanations", lambda: {})
    return root


@pytest.mark.slow
def test_mutants_are_killed_survive_or_are_never_reached(small_project, tmp_path, monkeypatch):
    arguments = ["--per-file", "20", "--jobs", "2", "--out", str(tmp_path / "out")]
    mutants.main(arguments)
    found = {row["after"]: row for row in mutants.known(tmp_path / "out/mutants.jsonl").values()}
    assert {after: row["outcome"] for after, row in found.items()} == {
        "while n >= 3:": "killed",
        "while n > 4:": "killed",
        "n += 1": "timed out",
        "n -= 2": "survived",
        "return n - 1": "not reached",
        "return n + 2": "not reached",
        "return n": "not reached",
        "return 1": "not reached",
    }
    assert found["while n > 4:"]["by"] == "tests/test_countdown.py::test_it_stops"
    text = (tmp_path / "out/mutants.md").read_text()
    assert "4 are decided; of these the tests notice **75.0%**" in text
    assert "- lf_flame/countdown.py:3 (constant): `n -= 1` -> `n -= 2`" in text
    assert (small_project / "lf_flame/countdown.py").read_text() == COUNTDOWN

    tried = []
    monkeypatch.setattr(mutants, "run", lambda trials, *_: tried.extend(trials))
    mutants.main(arguments)
    assert tried == []  # all is known
    path = small_project / "tests/test_countdown.py"
    path.write_text(TESTS.replace("count_down(5)", "count_down(4)"))
    mutants.main(arguments)  # a changed test may notice more
    assert {trial.after for trial in tried} == {
        after for after, row in found.items() if row["outcome"] in ("survived", "not reached")
    }


@pytest.mark.slow
def test_tests_that_fail_as_they_are_are_refused(small_project, tmp_path):
    path = small_project / "tests/test_countdown.py"
    path.write_text(TESTS.replace("[3, 3]", "[3, 4]"))
    with pytest.raises(SystemExit, match="fail without a mutant: tests/test_countdown.py"):
        mutants.main(["--out", str(tmp_path / "out")])


def test_a_file_outside_the_core_is_refused(capsys, tmp_path):
    with pytest.raises(SystemExit):
        mutants.main(["commands/cli.py", "--out", str(tmp_path)])
    assert "commands/cli.py is not a file of the core" in capsys.readouterr().err
