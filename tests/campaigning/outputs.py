"""Calls that are killed, or made twice at once, or whose output cannot be where it is to be."""

import os
import random
import re
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from campaigning.contents import differences
from campaigning.home import Copy, Home, Whole
from campaigning.processes import LIMIT_S, Process, fault
from campaigning.table import CALLS, Call


@pytest.mark.parametrize("draw", range(8))
def test_kills(home: Home, asked: Call, draw: int, rng: random.Random):
    """Killed or interrupted at a random moment, then called again: the result is the same."""
    whole, by = home.whole(asked), rng.choice((signal.SIGKILL, signal.SIGINT))
    with home.copy(asked) as copy:
        with Process(asked.words, copy.folder) as process:
            process.watch(_moment(whole, rng))
            print(f"{by.name} after {process.seconds:.2f} s of {whole.seconds:.2f} s")
            process.send(by)
            outcome = process.wait()
            assert not process.leaves_helpers()
        # The interpreter itself may be interrupted, before it runs the program or after its end.
        inside = re.search(r'program\.py", line \d+, in run', outcome.err)
        if by == signal.SIGINT and (inside or "KeyboardInterrupt" not in outcome.err):
            assert not fault(outcome, 0, 130, -signal.SIGINT)
        _check_again(copy, whole)


def _moment(whole: Whole, rng: random.Random) -> Callable[[int, float], bool]:
    """Draw a moment: at any time, or within milliseconds of a change of files."""
    share, delay_s, seen = rng.random(), rng.choice((0.0, rng.uniform(0, 0.02))), []
    if rng.random() < 0.5:
        return lambda changes, seconds: seconds >= share * whole.seconds

    def is_due(changes: int, seconds: float) -> bool:
        if changes >= max(round(share * whole.changes), 1):
            seen.append(seconds)
        return bool(seen) and seconds - seen[0] >= delay_s

    return is_due


def _check_again(copy: Copy, whole: Whole) -> None:
    """Make the call once more: its whole result is there then."""
    refuses = copy.asked.once and copy.changes() == whole.outputs
    assert not fault(copy.call(), 0, 2 if refuses else 0)
    assert not differences(copy.changes(), whole.outputs)


@pytest.mark.parametrize("behind", range(3))
def test_pairs(home: Home, asked: Call, behind: int, rng: random.Random):
    """Two calls at once, itself or others that write to one place: one result is whole."""
    same = [x for x in CALLS if x.outputs == asked.outputs and not x.minutes]
    same = [x for x in same if not (x.learns and home.quick)]
    other = same[(same.index(asked) + behind) % len(same)]
    wholes = [home.whole(x).outputs for x in (asked, other)]
    with home.copy(asked) as copy:
        copy = Copy(home.add_inputs(other, copy.folder), asked)
        with Process(asked.words, copy.folder) as first:
            time.sleep(rng.choice((0.0, rng.uniform(0, 1.0))))
            with Process(other.words, copy.folder) as second:
                outcomes = [first.wait(), second.wait()]
        found = copy.changes()
    assert not any(map(fault, outcomes)), list(map(fault, outcomes))
    strange = [name for name, what in found.items() if what not in [w.get(name) for w in wholes]]
    assert not strange, f"of neither {asked.line} nor {other.line}: {strange}"
    written = [w for w, outcome in zip(wholes, outcomes, strict=True) if outcome.status == 0]
    missing = [differences(found | whole, found) for whole in written]
    assert missing, "both are refused"
    assert not all(missing), f"with {other.line} no whole result: {missing}"


def _own(place: Path, is_file: bool = False) -> None:
    if not is_file:
        place.mkdir()
    (place if is_file else place / "thesis.txt").write_text("years of work")


def _link_to_folder(out: Path) -> None:
    _own(out.with_name("elsewhere"))
    out.symlink_to("elsewhere")


PLACES: dict[str, Callable[[Path], None] | None] = {
    "a link to a folder": _link_to_folder,
    "a link to a file": lambda out: out.symlink_to("thesis.txt"),
    "a link to nothing": lambda out: out.symlink_to("elsewhere"),
    "a link to itself": lambda out: out.symlink_to(out.name),
    "a link to /dev/full": lambda out: out.symlink_to("/dev/full"),
    "a pipe": lambda out: os.mkfifo(out),
    "a file for a folder, a folder for a file": lambda out: _own(out, not out.suffix),
    "the user's own": lambda out: _own(out, bool(out.suffix)),
    "a folder that may not be written": lambda out: out.parent.chmod(0o555),  # but by root
    "/proc/out": None, "thesis.txt/out": None, "x" * 300: None,
}  # fmt: skip
"""What is at the place of an output; without a function, an output that cannot be there."""


@pytest.mark.parametrize("what", PLACES)
def test_places(home: Home, asked: Call, what: str, rng: random.Random):
    """Outputs that cannot be where they are to be: what was there before stays."""
    output, prepare, words = rng.choice(asked.outputs), PLACES[what], asked.words
    with home.copy(asked) as copy:
        _own(copy.folder / "thesis.txt", is_file=True)
        if prepare:
            prepare(copy.folder / output)
        else:
            words = [what + Path(output).suffix if x == output else x for x in words]
        copy = Copy(copy.folder, asked)
        outcome = copy.call(words, limit_s=20.0 if asked.minutes else LIMIT_S)
        copy.folder.chmod(0o755)
        changes = copy.changes()
    mine: tuple[str, ...] = ()
    if outcome.status != 2 or asked.goes_on:  # also through a link to a folder, or beside, as cards
        mine = (*asked.outputs, "elsewhere", *({} if asked.minutes else home.whole(asked).outputs))
    within = tuple(f"{out}{end}" for out in mine for end in ("/", ".part"))
    strange = [x for x in changes if x not in mine and not x.startswith(within)]
    assert not strange + [x for x in changes if x.endswith("thesis.txt")]
    assert not fault(outcome) or (asked.minutes and outcome.status is None)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_full_disks(home: Home, asked: Call, share: float, rng: random.Random):
    """A disk that is full at a share of the largest file: nothing changes; then all is there."""
    whole = home.whole(asked)
    with home.copy(asked) as copy:
        outcome = copy.call(largest_file=int(share * whole.largest))
        assert not fault(outcome, 2)
        assert asked.goes_on or not copy.changes()
        _check_again(copy, whole)
