"""The command that makes the committed results again: results."""

import shlex
import subprocess
import sys
from fnmatch import fnmatch

import click
import cloup

from lf_flame.errors import InputError


@cloup.command()
@click.argument("patterns", nargs=-1)
@click.option("--make", "making", is_flag=True, help="Make what is old or missing in results/.")
@click.option(
    "--adopt", is_flag=True, help="Copy what is current in results/ to the committed ones."
)
def results(patterns: tuple[str, ...], making: bool, adopt: bool) -> None:
    """List how each committed result is made, and whether its code has changed since.

    PATTERNS choose results, as "benchmarks/*"; without any, all are meant. With --make, what is not
    yet in results/, or was made by other code, is made there. That may be stopped with Ctrl-C, and
    goes on with the result that it was at. Do nothing else on the machine meanwhile: most of them
    measure time. `make results` calls this.

    \b
      python -m experiments results
      python -m experiments results "benchmarks/*" --make
      python -m experiments results "benchmarks/*" --adopt
    """  # noqa: D301 - click reads the backspace
    from experiments.paths import REFERENCE
    from experiments.remaking.steps import MINE, ROOT, read_steps

    steps = [
        step
        for step in read_steps()
        if not patterns
        or any(fnmatch(made, one) or made == one for made in step.makes for one in patterns)
    ]
    if not steps:
        raise InputError(f"No result matches {' '.join(patterns)}; call it without a pattern.")
    for step in steps:
        states = f"committed: {step.state(REFERENCE)}, in results/: {step.state(MINE)}"
        click.echo(f"{', '.join(step.makes)}: {states}; {step.minutes:g} min by {step.command}")
    if making:
        _make([step for step in steps if step.state(MINE) != "current"])
    for step in steps if adopt else []:
        if step.state(MINE) == "current":
            click.echo("\n".join(str(path.relative_to(ROOT)) for path in step.adopt()))


def _make(steps: list) -> None:
    from experiments.remaking.steps import MINE, ROOT

    click.echo(f"{len(steps)} to make, {sum(step.minutes for step in steps):g} min about")
    for step in steps:
        click.echo(step.command + (f" (needs {step.needs})" if step.needs else ""))
        words = [sys.executable if x == "python" else x for x in shlex.split(step.command)]
        ended = subprocess.run(words, cwd=ROOT, check=False).returncode
        if ended:
            raise InputError(f"`{step.command}` ended with {ended}; nothing was made after it.")
        if step.state(MINE) != "current":
            made = ", ".join(f"results/{one}" for one in step.makes)
            raise InputError(
                f"`{step.command}` left {made} as it was, {step.state(MINE)}: remove it, "
                f"and the runs that it rests on, if it is to be made by the code as it is."
            )
