"""What the steps between a texture's cells add where a bundle does not average over them.

"Bounds of second order" in the documentation derives the formulas.
"""

from collections.abc import Sequence

import numpy as np

from lf_flame.simulation.planning.axis_spread import Box, Pairs, Rounding

PARTIAL = 0.0161
"""Twice the largest integral, in cells squared, of a tooth's integral less its mean over a part of
a cell: of u/24 - u^3/6, which is largest at u^2 = 1/12."""

USUAL_BEND = 0.1
"""Second differences of a smooth texture over its steps; only chooses between two bounds."""


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
