"""Simple methods to compare: each gets the same light field, grid and noise."""

from collections.abc import Callable, Iterator

import numpy as np
from scipy.sparse.linalg import LinearOperator, lsqr

from lf_flame import LightField
from lf_flame.refocus import shift_and_sum
from lf_flame.tomography import FrustumGrid, ProjectionOperator

MOST = 300
"""Largest number of iterations of SART and LSQR."""


Stacks = list[np.ndarray]
"""Emission on the planes; several where a strength must be chosen. That of least true error counts,
which no user could choose."""


def refocused(light_field: LightField, grid: FrustumGrid, noise: float) -> Stacks:
    """Take refocused images for emission, as the paper reads its planes."""
    return [shift_and_sum(light_field, grid.slopes)]


def deconvolved(light_field: LightField, grid: FrustumGrid, noise: float) -> Stacks:
    """Remove from refocused images what other planes blur into them, then negative light.

    Refocused at one plane's slope, another plane is the mean of its copies, one for each view: at
    each frequency a factor, and the factors of all pairs of planes are a small matrix.
    """
    (images,) = refocused(light_field, grid, noise)
    views, apart = grid.camera.views, np.subtract.outer(grid.slopes, grid.slopes)
    steps = np.arange(views) - (views - 1) / 2
    down, right = (
        np.cos(2 * np.pi * frequency[:, None, None, None] * apart[..., None] * steps).mean(axis=-1)
        for frequency in (np.fft.fftfreq(images.shape[1]), np.fft.rfftfreq(images.shape[2]))
    )
    blur, spectra = down[:, None] * right[None], np.moveaxis(np.fft.rfft2(images), 0, -1)
    found = []
    for strength in (0.001, 0.003, 0.01, 0.03, 0.1, 0.3):
        sharp = np.linalg.solve(blur + strength * np.eye(len(images)), spectra[..., None])
        planes = np.fft.irfft2(np.moveaxis(sharp[..., 0], -1, 0), images.shape[1:])
        found.append(np.clip(planes, 0, None))
    return found


def sart(light_field: LightField, grid: FrustumGrid, noise: float) -> Stacks:
    """SART with all views at once (SIRT): ``x <- max(x + A'((y - A x) / rows) / columns, 0)``.

    Andersen and Kak, Ultrason. Imaging 6, 81 (1984). It stops where the residual is the noise.
    """
    operator, rays = ProjectionOperator(grid), light_field.views.ravel()
    rows, columns = (
        np.divide(1, sums, out=np.zeros_like(sums), where=sums > 1e-6 * sums.max())
        for sums in (
            operator @ np.ones(operator.shape[1], np.float32),
            operator.rmatvec(np.ones(operator.shape[0], np.float32)),
        )
    )
    cells = np.zeros(operator.shape[1], np.float32)
    for _ in range(MOST):
        residual = rays - operator @ cells
        if np.mean(np.square(residual, dtype=float)) <= noise**2:
            break
        cells = np.maximum(cells + columns * operator.rmatvec(rows * residual), 0)
    return [grid.crop(cells.reshape(grid.shape))]


def least_squares(light_field: LightField, grid: FrustumGrid, noise: float) -> Stacks:
    """LSQR (SciPy), which knows no bound at zero; it stops where the residual is the noise."""
    operator, rays = ProjectionOperator(grid), light_field.views.ravel().astype(float)
    double = LinearOperator(
        operator.shape,
        matvec=lambda x: (operator @ x.astype(np.float32)).astype(float),
        rmatvec=lambda y: operator.rmatvec(y.astype(np.float32)).astype(float),
        dtype=float,
    )
    stop = noise * np.sqrt(rays.size) / np.linalg.norm(rays)
    cells = lsqr(double, rays, atol=0, btol=stop, conlim=0, iter_lim=MOST)[0]
    return [grid.crop(cells.reshape(grid.shape))]


QUICK: dict[str, Callable[[LightField, FrustumGrid, float], Stacks]] = {
    "refocused": refocused,
    "refocused, deconvolved": deconvolved,
}
PLANES = QUICK | {"SART": sart, "LSQR": least_squares}


def onion_peeling(half: np.ndarray, step: float) -> np.ndarray:
    """Solve for shells of even emission, from the outermost inwards; half images, axis first."""
    edges = (np.arange(half.shape[1]) + 0.5) * step
    places = np.arange(half.shape[1]) * step
    chord = 2 * np.sqrt(np.clip(edges**2 - places[:, None] ** 2, 0, None))
    shells = np.diff(chord, axis=1, prepend=0)
    return np.linalg.solve(shells, half.T).T


def round_methods() -> Iterator[tuple[str, Callable[[np.ndarray, float], list[np.ndarray]]]]:
    """Name inversions of half images by row, which give one section or several to choose from."""
    yield "onion peeling", lambda half, step: [onion_peeling(half, step)]
    try:
        from abel import dasch, daun
    except ImportError:
        return
    options = {"basis_dir": None, "verbose": False}
    yield (
        "PyAbel, three points",
        lambda half, step: [dasch.three_point_transform(half, dr=step, **options)],
    )
    yield (
        "PyAbel, Daun, best penalty",
        lambda half, step: [
            daun.daun_transform(half, reg=("diff", strength), degree=1, dr=step, **options)
            for strength in (0.1, 0.3, 1, 3, 10, 30, 100)
        ],
    )
