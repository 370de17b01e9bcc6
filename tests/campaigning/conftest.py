"""Options of the campaign, its home, and its report."""

import random
from collections import Counter
from pathlib import Path

import pytest

from campaigning.home import Home
from lf_flame._common import provenance
from lf_flame._common.atomic_files import write_text


def pytest_addoption(parser):
    parser.addoption("--quick", action="store_true", help="a case of each kind and command alone")
    parser.addoption("--seed", type=int, default=1, help="seed of the draws")
    parser.addoption("--report", type=Path, help="Markdown file of what is found")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config, items):
    """Of a quick campaign draw a case of each kind and command."""
    # Among all tests, where this folder is only passed by, there are no such options.
    if config.getoption("quick", False):
        groups: dict[tuple, list] = {}
        for item in items:
            key = (item.originalname, item.callspec.params["asked"].command)
            groups.setdefault(key, []).append(item)
        rng = random.Random(config.getoption("seed"))
        items[:] = [rng.choice(group) for group in groups.values()]


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
    for report in found:
        named = dict(report.user_properties)
        counts[named.get("command"), named.get("kind")] += named.get("cases", 1)
    commands, kinds = (list(dict.fromkeys(key[k] for key in counts)) for k in (0, 1))
    made = provenance.environment()
    lines = [
        "# A campaign against the commands\n",
        f"{sum(counts.values())} cases, **{len(wrong)} wrong**. {made['machine']}, revision "
        f"{made['git_revision']}, {made['date']}. Command: `{made['command']}`.\n",
        f"| | {' | '.join(map(str, kinds))} |\n|---|{'---|' * len(kinds)}",
        *(f"| {x} | {' | '.join(str(counts[x, k] or '') for k in kinds)} |" for x in commands),
        *(f"\n- `{r.nodeid}`: {r.longrepr.reprcrash.message[:600]}" for r in wrong),
    ]  # fmt: skip
    write_text(path, "\n".join(lines) + "\n")
