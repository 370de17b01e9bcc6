"""Calls with damaged files, and with values on the command line that make no sense."""

import os
import random
import re
from collections.abc import Callable
from pathlib import Path

import click
import pytest

from campaigning.contents import contents, differences, is_recorded
from campaigning.home import Copy, Home
from campaigning.processes import Outcome, Process, fault
from campaigning.table import Call, registered

VALUES = (
    "nan", "inf", "-1", "0", "1e308", "1e39", "9" * 400, '""', '"x"', '"../../x"', '"\\u0000"',
    "[]", "{}", "true", "null", "1e99999", "2020-01-01",
)  # fmt: skip
"""What a value in a text file becomes."""


def _flip(content: bytes, rng: random.Random) -> bytes:
    """Turn some bits around."""
    changed = bytearray(content)
    for _ in range(rng.choice((1, 2, 20)) if content else 0):
        changed[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _nest(content: bytes, rng: random.Random) -> bytes:
    """Put lists in lists in lists."""
    times = rng.choice((100, 100_000))
    return rng.choice((b"[" * times + b"]" * times, b'{"a":' * times, b"a = " + b"[" * times))


def _other_value(content: bytes, rng: random.Random) -> bytes:
    """Replace a value of a text file; some bits of any other."""
    text = content.decode(errors="replace")
    found = list(re.finditer(r'-?\d[\d.e+-]*|"[^"\n]*"|true|false|null', text))
    if not found or "\ufffd" in text:
        return _flip(content, rng)
    one = rng.choice(found)
    return (text[: one.start()] + rng.choice(VALUES) + text[one.end() :]).encode()


def _other_kind(path: Path, rng: random.Random) -> None:
    others = [
        x for x in sorted(path.parent.rglob("*.*")) if x.is_file() and x.suffix != path.suffix
    ]
    path.write_bytes(rng.choice(others).read_bytes() if others else b"\0")


CONTENTS: dict[str, Callable[[bytes, random.Random], bytes]] = {
    "cut": lambda content, rng: content[: rng.randrange(max(len(content), 1))],
    "flipped": _flip, "empty": lambda content, rng: b"", "nested": _nest,
    "another value": _other_value,
}  # fmt: skip
KINDS: dict[str, Callable[[Path, random.Random], None]] = {
    "gone": lambda path, rng: None,
    "a folder": lambda path, rng: path.mkdir(),
    "a pipe": lambda path, rng: os.mkfifo(path),
    "a link to /dev/zero": lambda path, rng: path.symlink_to("/dev/zero"),
    "another kind": _other_kind,
}
DAMAGES = [*CONTENTS, *KINDS]


def damage(path: Path, how: str, rng: random.Random) -> None:
    """Damage a file in one of `DAMAGES`."""
    content = path.read_bytes()
    path.unlink()
    if how in CONTENTS:
        path.write_bytes(CONTENTS[how](content, rng))
    else:
        KINDS[how](path, rng)


def _each(request, home: Home, asked: Call, names, rng: random.Random, work: Callable) -> None:
    """Try one of the files whose names differ in numbers alone; some, where a call takes long."""
    files = [name for name in names if (home.whole(asked).folder / name).is_file()]
    files = list({re.sub(r"[\d.+-]+", "#", name): name for name in files}.values())
    most = 1 if home.quick else 3 if asked.learns else len(files)
    files = rng.sample(files, min(most, len(files)))
    request.node.user_properties.append(("cases", len(files)))
    wrong = [f"{name}: {found}" for name in files if (found := work(name))]
    assert not wrong, "\n".join(wrong)


def _judge(copy: Copy, outcome: Outcome) -> str:
    """Say what is wrong with an end, or with what it has changed that is not its own."""
    may_write = outcome.status == 0 or copy.asked.goes_on
    changed = [name for name in copy.changes() if name in copy.before or not may_write]
    return fault(outcome) or (f"changed: {', '.join(changed[:4])}" if changed else "")


@pytest.mark.parametrize("how", DAMAGES)
def test_damaged_inputs(request, home: Home, asked: Call, how: str, rng: random.Random):
    """One sentence, or a result that no hash contradicts."""
    whole = home.whole(asked)

    def work(name: str) -> str:
        with home.copy(asked) as copy:
            before, recorded = copy.before[name], is_recorded(copy.folder / name)
            damage(copy.folder / name, how, rng)
            copy = Copy(copy.folder, asked)
            outcome = copy.call(limit_s=30.0 + 3 * whole.seconds)
            wrong, harmless = _judge(copy, outcome), copy.before.get(name) == before
            if wrong or outcome.status == 2 or harmless:
                return wrong
            if asked.command == "verify":
                return "not noticed" if recorded else ""
            if copy.changes() == whole.outputs:
                return ""
            read = [word for word in asked.reads if name.startswith(word)]
            seen = "DAMAGED" in copy.call(["lf_flame", "verify", *read]).out
            return "another result of what verify finds damaged" if seen else ""

    _each(request, home, asked, whole.inputs, rng, work)


@pytest.mark.parametrize("how", DAMAGES)
def test_damaged_outputs(request, home: Home, asked: Call, how: str, rng: random.Random):
    """Damaged behind a call, which is made again: the file stays, or the whole result is there."""
    whole = home.whole(asked)

    def work(name: str) -> str:
        with home.copy(asked, finished=True) as copy:
            recorded = is_recorded(copy.folder / name)
            damage(copy.folder / name, how, rng)
            damaged, expected = contents(copy.folder), copy.before | whole.outputs
            outcome = copy.call(limit_s=30.0 + 3 * whole.seconds)
            now = contents(copy.folder)
        stays, changed = now.get(name) == damaged.get(name), damaged.get(name, whole.outputs[name])
        if recorded and not stays and changed != whole.outputs[name]:
            return fault(outcome) or "replaced, though it has changed since it was written"
        if outcome.status == 2:
            return fault(outcome) or ("" if asked.goes_on else differences(now, damaged))
        if stays:
            now.pop(name, None), expected.pop(name)
        return fault(outcome) or differences(now, expected)

    _each(request, home, asked, whole.outputs, rng, work)


@pytest.mark.parametrize("how", DAMAGES)
def test_damaged_beginnings(home: Home, asked: Call, how: str, rng: random.Random):
    """Killed, a file of what is done damaged, called again: the whole result, or one sentence."""
    whole, share = home.whole(asked), rng.uniform(0.1, 0.9)
    with home.copy(asked) as copy:
        with Process(asked.words, copy.folder) as process:
            process.watch(lambda changes, seconds: changes >= share * whole.changes)
        begun = [x for x in copy.changes() if (copy.folder / x).is_file() and ".lock" not in x]
        if begun and copy.changes() != whole.outputs:
            name = rng.choice(begun)
            damage(copy.folder / name, how, rng)
            outcome = copy.call()
            assert not fault(outcome), name
            assert outcome.status == 2 or not differences(copy.changes(), whole.outputs), name


NUMBERS = ("nan", "inf", "-inf", "1e308", "-1", "0", "1e-320", "1e400", "2147483648", "9" * 400,
           "0x10", "1_0", "1.5", "", "x")  # fmt: skip
TEXTS = ("", " ", "x", "nan", "a" * 70_000, "../../x", "a\nb", "\x1b[31m", "%s{0}", "1,2", "\udcff")
PATHS = ("", ".", "..", "none", "x" * 300, "a\nb", "/dev/zero", "/proc/self/mem", "pipe", "\udcff")


@pytest.mark.parametrize("draw", range(4))
def test_malformed(request, home: Home, asked: Call, draw: int, rng: random.Random):
    """A value that makes no sense for each parameter: one sentence, and nothing has changed."""
    parameters = registered()[asked.command].params
    parameters = rng.sample(parameters, 2) if home.quick and len(parameters) > 2 else parameters
    request.node.user_properties.append(("cases", len(parameters)))
    wrong = []
    for parameter in parameters:
        words = with_value(asked, parameter, rng)
        with home.copy(asked) as copy:
            outcome = copy.call(words, limit_s=20.0)
            found = _judge(copy, outcome)
        is_count = isinstance(parameter.type, click.types.IntParamType)
        may_take_long = outcome.status is None and (is_count or asked.goes_on or asked.minutes)
        if found and not may_take_long:
            wrong.append(f"{' '.join(words)[:300]}: {found}")
    assert not wrong, "\n".join(wrong)


def with_value(asked: Call, parameter: click.Parameter, rng: random.Random) -> list[str]:
    """Give the words of a call, with another value of a parameter."""
    words = asked.words
    if isinstance(parameter, click.Argument):
        arguments = [p for p in registered()[asked.command].params if isinstance(p, click.Argument)]
        words[2 + arguments.index(parameter)] = _strange(parameter.type, asked, rng)
        return words
    name = next(x for x in parameter.opts if x.startswith("--"))
    kinds = getattr(parameter.type, "types", None) or [parameter.type] * parameter.nargs
    kinds = [] if parameter.is_flag else kinds
    if name in words and not parameter.multiple:
        at = words.index(name)
        del words[at : at + 1 + len(kinds)]
    return [*words, name, *(_strange(kind, asked, rng) for kind in kinds)]


def _strange(kind: click.ParamType, asked: Call, rng: random.Random) -> str:
    """Draw a value that a type of click's must refuse, or at the end of what it takes."""
    if isinstance(kind, click.Path):
        return rng.choice((*PATHS, *asked.reads[1:]))
    if isinstance(kind, click.types.IntParamType | click.types.FloatParamType):
        least, most = getattr(kind, "min", None), getattr(kind, "max", None)
        beyond = [str(x) for x in (least and least - 1, most and most + 1) if x is not None]
        return rng.choice((*NUMBERS, *beyond))
    return rng.choice(TEXTS)
