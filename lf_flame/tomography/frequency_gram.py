"""The operator's Gram matrix, A'A, frequency by frequency.

On a frustum grid every view is a sum of shifted and blurred planes, so that A'A does not mix
lateral frequencies: it is one small matrix for each, planes by planes. What Gaussian noise leaves
to know of the light field is the filtered focal stack A'y; an iteration on it costs a few Fourier
transforms, whatever the number of views.
"""

from dataclasses import replace
from functools import cached_property

import numpy as np
from numba import get_num_threads
from scipy import fft

from lf_flame._common.memory import check_memory
from lf_flame.tomography.frustum_grid import FEW_PLANES, FrustumGrid
from lf_flame.tomography.projection_operator import plane_bands
from lf_flame.tomography.resolution import depth_blur, finest_period

ROUGHNESS_ORDER = 3
"""The penalty is on third differences: quadratic in the third derivatives of the emission. It
leaves flames of millimetres nearly untouched, where one on first or second ones shifts light from
plane to plane long before it is of use against noise."""


DEPTH_WEIGHT, DEPTH_LENGTH = 1e-4, 0.5
"""Weight of a penalty on third differences along depth, relative to the square of the number of
views, of planes that are as far apart as this share of the finest depth blur. The light field
hardly tells the light of many planes apart, and without a penalty one has too much and the next too
little."""

COPIES = 15
"""Arrays of the matrices' size that a reconstruction holds at once: fewer planes, or larger blocks,
take less."""


RIDGE = 1e-6
"""Of `FrequencyGram.scale`: what is added where the unpenalised fit must be unique."""


class FrequencyGram:
    """A'A of a grid on a torus that is wide enough for nothing to meet its own image.

    Parameters
    ----------
    grid : FrustumGrid

    Attributes
    ----------
    grid : FrustumGrid
    size : (int, int)
        Rows and columns of the torus.
    matrices : ndarray of float64, shape (fy, fx, planes, planes)
        Symmetric, for the frequencies of `scipy.fft.rfft2`. Real, because each view has a
        counterpart on the other side of the central one.

    Raises
    ------
    InputError
        If the matrices would take more memory than is allowed.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import numpy as np
    >>> from lf_flame import PAPER_CAMERA, render
    >>> from lf_flame.tomography import FrustumGrid
    >>> camera = replace(PAPER_CAMERA, views=5, lenslets=(32, 40))
    >>> grid = FrustumGrid(camera, [6.0, -6.0])

    >>> from lf_flame.tomography import FrequencyGram
    >>> FrequencyGram(grid).scale > 0
    True
    """

    def __init__(self, grid: FrustumGrid):
        self.grid = grid
        rows, columns = (
            fft.next_fast_len(count + 2 * grid.reach, real=True) for count in grid.shape[1:]
        )
        self.size = (rows, columns)
        one = rows * (columns // 2 + 1) * grid.shape[0] ** 2 * 8
        check_memory(COPIES * one, f"{grid.shape[0]} planes of {rows} x {columns} cells")
        down = _axis_gram(grid, 0, rows)
        across = _axis_gram(grid, 1, columns)[: columns // 2 + 1]
        self.matrices = down[:, None] * across[None]

    @cached_property
    def squared_frequency(self) -> np.ndarray:
        """What the negative second difference of a cell's neighbours makes of each frequency."""
        rows, columns = self.size
        down = 4 * np.sin(np.pi * fft.fftfreq(rows)) ** 2
        across = 4 * np.sin(np.pi * fft.rfftfreq(columns)) ** 2
        return down[:, None] + across[None]

    @cached_property
    def multiplicity(self) -> np.ndarray:
        """How often each frequency of `rfft2` stands for one of the full transform."""
        rows, columns = self.size
        times = np.full((rows, columns // 2 + 1), 2.0)
        times[:, 0] = 1
        if columns % 2 == 0:
            times[:, -1] = 1
        return times

    @property
    def scale(self) -> float:
        """Entry of a plane's diagonal at frequency 0: the number of views, squared by axis."""
        return float(self.grid.camera.views**2)

    @cached_property
    def decomposition(self) -> tuple[np.ndarray, np.ndarray]:
        """Decompose the matrices with the penalty along depth that always belongs to them.

        Returns
        -------
        values : ndarray, shape (fy, fx, planes)
            Eigenvalues, 0 or above, rising.
        vectors : ndarray, shape (fy, fx, planes, planes)
            Eigenvectors, in columns.
        """
        along = self.scale * depth_roughness(self.grid)
        values, vectors = np.linalg.eigh(self.matrices + along)
        return np.clip(values, 0, None), vectors

    @cached_property
    def gains(self) -> np.ndarray:
        """Square of what the light field sees of each eigenvector, shape (fy, fx, planes)."""
        _, vectors = self.decomposition
        return np.sum(vectors * np.matmul(self.matrices, vectors), axis=-2)

    @cached_property
    def plain_inverse(self) -> np.ndarray:
        """Inverse of the matrices, with a ridge where they are singular; their shape."""
        return np.linalg.inv(self.matrices + RIDGE * self.scale * np.eye(self.matrices.shape[-1]))

    def compose(self, values: np.ndarray) -> np.ndarray:
        """Make the matrices that have other eigenvalues, shape (fy, fx, planes)."""
        _, vectors = self.decomposition
        return np.matmul(vectors * values[..., None, :], np.swapaxes(vectors, -1, -2))

    def penalty(self, strength: float, order: int = ROUGHNESS_ORDER) -> np.ndarray:
        """Give what a penalty on roughness adds to every eigenvalue of a frequency.

        Parameters
        ----------
        strength : float
            Relative to `scale`, 0 or above.
        order : int, optional
            Of the differences whose squares are penalised.

        Returns
        -------
        ndarray of float64, shape (fy, fx, 1)
        """
        return (strength * self.scale * self.squared_frequency**order)[..., None]

    def draw_penalty(self, strength: float, order: int, rng: np.random.Generator) -> np.ndarray:
        """Draw cells whose covariance is the penalty, that along depth with it.

        Returns
        -------
        ndarray of float32, shape (planes, rows, columns)
            On the grid.
        """
        white = rng.standard_normal((2, self.grid.shape[0], *self.size), np.float32)
        across, along = (self.transform(one) for one in white)
        values, vectors = np.linalg.eigh(self.scale * depth_roughness(self.grid))
        root = vectors * np.sqrt(np.clip(values, 0, None))
        spectrum = np.sqrt(self.penalty(strength, order)) * across + along @ root.T
        return self.gather(
            fft.irfft2(np.moveaxis(spectrum, -1, 0), s=self.size, workers=get_num_threads())
        ).astype(np.float32)

    def spread(self, cells: np.ndarray) -> np.ndarray:
        """Lay cells of the grid on the torus, the rest 0."""
        out = np.zeros((len(cells), *self.size), cells.dtype)
        out[:, : cells.shape[1], : cells.shape[2]] = cells
        return out

    def gather(self, torus: np.ndarray) -> np.ndarray:
        """Cut the cells of the grid out of the torus; the inverse of `spread`."""
        _, rows, columns = self.grid.shape
        return torus[..., :rows, :columns]

    def transform(self, torus: np.ndarray) -> np.ndarray:
        """Fourier coefficients of planes, shape (fy, fx, planes)."""
        return np.moveaxis(fft.rfft2(torus, workers=get_num_threads()), 0, -1)

    def inner(self, a: np.ndarray, b: np.ndarray) -> float:
        """Inner product of two arrays of cells by their coefficients (Parseval)."""
        products = np.sum(a.real * b.real + a.imag * b.imag, axis=-1)
        return float(np.sum(self.multiplicity * products)) / np.prod(self.size)


def multiply(matrices: np.ndarray, spectrum: np.ndarray) -> np.ndarray:
    """Multiply real matrices with complex vectors, which NumPy would do by complex matrices.

    Parameters
    ----------
    matrices : ndarray of float, shape (..., planes, planes)
    spectrum : ndarray of complex, shape (..., planes)
        Of the same precision.

    Returns
    -------
    ndarray of complex, shape (..., planes)
    """
    pairs = np.ascontiguousarray(spectrum).view(matrices.dtype)
    product = np.matmul(matrices, pairs.reshape(*spectrum.shape, 2))
    return product.reshape(*spectrum.shape[:-1], -1).view(spectrum.dtype)


def depth_roughness(grid: FrustumGrid) -> np.ndarray:
    """Penalty along depth, of many evenly spaced planes; else zeros.

    It is the integral of the squared third derivative of the emission per mm, so that it does not
    depend on how finely planes sample a volume: with planes of light x at a distance d, that is
    ``sum (D3 x)^2 / d^7``.

    Returns
    -------
    ndarray of float64, shape (planes, planes)
        Relative to `FrequencyGram.scale`.
    """
    count, steps = len(grid.depths_mm), np.diff(grid.depths_mm)
    if count <= FEW_PLANES or np.ptp(steps) > 1e-6 * abs(steps[0]):
        return np.zeros((count, count))
    length = DEPTH_LENGTH * depth_blur(grid.camera, finest_period(grid.camera, grid.block))
    differences = np.diff(np.eye(count), 3, axis=0)
    return DEPTH_WEIGHT * (length / abs(steps[0])) ** 7 * (differences.T @ differences)


def _axis_gram(grid: FrustumGrid, axis: int, length: int) -> np.ndarray:
    """Sum over the views along an axis of the products of transfer functions of two planes.

    Returns
    -------
    ndarray of float64, shape (frequencies, planes, planes)
    """
    lenslets = list(grid.camera.lenslets)
    lenslets[axis] = length * grid.block
    wide = replace(grid, camera=replace(grid.camera, lenslets=(lenslets[0], lenslets[1])))
    middle = length // 2
    transfer = []
    for plane in range(len(grid.depths_mm)):
        bands = plane_bands(wide, plane, axis)
        seen = bands[:, [middle + wide.reach]].toarray().reshape(grid.camera.views, length)
        transfer.append(fft.fft(np.roll(seen, -middle, axis=1), axis=1))
    functions = np.stack(transfer, axis=-1)
    return np.einsum("vfp,vfq->fpq", functions.conj(), functions).real
