"""Commands killed, or interrupted, at random instants; then called again.

Half of the instants are drawn over the whole time that a command takes, the other half lie just
behind a change of its files, when it writes.
"""

import random
import re
import signal
from dataclasses import dataclass

from campaigning.commands import WRITING, Command
from campaigning.contents import differences
from campaigning.processes import Process, call, watch
from campaigning.verdicts import Outcome, fault
from campaigning.workplace import Reference, Workplace

PART = "kills"
KILL, INTERRUPT = "kill -9", "Ctrl-C"
INTERRUPTED = (130, -signal.SIGINT)
"""Status by the program, and by the interpreter before it starts and when it has ended."""


@dataclass(frozen=True)
class Kill:
    """One kill.

    Parameters
    ----------
    number : int
    command : Command
    by : str
    share : float
        Of the time, or of the changes, that lie before it.
    delay_s : float or None
        Behind a change; None where the time alone counts.
    """

    number: int
    command: Command
    by: str
    share: float
    delay_s: float | None
    part = PART

    @property
    def name(self) -> str:
        """What the report counts it under."""
        return self.command.name

    @property
    def what(self) -> str:
        """Say what is done."""
        if self.delay_s is None:
            return f"{self.by} at {self.share:.1%} of the time"
        return f"{self.by} {1e3 * self.delay_s:.0f} ms behind {self.share:.1%} of the changes"

    def try_out(self, workplace: Workplace) -> str:
        """Say what goes wrong; nothing if nothing does."""
        whole = workplace.reference(self.command)
        with workplace.copy() as home:
            if wrong := self._kill(home, whole):
                return wrong
            unchanged = workplace.home.changes(home) == whole.contents
            allowed = (0, 2) if self.command.refuses_again and unchanged else (0,)
            if wrong := fault(call(self.command.words, home), allowed):
                return f"the same command again: {wrong}"
            return differences(workplace.home.changes(home), whole.contents)

    def _kill(self, home, whole: Reference) -> str:
        process = Process(self.command.words, home)
        try:
            watch(process, home, self._is_due(whole))
            by_kill = self.by == KILL
            process.kill() if by_kill else process.interrupt()
            outcome = process.wait()
            if left := process.survivors():
                return f"{left} processes live on"
        finally:
            process.end()
        if by_kill or _is_outside(outcome):
            return ""
        return fault(outcome, (0, *INTERRUPTED))

    def _is_due(self, whole: Reference):
        if self.delay_s is None:
            return lambda count, seconds: seconds >= self.share * whole.seconds
        wanted, seen = max(round(self.share * whole.changes), 1), []

        def is_due(count: int, seconds: float) -> bool:
            if count >= wanted:
                seen.append(seconds)
            return bool(seen) and seconds - seen[0] >= self.delay_s

        return is_due


def _is_outside(outcome: Outcome) -> bool:
    """Whether the interpreter was interrupted before it had our program, or when that had ended."""
    ours = re.search(r'program\.py", line \d+, in run', outcome.err)
    return "KeyboardInterrupt" in outcome.err and not ours


def cases(seed: int, quick: bool) -> list[Kill]:
    """Draw the kills."""
    drawn = []
    for command in WRITING:
        rng = random.Random(f"{seed}:{command.name}")
        for k in range(command.kills):
            by = INTERRUPT if k % 2 else KILL
            delay_s = rng.choice((0.0, rng.uniform(0, 0.02))) if k // 2 % 2 else None
            drawn.append((k, Kill(0, command, by, rng.random(), delay_s)))
    numbered = [Kill(n, *_but_number(kill)) for n, (_, kill) in enumerate(drawn)]
    if not quick:
        return numbered
    chosen = [k in (1, 2) and kill.command.kills > 12 for k, kill in drawn]
    return [kill for kill, is_quick in zip(numbered, chosen, strict=True) if is_quick]


def _but_number(kill: Kill) -> tuple:
    return kill.command, kill.by, kill.share, kill.delay_s
