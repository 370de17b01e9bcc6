"""What makes which committed result, and whether its code has changed since.

Every result has a record, a JSON file that names the revision it was made on. It is *old* if what
it measures has changed since; that need not change a number, but nobody has looked.
"""

import json
import shutil
import subprocess
import tomllib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal

from experiments.beside_reference import HEADING
from experiments.paths import EXPERIMENTS, REFERENCE
from lf_flame._common.atomic_files import atomic_write, write_text
from lf_flame._common.config import build
from lf_flame.errors import InputError

ROOT = EXPERIMENTS.parent
STEPS = Path(__file__).parent / "results.toml"
MINE = ROOT / "results"

State = Literal["missing", "old", "current"]


@dataclass(frozen=True)
class Step:
    """One command, and the results that it makes; see ``results.toml``.

    Attributes
    ----------
    makes : list of str
    command : str
    measures : list of str
    minutes : float
    needs : str
    """

    makes: list[str]
    command: str
    measures: list[str]
    minutes: float
    needs: str = ""

    def files(self, folder: Path) -> list[Path]:
        """Those of its results that lie in a folder."""
        return sorted(path for pattern in self.makes for path in folder.glob(pattern))

    def revisions(self, folder: Path) -> list[str]:
        """Revisions that its records there name."""
        records = [path for path in self.files(folder) if path.suffix == ".json"]
        return sorted({_revision(path) for path in records})

    def state(self, folder: Path) -> State:
        """Whether its results are in a folder, and made by the code as it is."""
        revisions = self.revisions(folder)
        if not revisions:
            return "missing"
        return "old" if any(_changed(one, tuple(self.measures)) for one in revisions) else "current"

    def adopt(self, mine: Path = MINE, reference: Path = REFERENCE) -> list[Path]:
        """Copy its results from a user's folder to the committed ones; returns what was copied."""
        for path in self.files(mine):
            target = reference / path.relative_to(mine)
            target.parent.mkdir(parents=True, exist_ok=True)
            if path.suffix == ".md":
                alone = path.read_text(encoding="utf-8").partition(f"\n{HEADING}")[0]
                write_text(target, alone)
                continue
            with atomic_write(target) as aside:
                shutil.copyfile(path, aside)
        return self.files(mine)


def read_steps(path: Path = STEPS) -> list[Step]:
    """Read all steps, in the order in which they are made."""
    content = tomllib.loads(path.read_text(encoding="utf-8"))
    code = content["code"]
    steps = [build(Step, step, path) for step in content["steps"]]
    return [
        Step(
            step.makes, step.command,
            [one for name in step.measures for one in code.get(name, [name])],
            step.minutes, step.needs,
        )
        for step in steps
    ]  # fmt: skip


def _revision(record: Path) -> str:
    revision = json.loads(record.read_text(encoding="utf-8")).get("git_revision")
    if not revision:
        raise InputError(f"{record} does not say on which revision it was made.")
    return revision


@lru_cache
def _changed(revision: str, paths: tuple[str, ...]) -> bool:
    """Whether files differ from what they were; of a revision that git does not know, they do."""
    found = subprocess.run(
        ["git", "diff", "--quiet", revision.removesuffix("+"), "--", *paths],
        cwd=ROOT, capture_output=True, check=False,
    )  # fmt: skip
    return revision.endswith("+") or found.returncode != 0
