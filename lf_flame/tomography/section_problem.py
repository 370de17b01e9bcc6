"""Least squares on an axisymmetric half section with a penalty on roughness, no negative light."""

from functools import cached_property

import numpy as np
from scipy import linalg, sparse
from scipy.linalg.blas import dsbmv

from lf_flame._common.input_files import check_memory
from lf_flame.tomography.axisymmetric_grid import AxisymmetricGrid
from lf_flame.tomography.frequency_gram import RIDGE, ROUGHNESS_ORDER
from lf_flame.tomography.plane_problem import Solution

STEP = 10.0
"""Step of the splitting (ADMM), for a Gram matrix with its diagonal scaled to 1."""

PROBES = 32
"""Number of random vectors that estimate traces (Hutchinson 1990): 1 % error for 1,000."""


class BandedGram:
    """Gram matrix of a half section, scaled to a diagonal of 1, and the penalty.

    Nodes near the axis contribute little light; with the scaling, all nodes take steps of similar
    size.

    grid : AxisymmetricGrid
    unit : emission of a node for a scaled value of 1, shape (nodes,)
    bands : lower diagonals of the scaled matrix, shape (band, nodes)
    probes : random signs that estimate traces, and their product with the matrix
    """

    def __init__(self, grid: AxisymmetricGrid):
        self.grid = grid
        bands = gram_bands(grid)
        diagonal = np.maximum(bands[0], 1e-9 * bands[0].max())
        self.unit = 1 / np.sqrt(diagonal)
        self.typical = float(np.mean(diagonal))
        self.bands = _scale(bands, self.unit)
        self._factors: dict[tuple[float, float | None], np.ndarray] = {}

    @cached_property
    def probes(self) -> tuple[np.ndarray, np.ndarray]:
        """Random signs that estimate traces, and their products with the matrix."""
        probes = np.random.default_rng(0).choice([-1.0, 1.0], (len(self.unit), PROBES))
        return probes, np.stack([self.multiply(one) for one in probes.T], axis=1)

    def multiply(self, scaled: np.ndarray) -> np.ndarray:
        """Multiply by the scaled matrix."""
        return dsbmv(len(self.bands) - 1, 1.0, self.bands, scaled, lower=1)

    @cached_property
    def modes(self) -> float:
        """Degrees of freedom of a fit without a penalty."""
        return self.count_modes(None)

    def count_modes(self, strength: float | None) -> float:
        """Degrees of freedom of a linear fit: the trace of the map from data to fitted data."""
        probes, seen = self.probes
        return float(np.sum(probes * self.inverted(RIDGE, strength, seen))) / PROBES

    @cached_property
    def _unit_penalty(self) -> np.ndarray:
        """Lower diagonals of the scaled penalty of strength 1, shape (band, nodes)."""
        differences = roughness_differences(self.grid.shape)
        lower = sparse.tril(differences.T @ differences).tocoo()
        bands = np.zeros((int((lower.row - lower.col).max()) + 1, lower.shape[0]))
        bands[lower.row - lower.col, lower.col] = lower.data
        return _scale(self.typical * bands, self.unit)

    def draw_penalty(self, strength: float, rng: np.random.Generator) -> np.ndarray:
        """Draw random nodes with the penalty as covariance, shape of the grid."""
        differences = roughness_differences(self.grid.shape)
        drawn = differences.T @ rng.standard_normal(differences.shape[0])
        return (np.sqrt(strength * self.typical) * drawn).reshape(self.grid.shape)

    def inverted(self, add: float, strength: float | None, values: np.ndarray) -> np.ndarray:
        """Multiply by the inverse of the scaled, penalised matrix plus `add` times the identity.

        Factors are kept: a fit and all of its draws need the same.
        """
        if (add, strength) not in self._factors:
            penalty = self.bands[:0] if strength is None else strength * self._unit_penalty
            total = np.zeros((max(len(self.bands), len(penalty)), self.bands.shape[1]))
            total[: len(self.bands)] += self.bands
            total[: len(penalty)] += penalty
            total[0] += add
            while len(self._factors) > 3:
                self._factors.pop(next(iter(self._factors)))
            factor = linalg.cholesky_banded(total, lower=True, check_finite=False)
            self._factors[add, strength] = factor
        factor = self._factors[add, strength]
        return linalg.cho_solve_banded((factor, True), values, check_finite=False)


class SectionProblem:
    """Fits of a half section to one light field, with the methods of `PlaneProblem`.

    `back` is the backprojected light field A'y, float64, shape (heights, radii).
    """

    def __init__(self, gram: BandedGram, back: np.ndarray, squared: float = 0.0, rays: int = 0):
        self.gram, self.squared, self.rays = gram, squared, rays
        self._linear = back.ravel() * gram.unit

    @cached_property
    def _plain(self) -> np.ndarray:
        return self.gram.inverted(RIDGE, None, self._linear)

    @cached_property
    def explained(self) -> float:
        """Part of the light field's sum of squares that the unpenalised fit explains."""
        return float(self._plain @ (2 * self._linear - self.gram.multiply(self._plain)))

    def unpenalised(self) -> np.ndarray:
        """Emission of the fit without smoothing, the closest that any half section comes."""
        return (self._plain * self.gram.unit).reshape(self.gram.grid.shape)

    def linear(self, strength: float) -> np.ndarray:
        """Emission of the linear fit with a penalty, which may be negative."""
        scaled = self.gram.inverted(RIDGE, strength, self._linear)
        return (scaled * self.gram.unit).reshape(self.gram.grid.shape)

    def solve(
        self,
        strength: float,
        iterations: int,
        start: np.ndarray | None = None,
        foreground: np.ndarray | None = None,
    ) -> Solution:
        """Fit with one strength by ADMM, starting from known emission; all nodes may emit."""
        gram = self.gram
        light = np.zeros_like(gram.unit) if start is None else start.ravel() / gram.unit
        multiplier = np.zeros_like(light)
        for _ in range(iterations):
            pull = self._linear + (light - multiplier) / STEP
            fitted = gram.inverted(1 / STEP, strength, pull)
            light = np.clip(fitted + multiplier, 0, None)
            multiplier += fitted - light
        cells = (light * gram.unit).reshape(gram.grid.shape)
        return Solution(cells, self.misfit(cells), cells)

    def misfit(self, cells: np.ndarray) -> float:
        """Squared residual of nodes, without the part outside the operator's range."""
        apart = cells.ravel() / self.gram.unit - self._plain
        return float(apart @ self.gram.multiply(apart))


def _scale(bands: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """Multiply lower diagonals from both sides by a diagonal matrix, in place."""
    for below, band in enumerate(bands):
        end = len(unit) - below
        band[:end] *= unit[below:] * unit[:end]
    return bands


def roughness_differences(shape: tuple[int, int]) -> sparse.csr_array:
    """Differences that are penalised, (differences, nodes): along height, then along radius.

    The section is mirrored at its axis; beyond the last radius there is no light.
    """
    heights, radii = shape
    along = np.diff(np.eye(heights), ROUGHNESS_ORDER, axis=0)
    mirrored = np.zeros((2 * radii - 1 + ROUGHNESS_ORDER, radii))
    place = np.arange(2 * radii - 1)
    mirrored[place, np.abs(place - (radii - 1))] = 1
    # Each side of the axis has half the weight.
    across = np.diff(mirrored, ROUGHNESS_ORDER, axis=0) / np.sqrt(2)
    down = sparse.kron(sparse.csr_array(along), sparse.eye_array(radii))
    return sparse.vstack([down, sparse.kron(sparse.eye_array(heights), across)], format="csr")


def gram_bands(grid: AxisymmetricGrid) -> np.ndarray:
    """Lower diagonals of the Gram matrix A'A of the nodes' light fields, (band, nodes).

    It is banded, because views mix heights only as far as the parallax within the flame reaches.
    """
    heights, radii = grid.shape
    slabs, (t, s) = len(grid.by_radius), grid.data_shape[2:]
    stacked = sparse.hstack(grid.by_height, format="csr")
    beside = np.concatenate(list(grid.by_radius), axis=1)
    products = []
    for rows, columns in grid.view_groups():
        down, across = stacked[_lines(rows, t)], beside[_lines(columns, s)]
        products.append((down.T @ down, across.T @ across))
    reach = max(_reach(down, heights) for down, _ in products)
    values = (slabs * heights) ** 2 + 6 * (reach + 1) * radii**2 * heights  # with four factors
    check_memory(8 * values, "The half section")
    bands = np.zeros(((reach + 1) * radii, heights * radii))
    for down, across in products:
        down = down.toarray().reshape(slabs, heights, slabs, heights)
        down = down.transpose(1, 3, 0, 2)  # height, height, slab, slab
        across = across.reshape(slabs, radii, slabs, radii).transpose(0, 2, 1, 3)
        across = across.reshape(slabs**2, radii**2)
        for step in range(reach + 1):
            start = np.arange(heights - step)
            blocks = down[start + step, start].reshape(-1, slabs**2) @ across
            _add_blocks(bands, blocks.reshape(-1, radii, radii), step)
    return bands


def _lines(views: np.ndarray, pixels: int) -> np.ndarray:
    """Rows of a matrix (views * pixels, ...) that belong to given views."""
    return (views[:, None] * pixels + np.arange(pixels)).ravel()


def _reach(down: sparse.csr_array, heights: int) -> int:
    """Find the largest distance in rows between two heights that one pixel sees."""
    seen = down.tocoo()
    return int(np.abs(seen.row % heights - seen.col % heights)[seen.data != 0].max())


def _add_blocks(bands: np.ndarray, blocks: np.ndarray, step: int) -> None:
    """Add the blocks `step` below the diagonal, (height, radius, radius), to lower diagonals."""
    radii = blocks.shape[1]
    for row in range(radii):
        for column in range(radii):
            below = step * radii + row - column
            if below >= 0:
                end = column + len(blocks) * radii
                bands[below, column:end:radii] += blocks[:, row, column]
