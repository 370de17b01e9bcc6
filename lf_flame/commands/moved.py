"""Commands that were here before: each says in one sentence where it is now."""

import click

from lf_flame.errors import InputError

MOVED = {
    "slopes": "slopes",
    "evaluate": "evaluate",
    "tables": "tables",
    "costs": "costs",
    "latency": "latency",
    "study": "study",
    "swap-test": "depth-test",
    "compare": "compare",
}
"""Old names, and the names that they have among the project's experiments."""


def moved_commands() -> list[click.Command]:
    """Make a hidden command for every old name."""
    return [_moved(old, new) for old, new in MOVED.items()]


def _moved(old: str, new: str) -> click.Command:
    def refuse(arguments):
        raise InputError(
            f"`lf-flame {old}` belongs to the project's experiments and is now "
            f"`python -m experiments {new}`, to be run in a checkout of the project."
        )

    return click.Command(
        old,
        callback=refuse,
        params=[click.Argument(["arguments"], nargs=-1, type=click.UNPROCESSED)],
        context_settings={"ignore_unknown_options": True, "allow_interspersed_args": False},
        help=f"Moved: python -m experiments {new}.",
        hidden=True,
        add_help_option=False,
    )
