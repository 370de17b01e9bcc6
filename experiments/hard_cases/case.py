"""A hard case, and the errors of the obvious formula and of the package in it."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

UNIT, UNIT32 = 2.0**-53, 2.0**-24
"""Unit roundoffs of float64 and of float32."""

as_exact = np.frompyfunc(Fraction, 1, 1)


@dataclass(frozen=True)
class Values:
    """Values of a case: numbers, arrays of one shape, or words.

    Exact are they by rational arithmetic or a closed form, without the package. Errors are relative
    to the scale; default: the size of each exact value.
    """

    exact: Any
    obvious: Any
    ours: Any
    scale: Any = None


@dataclass(frozen=True)
class HardCase:
    """A case: what is hard, the formula that suggests itself, and what the package does instead.

    `allowed` is the largest error of the package, `fails_by` the least of the obvious formula over
    it.
    """

    name: str
    obvious: str
    here: str
    allowed: float
    find: Callable[[], Values]
    fails_by: float = 1e3


CASES: list[HardCase] = []


def hard_case(name: str, obvious: str, here: str, allowed: float, fails_by: float = 1e3):
    """Enter a function into `CASES`."""

    def enter(find: Callable[[], Values]) -> Callable[[], Values]:
        CASES.append(HardCase(name, obvious, here, allowed, find, fails_by))
        return find

    return enter


def measure(case: HardCase) -> dict[str, Any]:
    """Compute a case.

    Returns ``exact``, ``obvious`` and ``ours``, the values where the obvious formula is worst, as
    text; ``obvious_error`` and ``our_error``, the largest of all values, infinite where a value is
    no number or the word is wrong.
    """
    with np.errstate(all="ignore"):
        return _compare(case.find())


def _compare(values: Values) -> dict[str, Any]:
    if isinstance(values.exact, str):
        errors = [0.0 if x == values.exact else math.inf for x in (values.obvious, values.ours)]
        shown = values.exact, values.obvious, values.ours
    else:
        exact = np.atleast_1d(values.exact)
        scale = np.abs(exact) if values.scale is None else values.scale
        parts = [_errors(np.atleast_1d(x), exact, scale) for x in (values.obvious, values.ours)]
        errors = [float(part.max()) for part in parts]
        place = np.unravel_index(parts[0].argmax(), exact.shape)
        shown = (np.broadcast_to(x, exact.shape)[place] for x in
                 (exact, values.obvious, values.ours))  # fmt: skip
    texts = [x if isinstance(x, str) else f"{float(x) + 0.0:.6g}" for x in shown]
    names = ("exact", "obvious", "ours", "obvious_error", "our_error")
    return dict(zip(names, (*texts, *errors), strict=True))


def _errors(found: np.ndarray, exact: np.ndarray, scale: Any) -> np.ndarray:
    """Errors of each value; 0 for an infinity that is right, infinite for a number that is none."""

    def error(one: Any, truth: Any, size: Any) -> float:
        if not np.isfinite(float(one)) or not np.isfinite(float(truth)):
            return 0.0 if float(one) == float(truth) else math.inf
        difference = abs(Fraction(float(one)) - Fraction(truth))
        return float(difference / Fraction(size)) if difference else 0.0

    if exact.dtype == object:
        return np.frompyfunc(error, 3, 1)(found, exact, scale).astype(float)
    same = found == exact
    errors = np.abs(found.astype(float) - exact) / scale
    return np.where(same, 0.0, np.where(np.isfinite(errors), errors, math.inf))
