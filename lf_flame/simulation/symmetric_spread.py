"""How much a pixel changes when the light of its bundle spreads to both sides of where it stood.

What a symmetric spread takes from one side it gives from the other, so that a smooth texture hardly
changes: only its second differences count, and the steps between its cells as far as the bundle
does not average over them. "Bounds of second order" in the documentation derives the formulas.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import correlate1d, maximum_filter1d

from lf_flame.scenes.scene import Layer

SUBCELLS = 4
"""Places of a bundle inside a block of cells that are told apart."""

PATCHES = 2
"""Parts of a pixel's width whose rays are told apart."""

MOST_BLOCKS, MOST_REACH = 100_000, 40
"""Blocks of cells, and blocks to each side of a bundle, beyond which they are taken larger."""

MOST_CELLS = 1_000_000
"""Cells along an axis, lit or dark, that are looked at one by one."""

PARTIAL = 0.0161
"""Twice the largest integral, in cells squared, of a tooth's integral less its mean over a part of
a cell: of u/24 - u^3/6, which is largest at u^2 = 1/12."""

USUAL_BEND = 0.1
"""Second differences of a smooth texture over its steps; only chooses between two bounds."""

SAME_WIDTH = 1.5
"""Ratio of a lenslet's widest to its narrowest image up to which they count as one box."""


@dataclass(frozen=True)
class Box:
    """Widths of the two boxes whose convolution a bundle is, along one axis, in mm.

    Attributes
    ----------
    lenslet, pixel : (float, float)
        Narrowest and widest, 0 or above.
    """

    lenslet: tuple[float, float]
    pixel: tuple[float, float]

    @property
    def half_mm(self) -> float:
        """Half of the bundle's full extent."""
        return (self.lenslet[1] + self.pixel[1]) / 2


@dataclass(frozen=True)
class Pairs:
    """Pairs of rays that replace each ray: one this far to either side.

    Attributes
    ----------
    weights : ndarray, shape (pairs,)
        Shares of the light; they need not sum to 1.
    moves_mm : ndarray, shape (pairs, patches)
        How far the rays of equal parts of the pixel's width move at most, 0 or above.
    widening_mm : ndarray, shape (pairs,)
        How much the pixel's box widens while the rays move.
    """

    weights: np.ndarray
    moves_mm: np.ndarray
    widening_mm: np.ndarray

    @classmethod
    def alike(cls, weights: np.ndarray, moves_mm: np.ndarray) -> "Pairs":
        """Pairs that move all rays of a bundle alike."""
        return cls(weights, moves_mm[:, None], np.zeros_like(moves_mm))

    @property
    def farthest_mm(self) -> np.ndarray:
        """Farthest move of each pair, shape (pairs,)."""
        return self.moves_mm.max(axis=1)


@dataclass(frozen=True)
class Rounding:
    """What the steps between cells add to the change of a texture that rises evenly between them.

    Attributes
    ----------
    any_steps : float
        Share of the largest step near a bundle; or
    even_steps, bends : float
        of the largest step and of the largest second difference, added up.
    """

    any_steps: float
    even_steps: float
    bends: float


@dataclass(frozen=True)
class Shifts:
    """Light that comes from one side: its shares, and from how far.

    Attributes
    ----------
    weights, moves_mm : ndarray, shape (shifts,)
    """

    weights: np.ndarray
    moves_mm: np.ndarray

    @property
    def arise(self) -> bool:
        """Whether any light is shifted at all."""
        return bool(self.weights @ self.moves_mm > 0)


@dataclass(frozen=True)
class Border:
    """What happens to pixels so near the image's border that pairs lose one side.

    Attributes
    ----------
    regions_mm : tuple of (float, float)
        Where the centres of their bundles lie.
    farther, nearer : Shifts
        The sides of each pair; and what is lost beside them.
    """

    regions_mm: tuple[tuple[float, float], ...]
    farther: Shifts
    nearer: Shifts
    lost: Shifts


@dataclass(frozen=True)
class AxisSpread:
    """What happens to a layer's light along one axis.

    Attributes
    ----------
    box : Box
    centres_mm : (float, float)
        First and last centre of the pixels' bundles.
    pairs : Pairs
    rounding : Rounding
    shifts : Shifts, optional
        How far the middle of each pair stands aside.
    border : Border, optional
    """

    box: Box
    centres_mm: tuple[float, float]
    pairs: Pairs
    rounding: Rounding
    shifts: Shifts | None = None
    border: Border | None = None

    @cached_property
    def reach_mm(self) -> float:
        """Farthest that light comes from, on the layer, from a bundle's centre."""
        aside = 0.0 if self.shifts is None else self.shifts.moves_mm.max(initial=0.0)
        farthest = self.pairs.moves_mm.max(initial=0.0) + aside
        if self.border is not None:
            for shifts in (self.border.farther, self.border.nearer, self.border.lost):
                farthest = max(farthest, shifts.moves_mm.max(initial=0.0))
        return self.box.half_mm + float(farthest)


def spread_change(layer: Layer, axes: tuple[AxisSpread, AxisSpread], together: bool) -> float:
    """Bound on the change of any pixel when the light of a layer spreads.

    Parameters
    ----------
    layer : Layer
        Which only adds light.
    axes : (AxisSpread, AxisSpread)
        Along y and x.
    together : bool
        Whether a ray moves along both axes at once, pair by pair; else independently.

    Returns
    -------
    float
        In the unit of the texture; infinite where bundles reach over more than `MOST_CELLS`.
    """
    blocks = _Blocks(layer, axes)
    if max(grid.count for grid in blocks.grids) > MOST_CELLS:
        return math.inf
    # Along y at every column to which the light of a bundle spreads, along x at its own rows.
    (first_y, second_y, aside_y), (first_x, second_x, aside_x) = (
        _axis_change(blocks, axis, axes[axis], beside)
        for axis, beside in ((0, axes[1].reach_mm), (1, axes[0].box.half_mm))
    )
    if together:
        twist = np.minimum(_twist(blocks, axes), first_y)
        change = np.minimum(
            first_y + first_x,
            np.minimum(first_y, second_y) + np.minimum(first_x, second_x) + twist,
        )
    else:
        change = aside_y + aside_x
    inside = tuple(blocks.range(axis, *axes[axis].centres_mm) for axis in (0, 1))
    return float(change[inside].max(initial=0.0))


@dataclass(frozen=True)
class _Grid:
    """Cells along one axis that some bundle can meet: the first, their number, their width."""

    first: int
    count: int
    cell_mm: float
    start_mm: float
    reach: int

    @classmethod
    def over(cls, layer: Layer, axis: int, along: AxisSpread) -> "_Grid":
        """Lay a grid over the cells that are met, and over what is dark beside the layer."""
        edges = layer.cell_edges_mm(axis)
        cell, cells = edges[1] - edges[0], layer.texture.shape[axis]
        reach = math.ceil(along.reach_mm / cell) + 1
        first, last = (
            math.floor(min(max((place - edges[0]) / cell, -reach), cells + reach))
            for place in along.centres_mm
        )
        return cls(first - reach, last - first + 2 * reach + 1, cell, edges[0], reach)


class _Blocks:
    """Differences of a texture between neighbouring cells, in square blocks of cells."""

    def __init__(self, layer: Layer, axes: tuple[AxisSpread, AxisSpread]):
        self.grids = [_Grid.over(layer, axis, axes[axis]) for axis in (0, 1)]
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
            differences = differences[_along(axis, here)]
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


def _along(axis: int, part: slice) -> tuple[slice, slice]:
    return (part, slice(None)) if axis == 0 else (slice(None), part)


def _axis_change(
    blocks: _Blocks, axis: int, along: AxisSpread, beside: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Bounds for bundles centred in each block: of first and second order, and with all shifts.

    beside: how far from the bundle's centre, along the other axis, its light can come from.
    """
    cell, play = blocks.grids[axis].cell_mm, (blocks.size - 1) * blocks.grids[axis].cell_mm
    steps = blocks.widest(blocks.gather(blocks.steps(axis), (axis,)), 1 - axis, beside)
    bends = blocks.widest(blocks.gather(blocks.bends(axis), (axis,)), 1 - axis, beside)

    def pass_over(values, weights, moves, kind, middle):
        return _pass_over(blocks, axis, along.box, values, weights, moves, kind, middle, play)

    def over_pixel(values: np.ndarray, kind, middle: float) -> np.ndarray:
        """Mean over the parts of the pixel's width, each where its rays meet the layer."""
        pairs = along.pairs
        parts = [
            pass_over(values, pairs.weights / 2, moves, kind, middle) for moves in pairs.moves_mm.T
        ]
        reach = along.box.pixel[1] / 2
        return np.mean([blocks.widest(part, axis, reach) for part in parts], axis=0)

    def shifted(shifts: Shifts | None) -> np.ndarray:
        """Change by light from one side: across half of its way to both sides of its middle."""
        if shifts is None or not shifts.arise:
            return np.zeros_like(steps)
        halves = shifts.moves_mm / 2
        found = pass_over(steps, shifts.weights, halves, _crossed, cell / 2)
        return blocks.widest(found, axis, along.box.pixel[1] / 2 + halves.max())

    # Boundaries stand before their cells: half a cell before the middle of a block.
    first = over_pixel(steps, _crossed, cell / 2)
    second = over_pixel(bends / cell, _bent, 0.0) + _rounding(blocks, axis, along, beside)
    whole = np.minimum(first, second) + shifted(along.shifts)
    if along.border is not None:
        border = shifted(along.border.farther) + shifted(along.border.lost)
        border += np.minimum(whole, shifted(along.border.nearer))
        for region in along.border.regions_mm:
            near = _along(axis, blocks.range(axis, *region))
            whole[near] = np.maximum(whole[near], border[near])
    return first, second, whole


def _pass_over(
    blocks: _Blocks, axis: int, box: Box, values: np.ndarray, weights, moves, kind, middle, play
) -> np.ndarray:
    """Weigh the differences around each block by what a bundle there meets, at its worst place.

    middle: where a block's differences stand, on average, before the middle of the block; play:
    width over which they stand.
    """
    found, (lenslet, factor) = np.zeros_like(values), _one_box(box.lenslet)
    if not len(moves):
        return found
    block = blocks.grids[axis].cell_mm * blocks.size
    slack = (block / SUBCELLS + play) / 2
    reach = math.ceil((moves.max() + lenslet / 2 + slack) / block) + 1
    for place in (np.arange(SUBCELLS) + 0.5) / SUBCELLS - 0.5:
        offsets = (np.arange(-reach, reach + 1) - place) * block - middle
        distance = np.maximum(np.abs(offsets) - slack, 0)
        kernel = factor * (weights @ kind(distance, moves[:, None], lenslet))
        np.maximum(found, correlate1d(values, kernel, axis=axis, mode="constant"), out=found)
    return found


def _one_box(widths: tuple[float, float]) -> tuple[float, float]:
    """Width of a box that stands for all between two widths, and the factor that makes it cover.

    A point covers all, since a box is a mean over points.
    """
    narrow, wide = widths
    return (wide, wide / narrow) if 0 < wide <= SAME_WIDTH * narrow else (0.0, 1.0)


def _crossed(distance: np.ndarray, move: np.ndarray, box: float) -> np.ndarray:
    """Share of a box's rays, `distance` away, that have a place within their move."""
    return _cdf(distance + move, box) - _cdf(distance - move, box)


def _bent(distance: np.ndarray, move: np.ndarray, box: float) -> np.ndarray:
    """Mean over a box's rays of how much farther they move than to a place `distance` away."""
    second = _ramp(distance + move, box) + _ramp(distance - move, box) - 2 * _ramp(distance, box)
    return np.maximum(second, 0.0)


def _cdf(x: np.ndarray, box: float) -> np.ndarray:
    """Share of a box that lies before x."""
    return np.clip(x / box + 0.5, 0.0, 1.0) if box > 0 else (x >= 0).astype(float)


def _ramp(x: np.ndarray, box: float) -> np.ndarray:
    """Integral of `_cdf` up to x."""
    inside = np.clip(x / box + 0.5, 0.0, 1.0) if box > 0 else 0.0
    return box / 2 * inside**2 + np.maximum(x - box / 2, 0.0)


def _rounding(blocks: _Blocks, axis: int, along: AxisSpread, beside: float) -> np.ndarray:
    """Find what the steps between cells add around each block."""
    around = along.box.half_mm + blocks.grids[axis].cell_mm / 2
    around += float(along.pairs.moves_mm.max(initial=0.0))
    steps, bends = (
        blocks.widest(blocks.widest(blocks.gather(each), 1 - axis, beside), axis, around)
        for each in (blocks.steps(axis), blocks.bends(axis))
    )
    adds = along.rounding
    return np.minimum(steps * adds.any_steps, steps * adds.even_steps + bends * adds.bends)


def find_rounding(
    pairs: Pairs, cell_mm: float, here: Box, ends: Sequence[tuple[Box, Box]], cut: bool
) -> Rounding:
    """Find what the steps between cells add to the change by pairs of rays.

    Parameters
    ----------
    pairs : Pairs
    cell_mm : float
    here : Box
        Of the bundles between the pairs.
    ends : sequence of (Box, Box)
        Of each pair's two sides, from where the last pair's are to its own; or one for all.
    cut : bool
        Whether a stop may cut the bundles.
    """
    middle = np.array(teeth(here, cell_mm, cut))
    sides = [[teeth(box, cell_mm, cut) for box in both] for both in ends]
    wide, even, uneven = (middle + np.reshape(sides, (-1, 2, 3)).mean(axis=1)).T
    most, farthest = np.full(len(pairs.weights), np.inf), pairs.farthest_mm
    boxes = [here, *(box for both in ends for box in both)]
    lenslet = min(box.lenslet[0] for box in boxes)
    if lenslet > 0:
        most = farthest / lenslet
        # The narrowest pixel on the way to each pair: the ways of nearer pairs are part of it.
        pixel = np.minimum.accumulate([min(b.pixel[0] for b in (here, *both)) for both in ends])
        if not cut:
            reach = farthest + pairs.widening_mm / 2
            with np.errstate(divide="ignore", invalid="ignore"):
                bent = (reach / lenslet) * (reach / pixel)  # no length of any unit overflows
            most = np.where(pixel > 0, np.minimum(most, bent), most)
    return Rounding(
        float(pairs.weights @ np.minimum(wide, most)),
        float(pairs.weights @ np.minimum(even, most)),
        float(np.sum(pairs.weights * uneven)),
    )


def teeth(box: Box, cell: float, cut: bool) -> tuple[float, float, float]:
    """How far a bundle sees cells depart from the line between their middles, at most.

    Returns
    -------
    wide : float
        Share of the largest step.
    even, uneven : float
        Share of the largest step, and of the largest bend that is added to it: steps that are
        all alike cancel over whole cells.
    """
    lenslet, pixel = box.lenslet[0], 0.0 if cut else box.pixel[0]
    widest, narrower = max(lenslet, pixel), min(lenslet, pixel)
    wide = min(0.5, cell / (4 * widest)) if widest > 0 else 0.5
    if cut or lenslet == 0:
        return wide, wide, 0.0
    even, uneven = _triangles(box.lenslet, cell), (1 + cell / lenslet) / 8
    if pixel > 0:
        both = min(
            even * _uncancelled(box.pixel, cell),
            _triangles(box.pixel, cell) * _uncancelled(box.lenslet, cell),
        )
        ends = PARTIAL * (1 + 2 * cell / widest + narrower / widest) * cell / narrower
        apart = (1 + cell / widest / 2) / 24 + ends
        if both + USUAL_BEND * apart < even + USUAL_BEND * uneven:
            even, uneven = both, apart
    return wide, min(even, wide), uneven


def _triangles(widths: tuple[float, float], cell: float) -> float:
    """Half height of the triangles that a box makes of even steps, for any width between two."""
    narrow, wide = widths
    middle, half = (narrow + wide) / 2, (wide - narrow) / 2
    part = middle / cell % 1
    slope = (1 + cell / (4 * narrow)) / (2 * narrow)  # the most by which the width changes it
    return min(0.5, part * (1 - part) / 2 * cell / middle + half * slope)


def _uncancelled(widths: tuple[float, float], cell: float) -> float:
    """Share of a box that does not make whole cells, the smaller way, for any width between two."""
    narrow, wide = widths
    part = (narrow + wide) / 2 / cell % 1
    beside = min(min(part, 1 - part) + (wide - narrow) / 2 / cell, 0.5)
    return min(1.0, beside * cell / narrow)


def _twist(blocks: _Blocks, axes: tuple[AxisSpread, AxisSpread]) -> np.ndarray:
    """Bound on what moving along both axes at once adds to moving along each.

    By Cauchy and Schwarz the mean over pairs of the product of both axes' weights is at most the
    product of the roots of the means of their squares.
    """
    twists = blocks.gather(blocks.twists(), (0, 1))
    for axis in (0, 1):
        pairs, grid = axes[axis].pairs, blocks.grids[axis]

        def root(distance, move, box, weights=pairs.weights):
            return np.sqrt(weights @ _crossed(distance, move, box) ** 2)[None]

        play = (blocks.size - 1) * grid.cell_mm
        twists = _pass_over(
            blocks, axis, axes[axis].box, twists, np.ones(1), pairs.farthest_mm, root,
            grid.cell_mm / 2, play,
        )  # fmt: skip
        twists = blocks.widest(twists, axis, axes[axis].box.pixel[1] / 2)
    return twists / 4
