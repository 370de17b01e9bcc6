"""The command that checks results.

As in `lf_flame.commands.cli`, heavy modules are imported inside the command.
"""

from collections import Counter
from pathlib import Path

import click
import cloup

from lf_flame.commands.options import PATH
from lf_flame.errors import InputError

LONGEST = 500
"""Largest number of characters printed of what is wrong with a result."""


@cloup.command()
@click.argument("paths", nargs=-1, required=True, type=PATH)
def verify(paths: tuple[Path, ...]) -> None:
    """Check by their hashes that results are still as they were written.

    PATHS are data sets, run folders, exported networks (.keras), folders of pictures by refocus,
    simulate or predict, or folders that hold any of these. Each result is whole, DAMAGED, or
    UNCHECKED (it cannot be read here and now: no permission, no memory, nothing there).

    \b
      lf-flame verify data/closed-form/flames.zarr
      lf-flame verify data runs results
    """  # noqa: D301 - click reads the backspace
    from lf_flame._common.printable import printable
    from lf_flame.commands import verification

    verdicts = Counter[str]()
    for path in paths:
        for finding in verification.verify(path):
            verdicts[finding.verdict] += 1
            where, text = printable(finding.path), printable(finding.text, LONGEST)
            click.echo(f"{finding.verdict:<9} {where}: {text}")
    bad = [
        f"{count} {'is' if count == 1 else 'are'} {said}"
        for verdict, said in (("DAMAGED", "damaged"), ("UNCHECKED", "unchecked"))
        if (count := verdicts[verdict])
    ]
    if bad:
        raise InputError(f"Of {verdicts.total()} results, {' and '.join(bad)}.")
