"""Tikhonov's fit by LSMR: linear, on any operator, with negative light where noise wants it."""

import numpy as np
from pylops import LinearOperator
from scipy.sparse.linalg import LinearOperator as ScipyOperator
from scipy.sparse.linalg import lsmr

from lf_flame.errors import InputError

TOLERANCE = 1e-7
"""Of the residual and of the normal equations, relative: float32's own."""


def fit_tikhonov(
    operator: LinearOperator, views: np.ndarray, strength: float, iterations: int = 1000
) -> np.ndarray:
    """Find the cells of least ``|A x - y|^2 + strength * views^2 * |x|^2``.

    By LSMR (Fong and Saunders, SIAM J. Sci. Comput. 33, 2950, 2011), which needs nothing but the
    operator and its adjoint: the baseline for fits that go by frequency, and the way where an
    operator mixes frequencies, as `AbsorbingOperator` does.

    Parameters
    ----------
    operator : pylops.LinearOperator
        From cells (planes, rows, columns) to views (v, u, t, s): `ProjectionOperator` or
        `AbsorbingOperator`.
    views : ndarray, shape (v, u, t, s)
    strength : float
        0 or above, in the unit of `reconstruct`'s.
    iterations : int, optional
        At most.

    Returns
    -------
    ndarray of float32, shape (planes, rows, columns)
        On the grid, beyond what the central view sees, too.

    Raises
    ------
    InputError
        If a value cannot be used.
    """
    if views.shape != tuple(operator.dimsd):
        raise InputError(
            f"The views must be of the operator's shape {tuple(operator.dimsd)}, got {views.shape}."
        )
    if not (np.isfinite(strength) and strength >= 0) or iterations < 1:
        raise InputError(
            f"strength must be a finite number, 0 or above, and iterations 1 or more, got "
            f"{strength} and {iterations}."
        )
    damp = np.sqrt(strength) * views.shape[0]
    double = ScipyOperator(
        operator.shape,
        matvec=lambda x: operator.matvec(x).astype(np.float64),
        rmatvec=lambda y: operator.rmatvec(y).astype(np.float64),
        dtype=np.float64,  # in which LSMR sums
    )
    wanted = views.ravel().astype(np.float64)
    cells = lsmr(double, wanted, damp, TOLERANCE, TOLERANCE, maxiter=iterations)[0]
    return cells.reshape(operator.dims).astype(np.float32)
