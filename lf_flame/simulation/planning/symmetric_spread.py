"""How much a pixel changes when the light of its bundle spreads to both sides of where it stood.

What a symmetric spread takes from one side it gives from the other, so that a smooth texture hardly
changes: only its second differences count, and the steps between its cells as far as the bundle
does not average over them. "Bounds of second order" in the documentation derives the formulas.
"""

import math

import numpy as np
from scipy.ndimage import correlate1d

from lf_flame.scenes.scene import Layer
from lf_flame.simulation.planning.axis_spread import AxisSpread, Box, Shifts
from lf_flame.simulation.planning.texture_blocks import TextureBlocks, along_axis

SUBCELLS = 4
"""Places of a bundle inside a block of cells that are told apart."""


MOST_CELLS = 1_000_000
"""Cells along an axis, lit or dark, that are looked at one by one."""


SAME_WIDTH = 1.5
"""Ratio of a lenslet's widest to its narrowest image up to which they count as one box."""


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
    blocks = TextureBlocks(layer, axes)
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


def _axis_change(
    blocks: TextureBlocks, axis: int, along: AxisSpread, beside: float
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
            near = along_axis(axis, blocks.range(axis, *region))
            whole[near] = np.maximum(whole[near], border[near])
    return first, second, whole


def _pass_over(
    blocks: TextureBlocks,
    axis: int,
    box: Box,
    values: np.ndarray,
    weights,
    moves,
    kind,
    middle,
    play,
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


def _rounding(blocks: TextureBlocks, axis: int, along: AxisSpread, beside: float) -> np.ndarray:
    """Find what the steps between cells add around each block."""
    around = along.box.half_mm + blocks.grids[axis].cell_mm / 2
    around += float(along.pairs.moves_mm.max(initial=0.0))
    steps, bends = (
        blocks.widest(blocks.widest(blocks.gather(each), 1 - axis, beside), axis, around)
        for each in (blocks.steps(axis), blocks.bends(axis))
    )
    adds = along.rounding
    return np.minimum(steps * adds.any_steps, steps * adds.even_steps + bends * adds.bends)


def _twist(blocks: TextureBlocks, axes: tuple[AxisSpread, AxisSpread]) -> np.ndarray:
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
