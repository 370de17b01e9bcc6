"""The command that fills in the documentation's numbers: texts."""

import difflib

import click
import cloup

from experiments.paths import EXPERIMENTS
from lf_flame.errors import InputError


@cloup.command()
@click.argument("documents", nargs=-1)
@click.option(
    "--check", is_flag=True, help="Change nothing; status 2 where something would change."
)
def texts(documents: tuple[str, ...], check: bool) -> None:
    """Fill in the numbers of README and docs from the records that they come from.

    experiments/texts/sources says which number comes from which record. What changes is printed; so
    are numbers that look measured and of which nothing says where they come from. DOCUMENTS are
    paths in the checkout; without any, all of them are read.

    \b
      python -m experiments texts
      python -m experiments texts docs/studies.md --check
    """  # noqa: D301 - click reads the backspace
    from experiments.texts.sentences import read_documents
    from lf_flame._common.atomic_files import write_text

    wrong = 0
    for document in read_documents():
        if documents and document.path not in documents:
            continue
        path = EXPERIMENTS.parent / document.path
        text = path.read_text(encoding="utf-8")
        filled, unsourced = document.filled(text), document.unsourced(text)
        changes = difflib.unified_diff(text.splitlines(), filled.splitlines(), n=0, lineterm="")
        click.echo(
            "\n".join([document.path, *list(changes)[2:], *(f"no source: {x}" for x in unsourced)])
        )
        wrong += (text != filled) + len(unsourced)
        if text != filled and not check:
            write_text(path, filled)
    if check and wrong:
        raise InputError("The documents and the records differ; `python -m experiments texts`.")
