"""The program of the experiments: ``python -m experiments COMMAND``, from a checkout."""

import cloup

from experiments import commands as own
from lf_flame.commands import program
from lf_flame.commands.options import HELP, Program

DESCRIPTION = """The paper's tables, and the studies of this project.

Make targets call these commands; `make help` lists them.
"""

SECTIONS = [
    cloup.Section("The paper", [own.slopes, own.evaluate, own.baselines, own.tables]),
    cloup.Section("Simulation", [own.effects, own.hard_cases]),
    cloup.Section("Methods beside rivals", [own.slope_maps, own.emission, own.compare]),
    cloup.Section("What networks learn", [own.study, own.depth_test]),
    cloup.Section("Time, on a machine that does nothing else", [own.costs, own.bench]),
]


@cloup.group(
    cls=Program, help=DESCRIPTION, context_settings=HELP, sections=SECTIONS, align_sections=True
)
def commands() -> None:
    """Gather the commands."""


if __name__ == "__main__":
    program.run(commands, "python -m experiments")
