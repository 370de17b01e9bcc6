"""Options of the campaign, its home, and its report."""

import random
from collections import Counter
from pathlib import Path

import pytest

from campaigning.home import Home
from campaigning.table import CALLS
from lf_flame._common import provenance
from lf_flame._common.atomic_files import write_text


def pytest_addoption(parser):
    parser.addoption("--quick", action="store_true", help="a case of each kind and command alone")
    parser.addoption("--seed", type=int, default=1, help="seed of the draws")
    parser.addoption("--report", type=Path, help="Markdown file of what is found")


def pytest_generate_tests(metafunc):
    """Run each trial over the calls that it fits; without slow ones in a quick campaign."""
    if "asked" not in metafunc.fixturenames:
        return
    trial, quick = metafunc.function.__name__, metafunc.config.getoption("quick")
    calls = [x for x in CALLS if not (quick and (x.learns or x.minutes))]
    if trial == "test_malformed":  # the first call of each command
        calls = list({x.command: x for x in reversed(calls)}.values())
    elif trial != "test_places":
        calls = [x for x in calls if not x.minutes]
    if trial == "test_damaged_beginnings":
        calls = [x for x in calls if x.goes_on]
    elif trial not in ("test_malformed", "test_damaged_inputs"):
        calls = [x for x in calls if x.outputs]
    metafunc.parametrize("asked", calls, ids=lambda call: call.line)


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config, items):
    """Draw one case of each kind and command for a quick campaign."""
    # Among all tests, where this folder is only passed by, there are no such options.
    if config.getoption("quick", False):
        rng = random.Random(config.getoption("seed"))
        rng.shuffle(items)
        items[:] = {(x.originalname, _command(x)): x for x in items}.values()


def _command(item) -> str | None:
    asked = item.callspec.params.get("asked")
    return asked and asked.command


@pytest.fixture(scope="session")
def home(tmp_path_factory, pytestconfig):
    """The files that commands read."""
    return Home(tmp_path_factory.mktemp("campaign"), pytestconfig.getoption("quick"))


@pytest.fixture
def rng(request, asked):
    """A generator of a case's own; the case's kind and command go into the report."""
    kind = request.node.originalname.removeprefix("test_").replace("_", " ")
    request.node.user_properties += [("kind", kind), ("command", asked.command)]
    return random.Random(f"{request.config.getoption('seed')}:{request.node.name}")


def pytest_terminal_summary(terminalreporter, config):
    """Write the report: counts by command and kind, and every case that is wrong."""
    path = config.getoption("report", None)
    found = [r for k in ("passed", "failed") for r in terminalreporter.getreports(k)]
    found = [r for r in found if r.when == "call" or r.failed]
    if not path or not found:
        return
    counts, wrong = Counter(), [r for r in found if r.failed]
    for named in (dict(report.user_properties) for report in found):
        counts[named.get("command"), named.get("kind")] += named.get("cases", 1)
    rows = [named["row"] for named in (dict(r.user_properties) for r in found) if "row" in named]
    commands, kinds = (list(dict.fromkeys(key[k] for key in counts)) for k in (0, 1))
    made = provenance.environment()
    lines = [
        "# A campaign against the commands\n",
        f"{sum(counts.values())} cases, **{len(wrong)} wrong**. {made['machine']}, revision "
        f"{made['git_revision']}, {made['date']}. Command: `{made['command']}`.\n",
        f"| | {' | '.join(map(str, kinds))} |\n|---|{'---|' * len(kinds)}",
        *(f"| {x} | {' | '.join(str(counts[x, k] or '') for k in kinds)} |" for x in commands),
        *_table(rows),
        *(f"\n- `{r.nodeid}`: {r.longrepr.reprcrash.message[:600]}" for r in wrong),
    ]
    write_text(path, "\n".join(lines) + "\n")


def _table(rows: list[dict[str, str]]) -> list[str]:
    """Lines of a table of the cases that have a row of their own."""
    if not rows:
        return []
    heads = [f"\n| {' | '.join(rows[0])} |\n|{'---|' * len(rows[0])}"]
    return heads + [f"| {' | '.join(row.values())} |" for row in rows]
