"""Where one case after another is tried out, and what all of them share."""

import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from campaigning.commands import Command
from campaigning.home import Home
from campaigning.processes import Process, watch
from campaigning.verdicts import Outcome, fault
from campaigning.warm_process import WarmProcess


@dataclass(frozen=True)
class Reference:
    """What a command does if nothing disturbs it.

    Attributes
    ----------
    contents : dict of str
        What has changed in the home.
    seconds : float
    changes : int
        How often its files were seen to change.
    largest : int
        Bytes of the largest file that it wrote.
    """

    contents: dict[str, str]
    seconds: float
    changes: int
    largest: int


class References:
    """References of commands, each worked out when it is first asked for."""

    def __init__(self, home: Home):
        self._home = home
        self._found: dict[tuple, Reference | Outcome] = {}
        self._locks: dict[tuple, threading.Lock] = {}
        self._all = threading.Lock()

    def of(self, command: Command, place: Path) -> Reference:
        """Call a command undisturbed, in a folder of its own."""
        return self._once((command.words[0], command.arguments), lambda: self._call(command, place))

    def warm(self, words: list[str], workplace: "Workplace") -> tuple[Outcome, dict[str, str]]:
        """Call a command in a warm process: how it ends, and what changes."""

        def work():
            with workplace.copy() as home:
                workplace.warm.call(words, home, FIRST_S)  # compiles
            with workplace.copy() as home:
                outcome = workplace.warm.call(words, home, FIRST_S)
                return outcome, self._home.changes(home)

        return self._once(("warm", *words), work)

    def _once(self, key: tuple, work):
        with self._all:
            lock = self._locks.setdefault(key, threading.Lock())
        with lock:
            if key not in self._found:
                self._found[key] = work()
            return self._found[key]

    def _call(self, command: Command, place: Path) -> Reference:
        home = self._home.copy(place)
        process = Process(command.words, home)
        changes = watch(process, home, lambda count, seconds: False)
        outcome = process.wait()
        if wrong := fault(outcome, (0,)):
            raise RuntimeError(f"{command.name}, undisturbed: {wrong}")
        found = self._home.changes(home)
        sizes = [(home / name).stat().st_size for name in found if (home / name).is_file()]
        shutil.rmtree(home)
        return Reference(found, outcome.seconds, changes, max(sizes))


FIRST_S = 120.0
"""Seconds that a command may take when it is called for the first time."""


class Workplace:
    """A place for one case at a time.

    Parameters
    ----------
    folder : Path
    home : Home
    references : References
    learning : bool
        Whether its warm process loads TensorFlow.
    """

    def __init__(self, folder: Path, home: Home, references: References, learning: bool):
        self.folder, self.home, self._references = folder, home, references
        folder.mkdir()
        self.warm = WarmProcess(folder.with_name(f"{folder.name}-warm"), learning)
        self._count = 0

    def reference(self, command: Command) -> Reference:
        """What a command does if nothing disturbs it."""
        return self._references.of(command, self._new())

    def warm_reference(self, words: list[str]) -> tuple[Outcome, dict[str, str]]:
        """How an undisturbed command ends in a warm process, and what changes."""
        return self._references.warm(words, self)

    @contextmanager
    def copy(self) -> Iterator[Path]:
        """Give a copy of the home for a while."""
        home = self.home.copy(self._new())
        try:
            yield home
        finally:
            shutil.rmtree(home, ignore_errors=True)

    def _new(self) -> Path:
        self._count += 1
        return self.folder / f"{self._count:05d}"

    def end(self) -> None:
        """End its warm process."""
        self.warm.end()
