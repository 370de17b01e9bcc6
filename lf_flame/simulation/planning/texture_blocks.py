"""Differences between neighbouring cells of a texture, in square blocks of cells."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d

from lf_flame.scenes.scene import Layer
from lf_flame.simulation.planning.axis_spread import AxisSpread

MOST_BLOCKS, MOST_REACH = 100_000, 40
"""Blocks of cells, and blocks to each side of a bundle, beyond which they are taken larger."""


@dataclass(frozen=True)
class CellGrid:
    """Cells along one axis that some bundle can meet: the first, their number, their width."""

    first: int
    count: int
    cell_mm: float
    start_mm: float
    reach: int

    @classmethod
    def over(cls, layer: Layer, axis: int, along: AxisSpread) -> "CellGrid":
        """Lay a grid over the cells that are met, and over what is dark beside the layer."""
        edges = layer.cell_edges_mm(axis)
        cell, cells = edges[1] - edges[0], layer.texture.shape[axis]
        reach = math.ceil(along.reach_mm / cell) + 1
        first, last = (
            math.floor(min(max((place - edges[0]) / cell, -reach), cells + reach))
            for place in along.centres_mm
        )
        return cls(first - reach, last - first + 2 * reach + 1, cell, edges[0], reach)


class TextureBlocks:
    """Differences of a texture between neighbouring cells, in square blocks of cells."""

    def __init__(self, layer: Layer, axes: tuple[AxisSpread, AxisSpread]):
        self.grids = [CellGrid.over(layer, axis, axes[axis]) for axis in (0, 1)]
        size = math.sqrt(self.grids[0].count * self.grids[1].count / MOST_BLOCKS)
        self.size = math.ceil(max(1.0, size, *(grid.reach / MOST_REACH for grid in self.grids)))
        self._cells = np.pad(layer.texture, 2)

    def steps(self, axis: int) -> np.ndarray:
        """Absolute steps at the boundaries before the cells, with no light outside."""
        return np.abs(np.diff(self._cells, axis=axis, prepend=0.0))

    def bends(self, axis: int) -> np.ndarray:
        """Absolute second differences at the cells."""
        border = [(0, 0), (0, 0)]
        border[axis] = (1, 1)
        return np.pad(np.abs(np.diff(self._cells, 2, axis=axis)), border)

    def twists(self) -> np.ndarray:
        """Absolute mixed differences at the corners before the cells."""
        steps = np.diff(self._cells, axis=0, prepend=0.0)
        return np.abs(np.diff(steps, axis=1, prepend=0.0))

    def gather(self, differences: np.ndarray, summed: tuple[int, ...] = ()) -> np.ndarray:
        """Cut out what can be met, and take the largest of each block; along some axes, the sum."""
        for axis, grid in enumerate(self.grids):
            first = grid.first + 2  # of the padded cells
            here = slice(max(first, 0), max(first + grid.count, 0))
            differences = differences[along_axis(axis, here)]
            before = min(max(-first, 0), grid.count)
            border = [(0, 0), (0, 0)]
            border[axis] = (before, grid.count - before - differences.shape[axis])
            if self.size > 1:
                border[axis] = (before, border[axis][1] + -grid.count % self.size)
            if any(border[axis]):
                differences = np.pad(differences, border)
            if self.size > 1:
                shape = list(differences.shape)
                shape[axis : axis + 1] = [shape[axis] // self.size, self.size]
                reduce = np.add if axis in summed else np.maximum
                differences = reduce.reduce(differences.reshape(shape), axis=axis + 1)
        return differences

    def widest(self, values: np.ndarray, axis: int, reach_mm: float) -> np.ndarray:
        """Largest value within a distance along an axis, wherever in its block a bundle stands."""
        if reach_mm == 0:
            return values
        reach = math.ceil(reach_mm / (self.grids[axis].cell_mm * self.size))
        return maximum_filter1d(values, 2 * reach + 1, axis=axis, mode="constant")

    def range(self, axis: int, low_mm: float, high_mm: float) -> slice:
        """Blocks that hold the places between two."""
        grid, last = self.grids[axis], -(-self.grids[axis].count // self.size) - 1
        low, high = (
            math.floor(((place - grid.start_mm) / grid.cell_mm - grid.first) / self.size)
            for place in (low_mm, high_mm)
        )
        return slice(min(max(low, 0), last), min(max(high, 0), last) + 1)


def along_axis(axis: int, part: slice) -> tuple[slice, slice]:
    """Index a part along one axis, and all along the other."""
    return (part, slice(None)) if axis == 0 else (slice(None), part)
