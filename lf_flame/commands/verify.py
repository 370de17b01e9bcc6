"""The command that checks results.

As in `lf_flame.commands.cli`, heavy modules are imported inside the command.
"""

from pathlib import Path

import click
import cloup

from lf_flame.errors import InputError


@cloup.command()
@click.argument("paths", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path))
def verify(paths: tuple[Path, ...]) -> None:
    """Check that results are still what was written, by their hashes.

    PATHS are data sets, run folders, exported networks (.keras), folders of pictures that refocus,
    simulate or predict filled, or folders that hold any of these.

    \b
      lf-flame verify data/quick/flames.zarr
      lf-flame verify data runs results
    """  # noqa: D301 - click reads the backspace
    from lf_flame.commands import verification

    damaged = 0
    for path in paths:
        for finding in verification.verify(path):
            damaged += not finding.sound
            click.echo(
                f"{'whole  ' if finding.sound else 'DAMAGED'} {finding.path}: {finding.text}"
            )
    if damaged:
        raise InputError(f"{damaged} of the results {'is' if damaged == 1 else 'are'} damaged.")
