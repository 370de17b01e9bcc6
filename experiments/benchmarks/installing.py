"""Install the package in new environments: seconds, megabytes, and whether the tests pass there.

The light and the learning installation with this Python; all extras in the oldest versions that
``setup.cfg`` allows, and on other Pythons. Each has an environment of its own, removed afterwards;
where all extras are, the quick tests run.
"""

import os
import re
import subprocess
import sys
import tempfile
import time
from configparser import ConfigParser
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from experiments.benchmarks.report import command_line, finish
from lf_flame._common import provenance
from lf_flame._common.config import load_record
from lf_flame.errors import InputError

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Environment:
    """An environment to make.

    With extras of the package, in brackets, in the oldest versions that it allows or the newest; in
    some the quick tests run.
    """

    name: str
    python: str = sys.executable
    extras: str = ""
    oldest: bool = False
    tested: bool = True


def oldest_versions(setup: Path) -> list[str]:
    """Read the lower bounds of all dependencies, as constraints for pip."""
    config = ConfigParser()
    config.read(setup, encoding="utf-8")
    lines = [config["options"]["install_requires"], *config["options.extras_require"].values()]
    bounds = re.findall(r"^([\w.-]+)>=([\w.]+)", "\n".join(lines), re.MULTILINE)
    return [f"{name}=={version}.*" for name, version in bounds]


def measure(environment: Environment) -> dict:
    """Make an environment, install into it, and run the quick tests there."""
    with tempfile.TemporaryDirectory() as folder:
        python = Path(folder) / "venv" / "bin" / "python"
        _run(environment.python, "-m", "venv", python.parents[1])
        pip = [python, "-m", "pip", "--disable-pip-version-check"]
        install = [*pip, "install", "--quiet"]
        if environment.oldest:
            constraints = Path(folder) / "oldest.txt"
            constraints.write_text("\n".join(oldest_versions(ROOT / "setup.cfg")))
            install += ["--constraint", constraints]
        started = time.perf_counter()
        _run(*install, f"{ROOT}{environment.extras}")
        row = {
            "environment": environment.name,
            "seconds": time.perf_counter() - started,
            "megabytes": _size(python.parents[1]) / 1e6,
            "passed": None,
            "failed": None,
        }
        if environment.tested:
            row |= _test(python)
        listed = _run(*pip, "list", "--format", "freeze").split()
        return row | {
            "python": _python(python),
            "git_revision": provenance.environment()["git_revision"],
            "versions": " ".join(line for line in listed if not line.startswith("lf_flame")),
        }


def _test(python: Path) -> dict:
    command = [python, "-m", "pytest", "-q", "-m", "not slow", "-n", "2", "--dist", "loadfile",
               "-p", "no:cacheprovider"]  # fmt: skip
    found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    lines = found.stdout.strip().splitlines() or ["nothing was said"]
    numbers = {word: int(n) for n, word in re.findall(r"(\d+) (passed|failed|error)", lines[-1])}
    failed = [line for line in lines if line.startswith(("FAILED", "ERROR"))]
    return {
        "passed": numbers.get("passed", 0),
        "failed": numbers.get("failed", 0) + numbers.get("error", 0),
        "what_failed": "; ".join(failed),
    }


def _run(*command) -> str:
    """Run a command, and give what it prints; the program ends where it fails."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))} failed:\n{done.stderr}")
    return done.stdout


def _size(folder: Path) -> int:
    """Bytes on disk of all files in a folder."""
    return sum(
        512 * os.lstat(Path(top) / name).st_blocks
        for top, _, names in os.walk(folder)
        for name in names
    )


def _python(python: Path | str) -> str:
    return _run(python, "-c", "import platform; print(platform.python_version())").strip()


@dataclass(frozen=True)
class EarlierRecord:
    """What an earlier record must say."""

    rows: list[dict[str, Any]]


def _read_rows(path: Path) -> list[dict]:
    rows = load_record(EarlierRecord, path).rows if path.exists() else []
    if not all(isinstance(row.get("environment"), str) for row in rows):
        raise InputError(f"{path} is damaged: a row in it names no environment.")
    return rows


COLUMNS = {
    "environment": ("environment", ""),
    "seconds": ("seconds", ".0f"),
    "megabytes": ("megabytes", ".0f"),
    "passed": ("passed", ".0f"),
    "failed": ("failed", ".0f"),
    "python": ("python", ""),
    "git_revision": ("git_revision", ""),
}

NOTES = [
    "Seconds depend on the network and on what pip has in its cache; megabytes on disk. Each row "
    "has its own revision. Versions, and what failed, are in the record, installing.json."
]


def main() -> None:
    """Measure all environments, and write the report after each."""
    parser = command_line(__doc__, small=False)
    parser.add_argument("--python", action="append", default=[], help="another interpreter")
    parser.add_argument("--only", default="", help="environments whose name holds this")
    asked = parser.parse_args()
    test = "[test]"
    environments = [
        Environment("light: pip install .", tested=False),
        Environment("learning: pip install '.[learn]'", extras="[learn]", tested=False),
        Environment("oldest versions allowed", extras=test, oldest=True),
        *(Environment(f"Python {_python(x)}", x, test) for x in asked.python),
    ]
    rows = {row["environment"]: row for row in _read_rows(asked.out / "installing.json")}
    for environment in environments:
        if asked.only in environment.name:
            sys.stderr.write(f"{environment.name} ...\n")
            rows[environment.name] = measure(environment)
            record, title = {"rows": list(rows.values())}, "Installing, and the quick tests there"
            finish(asked.out, "installing", title, record, COLUMNS, NOTES)


if __name__ == "__main__":
    main()
