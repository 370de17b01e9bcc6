"""The program of the experiments: ``python -m experiments COMMAND``, from a checkout."""

import cloup

from experiments.commands import (
    bench,
    costs,
    depth_test,
    effects,
    emission,
    evaluate,
    hard_cases,
    latency,
    slope_maps,
    slopes,
    study,
    tables,
)
from experiments.systems.commands import compare
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
    cloup.Section("What accuracy costs in time", [costs, latency, bench]),
    cloup.Section("Numerically hard cases", [hard_cases]),
    cloup.Section("What networks learn", [study, depth_test]),
    cloup.Section("Systems side by side", [compare]),
    cloup.Section("Emission by depth", [emission]),
]


@cloup.group(
    cls=Program, help=DESCRIPTION, context_settings=HELP, sections=SECTIONS, align_sections=True
)
def commands() -> None:
    """Gather the commands."""


if __name__ == "__main__":
    program.run(commands, "python -m experiments")
