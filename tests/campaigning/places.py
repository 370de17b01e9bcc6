"""Outputs that are links, devices, pipes or on a full disk: what was there before stays."""

import os
import random
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from campaigning.commands import LEARNING, WRITING, Command
from campaigning.contents import contents, differences
from campaigning.processes import call
from campaigning.verdicts import fault
from campaigning.workplace import Workplace

PART = "places"


def _link(target: str) -> Callable[[Path], None]:
    return lambda out: out.symlink_to(target)


def _link_to_folder(out: Path) -> None:
    (out.parent / "elsewhere").mkdir()
    (out.parent / "elsewhere" / "thesis.txt").write_text("years of work")
    out.symlink_to("elsewhere")


def _wrong_kind(out: Path) -> None:
    """Put a file where a folder is wanted, and a folder where a file is."""
    if out.suffix:
        out.mkdir()
        (out / "thesis.txt").write_text("years of work")
    else:
        out.write_text("years of work")


def _another_content(out: Path) -> None:
    """Put the user's own things where the output is to be."""
    if not out.suffix:
        out.mkdir()
    (out / "thesis.txt" if not out.suffix else out).write_text("years of work")


def _read_only(out: Path) -> None:
    out.parent.chmod(0o555)


PLACES: dict[str, Callable[[Path], None]] = {
    "a link to a folder": _link_to_folder,
    "a link to a file": _link("scene.toml"),
    "a link to nothing": _link("nowhere"),
    "a link to itself": lambda out: out.symlink_to(out.name),
    "a link to /dev/full": _link("/dev/full"),
    "a pipe": lambda out: os.mkfifo(out),
    "a file for a folder, a folder for a file": _wrong_kind,
    "the user's own": _another_content,
    "in a folder that may not be written": _read_only,
}
"""What stands where the output is to be."""

NAMES = ("/dev/null", "/dev/zero", "/dev/full", "x" * 300, "scene.toml/out", "/proc/out")
"""Outputs that cannot be."""

FULL = (0, 1000, 0.3, 0.9)
"""Bytes behind which a file cannot grow, or the share of the largest file's."""


@dataclass(frozen=True)
class Place:
    """A command with an output that cannot be, or a disk that is full.

    Parameters
    ----------
    number : int
    command : Command
    what : str
    full : float, optional
        Of `FULL`.
    """

    number: int
    command: Command
    what: str
    full: float | None = None
    part = PART

    @property
    def name(self) -> str:
        """What the report counts it under."""
        return self.command.name

    def try_out(self, workplace: Workplace) -> str:
        """Say what goes wrong; nothing if nothing does."""
        if self.what == "in a folder that may not be written" and os.geteuid() == 0:
            return ""  # nothing stops root
        with workplace.copy() as home:
            try:
                work = self._write if self.full is None else self._fill
                return work(workplace, home)
            finally:
                home.chmod(0o755)

    def _write(self, workplace: Workplace, home: Path) -> str:
        command = self.command
        if self.what in PLACES:
            PLACES[self.what](home / command.out)
        else:
            command = command.to(self.what)
        before = contents(home, workplace.home.known)
        outcome = call(command.words, home)
        after = contents(home, workplace.home.known)
        if wrong := fault(outcome):
            return wrong
        mine: tuple[str, ...] = ()
        if outcome.status == 0:  # what it writes beside its output is its own too
            beside = workplace.reference(self.command).contents
            mine = (command.out, "elsewhere", "nowhere", *beside)
        return differences(
            {name: what for name, what in after.items() if not _is_of(name, mine)},
            {name: what for name, what in before.items() if not _is_of(name, mine)},
        ) or _lost(before, after)

    def _fill(self, workplace: Workplace, home: Path) -> str:
        """Let the disk be full in the middle; then call again."""
        whole = workplace.reference(self.command)
        before = contents(home, workplace.home.known)
        limit = int(self.full if self.full >= 1 or not self.full else self.full * whole.largest)
        outcome = call(self.command.words, home, largest_file=limit)
        if wrong := fault(outcome):
            return wrong
        after = contents(home, workplace.home.known)
        if outcome.status == 2 and not self.command.goes_on and after != before:
            return f"what was there is not as before: {differences(after, before)}"
        if outcome.status == 0 and self.full < 1:
            return "status 0, though not all could be written"
        again = call(self.command.words, home)
        wrong = fault(again, (0, 2) if self.command.refuses_again else (0,))
        if wrong:
            return f"the same command again: {wrong}"
        return differences(workplace.home.changes(home), whole.contents)


def _is_of(name: str, outputs: tuple[str, ...]) -> bool:
    return any(name == out or name.startswith(f"{out}/") for out in outputs)


def _lost(before: dict[str, str], after: dict[str, str]) -> str:
    """Whether what the user had there is no longer there."""
    own = [name for name in before if name.endswith("thesis.txt")]
    lost = [name for name in own if before[name] != after.get(name)]
    return f"lost: {', '.join(lost)}" if lost else ""


def cases(seed: int, quick: bool) -> list[Place]:
    """List all commands in all places; of those that start TensorFlow every third."""
    found = []
    for command in WRITING:
        step = 3 if command.name in LEARNING else 1
        for what in (*PLACES, *NAMES)[len(found) % step :: step]:
            found.append(Place(len(found), command, what))
        for full in FULL:
            found.append(Place(len(found), command, f"a full disk, {full:g}", full))
    if not quick:
        return found
    cheap = [case for case in found if case.command.name not in LEARNING]
    return random.Random(seed).sample(cheap, 16)
