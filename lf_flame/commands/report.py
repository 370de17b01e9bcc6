"""The command that writes a report of results.

As in `lf_flame.commands.cli`, heavy modules are imported inside the command.
"""

from pathlib import Path

import click
import cloup

from lf_flame._common.printable import printable
from lf_flame.commands.options import PATH, RUN
from lf_flame.errors import InputError

DEFAULT, MARK, HEAD = Path("report.html"), b'content="lf-flame report"', 2000
"""File of a report that is not named, and the text in its first bytes by which it is known."""


@cloup.command()
@click.argument("folder", type=RUN)
@click.option("--out", type=PATH, help="HTML file (default: report.html, if that is a report).")
def report(folder: Path, out: Path | None) -> None:
    """Write a report of a folder of results: one HTML file to read, print or mail.

    FOLDER is what a command has written: a training run, a data set, emission, temperatures,
    flicker, refocused images, or the tables of a reproduction. The report holds a verdict, the
    tables, curves and pictures of the folder, a paragraph for the methods part of a paper, the
    commands to repeat it, and where it comes from; of emission by depth, a simulated light field
    and a reproduction (the first light field of its data set) also the viewer. It has 5 MB at most,
    needs no network, and no JavaScript but for the viewer, and is the same for the same files.

    \b
      lf-flame report reconstructed/flame
      lf-flame report results/paper --out paper.html
    """  # noqa: D301 - click reads the backspace
    from lf_flame._common.atomic_files import write_text
    from lf_flame._common.locks import exclusive
    from lf_flame.commands import verification
    from lf_flame.commands.report_page import report_page

    if out is None:
        out = DEFAULT
        if out.exists() and MARK not in out.read_bytes()[:HEAD]:
            raise InputError(f"{out} is there and is no report: name another file by --out.")
    if out.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"--out must end in .html, got {printable(out)}.")
    page = report_page(folder, verification.verify_here(folder))
    with exclusive(out):
        write_text(out, page)
    click.echo(f"{printable(out)} is written")
