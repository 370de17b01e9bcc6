"""The program of the experiments: ``python -m experiments COMMAND``, from a checkout."""

import cloup

from experiments.commands import (
    bounds,
    costs,
    dataset_making,
    depth_test,
    effects,
    emission,
    hard_cases,
    latency,
    screenshots,
    slope_maps,
    study,
)
from experiments.old_results import results
from experiments.paper.commands import evaluate, slopes, tables
from experiments.systems.commands import compare, system_scenes
from lf_flame.commands import program
from lf_flame.commands.options import HELP, Program

DESCRIPTION = """The paper's tables, and the studies of this project.

\b
The Make targets call these commands; `make help` lists them:
  make tables        both tables of the paper, from nothing
  make costs         what accuracy costs in time
  make compare       refocusing systems side by side
"""

SECTIONS = [
    cloup.Section("The paper", [slopes, evaluate, tables]),
    cloup.Section("What the simulator is worth", [effects]),
    cloup.Section("What slope maps are worth", [slope_maps]),
    cloup.Section("What accuracy costs in time", [costs, latency, dataset_making]),
    cloup.Section("What bounds hold, and hard cases", [bounds, hard_cases]),
    cloup.Section("What networks learn", [study, depth_test]),
    cloup.Section("Systems side by side", [compare, system_scenes]),
    cloup.Section("Emission by depth", [emission]),
    cloup.Section("What the documents say", [results, screenshots]),
]


@cloup.group(
    cls=Program, help=DESCRIPTION, context_settings=HELP, sections=SECTIONS, align_sections=True
)
def commands() -> None:
    """Gather the commands."""


if __name__ == "__main__":
    program.run(commands, "python -m experiments")
