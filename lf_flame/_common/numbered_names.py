"""Numbers in file names: counts, signed positions, decimals, and natural order."""

import re
from collections import defaultdict
from collections.abc import Sequence
from decimal import Decimal

NUMBER = re.compile(r"([-+]?)([0-9]+(?:\.[0-9]+)*)")
"""Pattern of an optional sign or hyphen, then digits that points may divide."""

Parts = tuple[str | Decimal, ...]
"""Text and numbers of a name in turn; text, perhaps empty, comes first and last."""


def split_numbers(names: Sequence[str]) -> list[Parts]:
    """Split names into text and numbers, so that they sort in natural order.

    Names that differ only in their numbers are read together, because this shows what hyphens and
    points mean. A hyphen is a minus sign if it follows neither a letter nor a digit (``pos_-40``,
    unlike ``view-40`` and ``2024-01-05``), if other names have no hyphen at the same place (``y-4,
    y0, y4``), or if a name has a plus sign (``y-5x+2``). A point is a decimal point if it is the
    only one of a number, and if all numbers have the same count of decimals or none ends in 0
    (``5.48``, unlike ``1.9, 1.10``).

    Parameters
    ----------
    names : sequence of str
        Names without their endings.

    Returns
    -------
    list of tuple
        Parts of each name: ``("pos_", Decimal(-40), "_", Decimal("0.5"), "")``. Sorted by these,
        ``frame2`` comes before ``frame10``; ``parts[1::2]`` are the exact numbers.
    """
    alike: dict[tuple[str, ...], list[int]] = defaultdict(list)
    pieces = [NUMBER.split(name) for name in names]
    for k, one in enumerate(pieces):
        alike[tuple(one[::3])].append(k)
    found: dict[int, Parts] = {}
    for places in alike.values():
        found.update(zip(places, _split_alike([pieces[k] for k in places]), strict=True))
    return [found[k] for k in range(len(names))]


def _split_alike(pieces: list[list[str]]) -> list[Parts]:
    """Split names that have the same text between the numbers."""
    parts: list[list[str | Decimal]] = [[one[0]] for one in pieces]
    signed = any("+" in one[1::3] for one in pieces)
    for k in range(1, len(pieces[0]), 3):
        before = pieces[0][k - 1]
        marks, words = [one[k] for one in pieces], [one[k + 1] for one in pieces]
        joined = before[-1:].isalnum() or (k > 1 and not before)
        separates = joined and not signed and set(marks) == {"-"}
        decimal = _is_decimal(words)
        for part, mark, word, one in zip(parts, marks, words, pieces, strict=True):
            if separates:
                part[-1] = f"{part[-1]}{mark}"
            numbers = [word] if decimal else word.split(".")
            numbers[0] = numbers[0] if separates else mark + numbers[0]
            for number in numbers:
                part += [Decimal(number), "."]
            part[-1] = one[k + 2]
    return [tuple(part) for part in parts]


def _is_decimal(words: Sequence[str]) -> bool:
    """Whether the points in strings of digits are decimal points."""
    if any(word.count(".") > 1 for word in words):
        return False
    decimals = [word.partition(".")[2] for word in words]
    alike = len({len(word) for word in decimals if word}) <= 1
    return alike or not any(word.endswith("0") for word in decimals)
