"""Findings about a file: its kind, facts, what is missing, and the next command."""

import shlex
from dataclasses import dataclass, field
from pathlib import Path

from lf_flame._common.printable import printable

WIDTH = 14
"""Number of letters of the names of facts."""

LONGEST = 600
"""Largest number of letters of a sentence."""


@dataclass
class Found:
    """Kind and facts of a file.

    Attributes
    ----------
    kind : str
    facts : dict of str to str
        Facts by name, in the order in which they are printed.
    notes : list of str
        Sentences for the user.
    missing : list of str
        Sentences on the files or options that are needed to read it.
    command : str
        Command to type next; empty if there is none.
    shape : tuple of int
        Number of views and pixels, (v, u, t, s); empty if unknown.
    """

    kind: str
    facts: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    command: str = ""
    shape: tuple[int, ...] = ()

    def text(self, source: Path) -> str:
        """Describe it in lines: kind, facts, what is missing, and the next command."""
        lines = [f"{printable(source)}: {self.kind}"]
        lines += [
            f"  {printable(name, 40):<{WIDTH}}{printable(fact)}"
            for name, fact in self.facts.items()
        ]
        lines += [f"note: {printable(one, LONGEST)}" for one in self.notes]
        lines += [f"missing: {printable(one, LONGEST)}" for one in self.missing]
        return "\n".join(
            lines + ([f"next: {printable(self.command, LONGEST)}"] if self.command else [])
        )


def typed(*words: str | Path) -> str:
    """Command line, with its words quoted for a shell."""
    return f"lf-flame {' '.join(shlex.quote(str(word)) for word in words)}"
