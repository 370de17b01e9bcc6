"""Gram matrix A'A of the operator, frequency by frequency.

On a frustum grid every view is a sum of shifted and blurred depth planes. Lateral frequencies
therefore do not mix: A'A is one small matrix (planes by planes) for each frequency. With Gaussian
noise, the filtered focal stack A'y contains all information in the light field on the emission; an
iteration on it costs a few Fourier transforms, whatever the number of views.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import TypeVar

import numpy as np
from numba import get_num_threads
from scipy import fft

from lf_flame._common.input_files import check_memory
from lf_flame.tomography.frustum_grid import FEW_PLANES, FrustumGrid
from lf_flame.tomography.projection_operator import plane_taps
from lf_flame.tomography.resolution import depth_blur, finest_period

Result = TypeVar("Result")

COPIES = 12
"""Number of arrays of the matrices' size that a reconstruction holds at once; fewer planes, or
larger blocks, take less."""

KEPT = 4
"""Number of inverse matrices that are kept; a strength has two, one for each step."""

RIDGE = 1e-6
"""Ridge added where the unpenalised fit must be unique, relative to `FrequencyGram.scale`."""

ROUGHNESS_ORDER = 3
"""Order of the differences that are penalised: third, quadratic in the third derivatives of the
emission. It changes flames of millimetres little; first or second differences shift light from
plane to plane at strengths too low to help against noise."""

DEPTH_WEIGHT, DEPTH_LENGTH = 1e-4, 0.5
"""Weight of a penalty on third differences along depth, relative to the square of the number of
views, for planes at a distance of this fraction of the finest depth blur. The light field barely
distinguishes the light of many planes; without this penalty one plane has too much and the next too
little."""


class FrequencyGram:
    """Matrix A'A of a grid on a torus wide enough that no cell meets its own image.

    `matrices`, float64, shape (fy, fx, planes, planes), are those of the frequencies of
    `scipy.fft.rfft2`. They are real, because each view has a counterpart on the other side of the
    central view. `size` is the number of rows and columns of the torus.
    """

    def __init__(self, grid: FrustumGrid):
        self.grid = grid
        rows, columns = (
            fft.next_fast_len(count + 2 * grid.reach, real=True) for count in grid.shape[1:]
        )
        self.size = (rows, columns)
        self._inverses: dict[tuple[float, float], np.ndarray] = {}
        one = rows * (columns // 2 + 1) * grid.shape[0] ** 2 * 8
        check_memory(COPIES * one, f"{grid.shape[0]} planes of {rows} x {columns} cells")
        down, across = _transfer(grid, 0, rows), _transfer(grid, 1, columns)
        across = across[:, : columns // 2 + 1]
        if grid.used_views is None:  # the sums over all views are real
            self.matrices = _products(down).real[:, None] * _products(across).real[None]
            return
        self.matrices = np.zeros((rows, columns // 2 + 1, grid.shape[0], grid.shape[0]))
        for v, u in grid.view_groups():
            one, other = _products(down[v]), _products(across[u])
            self.matrices += (one[:, None] * other[None]).real

    @cached_property
    def squared_frequency(self) -> np.ndarray:
        """Factor by which the negative second difference multiplies each frequency."""
        rows, columns = self.size
        down = 4 * np.sin(np.pi * fft.fftfreq(rows)) ** 2
        across = 4 * np.sin(np.pi * fft.rfftfreq(columns)) ** 2
        return down[:, None] + across[None]

    @cached_property
    def multiplicity(self) -> np.ndarray:
        """Number of frequencies of the full transform for each frequency of `rfft2`."""
        rows, columns = self.size
        times = np.full((rows, columns // 2 + 1), 2.0)
        times[:, 0] = 1
        if columns % 2 == 0:
            times[:, -1] = 1
        return times

    @property
    def scale(self) -> float:
        """Diagonal element at frequency 0: the number of views."""
        return float(self.grid.view_count)

    @cached_property
    def decomposition(self) -> tuple[np.ndarray, np.ndarray]:
        """Eigenvalues (fy, fx, planes) and eigenvectors of the matrices plus the depth penalty."""
        along = self.scale * depth_roughness(self.grid)
        found = _in_threads(lambda some: np.linalg.eigh(some + along), self.matrices[: self._half])
        values, vectors = (np.concatenate(parts)[self._fold] for parts in zip(*found, strict=True))
        return np.clip(values, 0, None), vectors

    @property
    def _half(self) -> int:
        """Number of rows of frequencies with matrices of their own, of which others are mirrored.

        Positive and negative frequencies have the same matrices if the views are symmetric.
        """
        used, rows = self.grid.used_views, self.size[0]
        return rows // 2 + 1 if used is None or (used == used[::-1]).all() else rows

    @property
    def _fold(self) -> np.ndarray:
        """Row with the same matrices, among those of their own, for each row of frequencies."""
        every = np.arange(self.size[0])
        return every if self._half == len(every) else np.minimum(every, len(every) - every)

    @cached_property
    def gains(self) -> np.ndarray:
        """Quadratic form of A'A for each eigenvector, shape (fy, fx, planes)."""
        _, vectors = self.decomposition
        return np.sum(vectors * np.matmul(self.matrices, vectors), axis=-2)

    @cached_property
    def plain_inverse(self) -> np.ndarray:
        """Inverse of the matrices, with a ridge where they are singular; same shape."""
        ridge = RIDGE * self.scale * np.eye(self.matrices.shape[-1])
        found = _in_threads(lambda some: np.linalg.inv(some + ridge), self.matrices[: self._half])
        return np.concatenate(found)[self._fold]

    def compose(self, values: np.ndarray) -> np.ndarray:
        """Matrices with the same eigenvectors and other eigenvalues, shape (fy, fx, planes)."""
        _, vectors = self.decomposition
        return np.matmul(vectors * values[..., None, :], np.swapaxes(vectors, -1, -2))

    @cached_property
    def modes(self) -> float:
        """Degrees of freedom of a fit without a penalty."""
        return self._count(np.einsum("yxpq,yxqp->yx", self.plain_inverse, self.matrices))

    def count_modes(self, strength: float) -> float:
        """Degrees of freedom of a linear fit: the trace of the map from data to fitted data."""
        values, _ = self.decomposition
        kept = self.gains / (values + self.penalty(strength) + RIDGE * self.scale)
        return self._count(kept.sum(axis=-1))

    def _count(self, traces: np.ndarray) -> float:
        """Add traces over the frequencies; only for the recorded part of the torus."""
        share = np.prod(self.grid.pixels) / np.prod(self.size)
        return float(np.sum(self.multiplicity * traces) * share)

    def inverse(self, step: float, strength: float) -> np.ndarray:
        """Inverse of the identity plus a step times the penalised matrices; kept for later.

        float32, shape (fy, planes, planes, fx).
        """
        asked = step, strength
        if asked not in self._inverses:
            while len(self._inverses) >= KEPT:
                self._inverses.pop(next(iter(self._inverses)))
            penalised = 1 + step * (self.decomposition[0] + self.penalty(strength))
            rows = np.arange(self._half)
            # In float64: the matrices alone are singular where depths cannot be distinguished.
            found = _in_threads(lambda some: self._inverted(penalised, some), rows)
            self._inverses[asked] = np.concatenate(found)[self._fold]
        return self._inverses[asked]

    def _inverted(self, values: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Matrices with the inverse eigenvalues, float32, shape (rows, planes, planes, fx)."""
        vectors = self.decomposition[1][rows]
        inverse = np.matmul(vectors / values[rows][..., None, :], np.swapaxes(vectors, -1, -2))
        return np.ascontiguousarray(np.moveaxis(inverse, 1, -1), np.float32)

    def penalty(self, strength: float) -> np.ndarray:
        """Value that a penalty on roughness adds to every eigenvalue, shape (fy, fx, 1).

        Its strength is relative to `scale`.
        """
        return (strength * self.scale * self.squared_frequency**ROUGHNESS_ORDER)[..., None]

    def draw_penalty(self, strength: float, rng: np.random.Generator) -> np.ndarray:
        """Draw random cells, float32, with the penalty and that along depth as covariance."""
        white = rng.standard_normal((2, self.grid.shape[0], *self.size), np.float32)
        across, along = (self.transform(one) for one in white)
        values, vectors = np.linalg.eigh(self.scale * depth_roughness(self.grid))
        root = vectors * np.sqrt(np.clip(values, 0, None))
        spectrum = np.sqrt(self.penalty(strength)) * across + along @ root.T
        return self.gather(self.inverse_transform(spectrum)).astype(np.float32)

    def spread(self, cells: np.ndarray) -> np.ndarray:
        """Place cells of the grid on the torus, with 0 elsewhere."""
        out = np.zeros((len(cells), *self.size), cells.dtype)
        out[:, : cells.shape[1], : cells.shape[2]] = cells
        return out

    def gather(self, torus: np.ndarray) -> np.ndarray:
        """Cut the cells of the grid out of the torus; the inverse of `spread`."""
        _, rows, columns = self.grid.shape
        return torus[..., :rows, :columns]

    def transform(self, torus: np.ndarray) -> np.ndarray:
        """Fourier coefficients of depth planes, shape (fy, fx, planes)."""
        return np.moveaxis(fft.rfft2(torus, workers=get_num_threads()), 0, -1)

    def inverse_transform(self, spectrum: np.ndarray) -> np.ndarray:
        """Depth planes of Fourier coefficients; the inverse of `transform`."""
        return fft.irfft2(np.moveaxis(spectrum, -1, 0), s=self.size, workers=get_num_threads())

    def inner(self, a: np.ndarray, b: np.ndarray) -> float:
        """Inner product of two arrays of cells from their coefficients (Parseval)."""
        products = np.sum(a.real * b.real + a.imag * b.imag, axis=-1)
        return float(np.sum(self.multiplicity * products)) / np.prod(self.size)


def _in_threads(call: Callable[[np.ndarray], Result], array: np.ndarray) -> list[Result]:
    """Call a function on runs of an array's rows, in separate threads."""
    parts = np.array_split(array, get_num_threads())
    with ThreadPoolExecutor(len(parts)) as pool:
        return list(pool.map(call, parts))


def multiply(matrices: np.ndarray, spectrum: np.ndarray) -> np.ndarray:
    """Multiply real matrices (..., planes, planes) by complex vectors of the same precision."""
    # NumPy would convert the matrices to complex numbers.
    pairs = np.ascontiguousarray(spectrum).view(matrices.dtype)
    product = np.matmul(matrices, pairs.reshape(*spectrum.shape, 2))
    return product.reshape(*spectrum.shape[:-1], -1).view(spectrum.dtype)


def _products(functions: np.ndarray) -> np.ndarray:
    """Sum the products of planes' transfer functions over views, (frequencies, planes, planes)."""
    return np.einsum("vfp,vfq->fpq", functions.conj(), functions)


def _transfer(grid: FrustumGrid, axis: int, length: int) -> np.ndarray:
    """Transfer functions of the depth planes along an axis, (views, frequencies, planes)."""
    taps = plane_taps(grid, axis)
    seen = np.zeros((*taps.shape[:2], length))
    seen[..., (grid.reach - np.arange(taps.shape[2])) % length] = taps
    return np.moveaxis(fft.fft(seen), 0, -1)


def depth_roughness(grid: FrustumGrid) -> np.ndarray:
    """Penalty along depth for many evenly spaced planes, (planes, planes); zeros otherwise.

    It is the integral of the squared third derivative of the emission per mm, so that it does not
    depend on the spacing of planes in a volume: for planes with light x at a distance d, it is
    ``sum (D3 x)^2 / d^7``, relative to `FrequencyGram.scale`.
    """
    count, steps = len(grid.depths_mm), np.diff(grid.depths_mm)
    if count <= FEW_PLANES or np.ptp(steps) > 1e-6 * abs(steps[0]):
        return np.zeros((count, count))
    length = DEPTH_LENGTH * depth_blur(grid.seen_from, finest_period(grid.camera, grid.block))
    differences = np.diff(np.eye(count), 3, axis=0)
    return DEPTH_WEIGHT * (length / abs(steps[0])) ** 7 * (differences.T @ differences)
