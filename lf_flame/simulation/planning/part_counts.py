"""How many slabs of thick layers, and how many colours of a band, an image needs.

"How many slabs" in the documentation derives the bounds on what midpoints of parts leave out.
"""

import math
from bisect import bisect_left
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from lf_flame.errors import InputError
from lf_flame.scenes.scene import Layer, Scene
from lf_flame.simulation.planning.absorbing_slabs import (
    BOX_EDGES,
    CURVATURE,
    KINK,
    AbsorbingSlabs,
)
from lf_flame.simulation.planning.probes import Probes, find_probes
from lf_flame.simulation.planning.scene_bounds import SceneBounds, box_mm, change_rate, smeared
from lf_flame.simulation.slabs import slab_edges

SLICING_SHARE = 0.125
"""Share of the tolerance for the slabs of thick layers, and the same for the colours."""

MOST_PARTS = 1024
"""Slabs or colours beyond which a tolerance counts as out of reach."""

POWERS = tuple(2**k for k in range(1, 12))
"""Powers of 2 that are tried as numbers of parts."""

EIGHTHS_MEAN = 5 / 8
"""Mean move to the far ends of a part's eighths, over the move to the part's end: `smeared`'s."""

TRAVEL_PER_MEAN = 2 / EIGHTHS_MEAN
"""Travel from end to end of a part, over the mean move that `smeared` finds."""

BOUNDARIES_BESIDE = 2
"""Boundaries of cells that an edge passes at most, beyond its travel over the width of a cell."""


@dataclass(frozen=True)
class Request:
    """Limits on the parts of a spread of depth or colour.

    Attributes
    ----------
    effect : str
    allowance : float
        Error that is acceptable, in the unit of the textures.
    tolerance : float
        Tolerance of the image from which it follows.
    most : int, optional
        Largest number of parts.
    """

    effect: str
    allowance: float
    tolerance: float
    most: int = MOST_PARTS


def count_slabs(bounds: SceneBounds, scene: Scene, tolerance: float, absorption: bool) -> list[int]:
    """Count planes for each layer, so that those of all together keep within their share.

    absorption: whether layers dim their own light.

    Raises
    ------
    InputError
        If the tolerance would need more parts than are sensible.
    """
    thick = sum(layer.thickness_mm > 0 for layer in scene.layers)
    allowance = SLICING_SHARE * tolerance * bounds.peak / max(thick, 1)

    def bound(layer: Layer, slabs: float) -> float:
        def smear(axis: int, parts: float) -> float:
            return smeared(bounds, layer, axis, depth_mm=layer.thickness_mm / parts)

        return _sliced_change(bounds, layer, slabs, smear)

    def count(layer: Layer) -> int:
        if not layer.thickness_mm > 0:
            return 1
        even = partial(bound, layer)
        request = Request("thickness", allowance, tolerance)
        if absorption and layer.optical_thickness.any():
            crowded = _absorbing_change(bounds, layer, even)
            return _count_parts(crowded, [], replace(request, most=2 * MOST_PARTS))
        return _count_parts(even, find_probes(bounds, [layer], "thickness"), request)

    return [count(layer) for layer in scene.layers]


def _absorbing_change(
    bounds: SceneBounds, layer: Layer, even: Callable[[float], float]
) -> Callable[[int], float]:
    """Bound on the error of the slabs of a layer that absorbs, of which half crowd at its faces.

    even: bound for so many equal slabs, of the light as if nothing dimmed it.
    """
    absorbing = AbsorbingSlabs(bounds, layer)

    def change(slabs: int) -> float:
        widest = float(np.diff(slab_edges(layer, slabs)).max())
        return min(absorbing.change(slabs), even(1 / widest))

    return change


def count_colours(bounds: SceneBounds, tolerance: float) -> int:
    """Count the focal lengths that stand for the band of light within their share of the tolerance.

    Raises
    ------
    InputError
        As `count_slabs`.
    """
    band_mm = bounds.camera.chromatic_shift * bounds.camera.main_lens_focal_mm

    def bound(colours: int) -> float:
        def smear(layer: Layer, axis: int, parts: float) -> float:
            return smeared(bounds, layer, axis, focal_mm=band_mm / parts)

        return sum(
            _sliced_change(bounds, layer, colours, partial(smear, layer)) for layer in bounds.layers
        )

    request = Request("chromatic", SLICING_SHARE * tolerance * bounds.peak, tolerance)
    return _count_parts(bound, find_probes(bounds, bounds.layers, "chromatic"), request)


def _sliced_change(
    bounds: SceneBounds, layer: Layer, parts: float, smear: Callable[[int, float], float]
) -> float:
    """Bound on the error of `parts` midpoints in place of an integral over depth or colour.

    The smaller of two ("How many slabs" in the documentation derives them). Of the first order:
    as if the light of each part stood where it moves the bundle farthest. Of the second: a box
    that moves by ``travel`` of its own widths in all bends its light where an edge passes from
    cell to cell, by ``next * travel`` each, for which midpoints err by 1 / KINK; and in between
    by the product of both axes, ``2 whole travel_y travel_x``, for which they err by
    1 / CURVATURE.

    smear: from an axis and a number of parts to the change of the first order.
    """
    first, travels, kinks = 0.0, [], 0.0
    for axis in (0, 1):
        steps, box = bounds.steps[layer, axis], box_mm(bounds, layer, axis)
        first += smear(axis, parts)
        if box == 0 or steps.whole == 0:
            return first if box == 0 else 0.0
        # From a part so small that its change is in proportion to its travel.
        smallest = smear(axis, MOST_PARTS) * MOST_PARTS
        travels.append(TRAVEL_PER_MEAN * smallest / change_rate(steps, box) / box)
        crossed = BOX_EDGES * (travels[axis] * box / steps.cell_mm + BOUNDARIES_BESIDE)
        kinks += crossed * steps.next * travels[axis] / KINK
    whole = max(bounds.steps[layer, axis].whole for axis in (0, 1))
    curvature = 2 * whole * travels[0] * travels[1]
    return min(first, (kinks + curvature / CURVATURE) / parts**2)


def _count_parts(bound: Callable[[int], float], probes: Sequence[Probes], request: Request) -> int:
    """Fewest parts whose error is within the allowance, by the bound or as measured."""
    counts = [n for n in sorted((*POWERS, *(3 * n // 2 for n in POWERS))) if n <= request.most]
    enough = bisect_left(counts, True, key=lambda n: bound(n) <= request.allowance)
    sure = counts[enough] if enough < len(counts) else math.inf
    for n in POWERS if probes else ():
        if n >= min(sure, 2 * request.most):
            break
        if _error(probes, n) <= request.allowance:
            between = 3 * n // 4
            return between if n > 2 and _error(probes, between) <= request.allowance else n
    if sure == math.inf:
        raise InputError(
            f"tolerance {request.tolerance:g} cannot be met: {request.effect} would need more than "
            f"{request.most} parts; allow more, or force {request.effect} off."
        )
    return int(sure)


def _error(probes: Iterable[Probes], parts: int) -> float:
    return sum(each.error(parts) for each in probes)
