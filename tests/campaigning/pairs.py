"""Two commands at once that write to one place."""

import random
import time
from dataclasses import dataclass
from itertools import combinations_with_replacement
from pathlib import Path

from campaigning.commands import BY_NAME, LEARNING, WRITING, Command
from campaigning.processes import LIMIT_S, Process, call
from campaigning.verdicts import fault
from campaigning.workplace import Workplace

PART = "pairs"

OTHERS = (
    Command("train, another seed", BY_NAME["train"].arguments + " --seed 2", goes_on=True),
    Command("convert something else to .npy", "convert lenslets.tif out.npy --views 3", "out.npy"),
)
"""Commands that write the same files with another content."""


@dataclass(frozen=True)
class Pair:
    """Two commands at once.

    Parameters
    ----------
    number : int
    commands : (Command, Command)
    delay_s : float
        Between their starts.
    """

    number: int
    commands: tuple[Command, Command]
    delay_s: float
    part = PART

    @property
    def name(self) -> str:
        """What the report counts it under."""
        return self.commands[0].name

    @property
    def what(self) -> str:
        """Say what is done."""
        return f"at once with {self.commands[1].name}, {1e3 * self.delay_s:.0f} ms later"

    def try_out(self, workplace: Workplace) -> str:
        """Say what goes wrong; nothing if nothing does."""
        alone = [workplace.reference(command).contents for command in self.commands]
        with workplace.copy() as home:
            statuses, wrong = self._start_both(home)
            if wrong:
                return wrong
            done = [k for k in (0, 1) if statuses[k] == 0]
            if not done:
                return "both are refused"
            wrong = _mixed(workplace.home.changes(home), alone, done)
            return wrong or self._check_again(home, done, statuses)

    def _start_both(self, home: Path) -> tuple[list[int | None], str]:
        first = Process(self.commands[0].words, home)
        time.sleep(self.delay_s)
        both = (first, Process(self.commands[1].words, home))
        try:
            outcomes = [process.wait(LIMIT_S) for process in both]
        finally:
            for process in both:
                process.end()
        faults = [
            f"{command.name}: {wrong}"
            for command, outcome in zip(self.commands, outcomes, strict=True)
            if (wrong := fault(outcome))
        ]
        return [outcome.status for outcome in outcomes], "; ".join(faults)

    def _check_again(self, home: Path, done: list[int], statuses: list) -> str:
        """Check hashes, and that one of the commands that succeeded does so again."""
        verified = call(["lf_flame", "verify", self.commands[0].out], home)
        if wrong := fault(verified):
            return f"verify: {wrong}"
        if verified.status == 2 and "nothing whose hash" not in verified.out:
            return f"verify: {verified.out[-300:]}"
        again = [call(self.commands[k].words, home) for k in done]
        if wrong := "; ".join(filter(None, map(fault, again))):
            return f"once more: {wrong}"
        refusing = all(self.commands[k].refuses_again for k in done)
        if not refusing and all(outcome.status == 2 for outcome in again):
            return f"once more: {again[0].err.strip()[-300:]}"
        return ""


def _mixed(found: dict[str, str], alone: list[dict[str, str]], done: list[int]) -> str:
    """Whether files are of neither command, or the result of one is not whole."""
    strange = [n for n, what in found.items() if what not in [one.get(n) for one in alone]]
    if strange:
        return f"of neither command: {', '.join(strange[:4])}"
    shared = [name for name in alone[0] if name in alone[1] and alone[0][name] != alone[1][name]]
    winners = {next(k for k in (0, 1) if found.get(n) == alone[k][n]) for n in shared if n in found}
    if len(winners) > 1:
        return f"files of both, mixed: {', '.join(shared[:4])}"
    # A later call may remove the pictures of an earlier one; then its own are all there.
    missing = [[name for name in alone[k] if name not in found] for k in done]
    return f"missing: {', '.join(missing[0][:4])}" if missing and all(missing) else ""


def cases(seed: int, quick: bool) -> list[Pair]:
    """List all pairs of commands that can share an output."""
    rng, pairs = random.Random(f"{seed}:pairs"), []
    for pair in combinations_with_replacement((*WRITING, *OTHERS), 2):
        if len({command.out for command in pair}) == 1:
            pairs.append(Pair(len(pairs), pair, rng.choice((0.0, rng.uniform(0, 1.0)))))
    if not quick:
        return pairs
    return [pair for pair in pairs if _is_quick(pair)]


def _is_quick(pair: Pair) -> bool:
    first, second = pair.commands
    return first == second and not first.name.startswith(LEARNING) and "2" not in first.name
