"""Classical iterations for emission, stopped where the residual falls to the noise.

All solve ``A x = y`` with no penalty; what keeps noise out is that they stop early. They need
nothing but the operator A, which has no negative element, and its adjoint. Rays of weight 0 are
rows of zeros.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from pylops import Diagonal, LinearOperator
from scipy.sparse.linalg import LinearOperator as ScipyOperator
from scipy.sparse.linalg import lsqr

from lf_flame._common import progress
from lf_flame.errors import InputError
from lf_flame.tomography.error_bars import noise_variance

PENALISED = "penalised"
"""Name of the penalised fit, which is no iteration of this module."""

MOST = 1000
"""Largest number of iterations."""

PEDESTAL = 2.0
"""Constant, in standard deviations of the noise, that MLEM adds to data and model, because it knows
no negative data; what is still negative is set to 0, which adds less than 0.01 standard deviations
in the dark."""

Steps = Iterator[tuple[np.ndarray, np.ndarray]]
"""Cells, and their rays, one iteration after the other, starting with those before the first."""

Stopped = tuple[np.ndarray, int, float]
"""Cells, number of iterations, and squared residual."""

UNREACHED = (
    "{} was stopped after {} iterations, before its residual fell to the noise: its square is "
    "{:.3g} times as large. Allow more iterations, or see the other warnings."
)


class Iterated(NamedTuple):
    """Result of an iteration.

    Attributes
    ----------
    cells : ndarray of float32, shape (cells,)
        Cells; 0 or above, but for LSQR.
    iterations : int
        Number of iterations.
    warnings : tuple of str
        A sentence if the residual did not fall to the noise.
    """

    cells: np.ndarray
    iterations: int
    warnings: tuple[str, ...] = ()


def check_method(method: str, strength: float | None, changed: bool) -> None:
    """Refuse an unknown method, and options that it does not have.

    Parameters
    ----------
    method : str
    strength : float or None
    changed : bool
        Whether another penalty than the default was asked for.

    Raises
    ------
    InputError
        If the method is unknown, or an option only applies to the penalised fit.
    """
    if method not in METHODS:
        raise InputError(f"method must be one of {', '.join(METHODS)}, got {method!r}.")
    if method != PENALISED and (strength is not None or changed):
        raise InputError(f"method {method!r} has no penalty and no strength: it stops early.")


def check_bars(method: str, bootstrap: int) -> None:
    """Refuse error bars of a method that has none.

    Raises
    ------
    InputError
        If draws are asked for, and the method is not the penalised fit.
    """
    if bootstrap and method != PENALISED:
        raise InputError(
            f"method {method!r} has no error bars: draws would show the noise, and not what "
            f"stopping early leaves out; bootstrap must be 0, got {bootstrap}."
        )


def iterate(
    method: str,
    operator: LinearOperator,
    views: np.ndarray,
    valid: np.ndarray | None,
    noise: float,
    most: int = MOST,
) -> Iterated:
    """Iterate until the squared residual falls to the noise (discrepancy principle).

    Parameters
    ----------
    method : {"sart", "mlem", "lsqr", "nnls"}
    operator : LinearOperator
        Operator from cells to rays, both flat, without negative elements.
    views : ndarray of float32
        Measured light of the rays.
    valid : ndarray of bool, shape of `views`, or None
        Whether each ray is known, or has weight 0; None if all are.
    noise : float
        Standard deviation of a ray's noise.
    most : int, optional
        Largest number of iterations.
    """
    rays, known = views.ravel(), views.size
    if valid is not None:
        weights, known = valid.ravel().astype(np.float32), int(np.count_nonzero(valid))
        rays, operator = weights * rays, Diagonal(weights, dtype="float32") @ operator
    goal = known * noise_variance(noise)
    cells, count, squared = (
        _by_lsqr(operator, rays, goal, most)
        if method == "lsqr"
        else _until(STEPS[method](operator, rays, float(np.sqrt(goal / known))), rays, goal, most)
    )
    if squared <= goal:
        return Iterated(cells, count)
    return Iterated(cells, count, (UNREACHED.format(method.upper(), count, squared / goal),))


def _until(steps: Steps, rays: np.ndarray, goal: float, most: int) -> Stopped:
    """Take steps until the squared residual falls to a goal."""
    with progress.bar("fitting", most) as shown:
        for count, (cells, seen) in enumerate(steps):
            squared = float(np.sum(np.square(rays - seen, dtype=np.float64)))
            if squared <= goal or count == most:
                return cells, count, squared
            shown.update()
    raise AssertionError("steps have no end")


def _sums(operator: LinearOperator) -> tuple[np.ndarray, np.ndarray]:
    """Sum of each row and of each column, float32."""
    rays, cells = (np.ones(count, np.float32) for count in operator.shape)
    return operator.matvec(cells), operator.rmatvec(rays)


def _inverse(sums: np.ndarray) -> np.ndarray:
    """Inverse of sums; 0 where hardly anything was summed."""
    enough = sums > 1e-6 * sums.max()
    return np.divide(1, sums, out=np.zeros_like(sums), where=enough)


def _sart(operator: LinearOperator, rays: np.ndarray, noise: float) -> Steps:
    """SART (Andersen and Kak, Ultrason. Imaging 6, 81, 1984) with all views at once, as SIRT does.

    ``x <- max(x + A'((y - A x) / rows) / columns, 0)``
    """
    by_row, by_column = (_inverse(one) for one in _sums(operator))
    cells = np.zeros(operator.shape[1], np.float32)
    while True:
        seen = operator.matvec(cells)
        yield cells, seen
        cells = np.maximum(cells + by_column * operator.rmatvec(by_row * (rays - seen)), 0)


def _mlem(operator: LinearOperator, rays: np.ndarray, noise: float) -> Steps:
    """MLEM, also called Richardson-Lucy (Shepp and Vardi, IEEE Trans. Med. Imaging 1, 113, 1982).

    ``x <- x / columns * A'((y + b) / (A x + b))`` with `PEDESTAL` as b (for read noise: Snyder and
    others, J. Opt. Soc. Am. A 12, 272, 1995), starting from even light.
    """
    rows, columns = _sums(operator)
    by_column, known = _inverse(columns), rows > 0
    pedestal = np.float32(PEDESTAL * noise)
    raised = np.maximum(rays + pedestal, 0)
    level = max(float(rays.sum(dtype=np.float64) / rows.sum(dtype=np.float64)), float(pedestal))
    cells = np.where(by_column > 0, np.float32(level), np.float32(0))
    while True:
        seen = operator.matvec(cells)
        yield cells, seen
        ratio = np.divide(raised, seen + pedestal, out=np.zeros_like(raised), where=known)
        cells = cells * by_column * operator.rmatvec(ratio)


def _nnls(operator: LinearOperator, rays: np.ndarray, noise: float) -> Steps:
    """Non-negative least squares by accelerated projected gradients.

    FISTA: Beck and Teboulle, SIAM J. Imaging Sci. 2, 183, 2009. The norm of a matrix without
    negative elements is at most the root of its largest row sum times its largest column sum.
    """
    rows, columns = _sums(operator)
    step = np.float32(1 / (float(rows.max()) * float(columns.max())))
    cells = np.zeros(operator.shape[1], np.float32)
    seen = operator.matvec(cells)
    before, onward, speed = (cells, seen), np.float32(0), 1.0
    while True:
        yield cells, seen
        ahead, seen_ahead = (
            now + onward * (now - then) for now, then in zip((cells, seen), before, strict=True)
        )
        before = cells, seen
        cells = np.maximum(ahead + step * operator.rmatvec(rays - seen_ahead), 0)
        seen = operator.matvec(cells)
        faster = (1 + np.sqrt(1 + 4 * speed**2)) / 2
        onward, speed = np.float32((speed - 1) / faster), faster


def _by_lsqr(operator: LinearOperator, rays: np.ndarray, goal: float, most: int) -> Stopped:
    """LSQR (Paige and Saunders, ACM Trans. Math. Softw. 8, 43, 1982), linear, with negative light.

    SciPy sums in float64, the operator in its own type.
    """
    double = ScipyOperator(
        operator.shape,
        matvec=lambda x: operator.matvec(x.astype(operator.dtype)).astype(np.float64),
        rmatvec=lambda y: operator.rmatvec(y.astype(operator.dtype)).astype(np.float64),
        dtype=np.float64,
    )
    wanted = rays.astype(np.float64)
    size = max(float(np.linalg.norm(wanted)), np.sqrt(goal))
    found = lsqr(double, wanted, atol=0, btol=np.sqrt(goal) / size, conlim=0, iter_lim=most)
    reached = found[1] == 1
    return found[0].astype(np.float32), found[2], goal if reached else found[3] ** 2


STEPS = {"sart": _sart, "mlem": _mlem, "nnls": _nnls}
"""Methods of this module, step by step."""

METHODS = (PENALISED, "sart", "mlem", "lsqr", "nnls")
"""Names of all methods."""
