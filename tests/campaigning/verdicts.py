"""Whether a program ended as it should: with its result, or with one sentence and status 2."""

import re
import signal
from dataclasses import dataclass

SENTENCE = re.compile(r"(lf-flame|python -m experiments|Error): ")
LONGEST_SENTENCE = 1000
LONGEST_TALK = 3000
"""Bytes of all that is said beside the result, without progress bars."""


@dataclass(frozen=True)
class Outcome:
    """How a program ended.

    Attributes
    ----------
    status : int or None
        As `subprocess` has it; None if it did not end in time.
    out, err : str
        What it printed.
    seconds : float
    grown : int
        Bytes of memory that it took, at most; 0 where that is not known.
    """

    status: int | None
    out: str
    err: str
    seconds: float
    grown: int = 0


def fault(outcome: Outcome, allowed: tuple[int, ...] = (0, 2)) -> str:
    """Say what is wrong with how a program ended; nothing if nothing is."""
    text = f"{outcome.out}\n{outcome.err}"
    if outcome.status is None:
        return f"did not end within {outcome.seconds:.0f} s"
    if "Traceback" in text:
        return f"traceback: {text.strip().splitlines()[-1][:300]}"
    if outcome.status < 0 and outcome.status not in allowed:
        return f"ended by {signal.Signals(-outcome.status).name}"
    if outcome.status not in allowed:
        return f"status {outcome.status}: {outcome.err.strip()[-300:]}"
    return _fault_of_sentence(outcome.err) if outcome.status == 2 else ""


def _fault_of_sentence(err: str) -> str:
    lines = [line for line in re.split(r"[\r\n]", err) if line and not re.search(r"\d%\|", line)]
    said = [line for line in lines if SENTENCE.match(line)]
    if len(said) != 1:
        return f"{len(said)} sentences instead of one: {' / '.join(lines)[-300:]}"
    if len(said[0].encode()) > LONGEST_SENTENCE:
        return f"a sentence of {len(said[0].encode())} bytes"
    talk = sum(len(line.encode()) for line in lines)
    return f"{talk} bytes beside the sentence" if talk > LONGEST_TALK else ""
