"""Number of slabs for thick layers, and of colours for a band of light, that meet a tolerance.

A part, that is a slab or a colour, represents its range of depths or focal lengths by its middle.
The bounds on the error of this are derived on the page "How many slabs" of the documentation.
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
"""Fraction of the tolerance for the slabs of thick layers, and again for the colours."""

MOST_PARTS = 1024
"""Largest number of slabs or colours; a tolerance that needs more is refused."""

POWERS = tuple(2**k for k in range(1, 12))
"""Numbers of parts that are tried: powers of 2."""

EIGHTHS_MEAN = 5 / 8
"""Mean displacement in `smeared`, relative to that at the end of a part: the mean of the outer ends
of four eighths on each side, (1/4 + 2/4 + 3/4 + 1) / 4."""

TRAVEL_PER_MEAN = 2 / EIGHTHS_MEAN
"""Displacement from one end of a part to the other, relative to the mean in `smeared`."""

BOUNDARIES_BESIDE = 2
"""Largest number of boundaries of cells that an edge can pass beyond displacement over cell width:
one for each end."""


@dataclass(frozen=True)
class Request:
    """Accuracy that a number of parts must reach.

    Attributes
    ----------
    effect : str
        Name of the effect: "thickness" or "chromatic".
    allowance : float
        Largest acceptable error, in the unit of the textures.
    tolerance : float
        Tolerance of the image from which it follows, for messages.
    most : int, optional
        Largest number of parts.
    """

    effect: str
    allowance: float
    tolerance: float
    most: int = MOST_PARTS


def count_slabs(bounds: SceneBounds, scene: Scene, tolerance: float, absorption: bool) -> list[int]:
    """Find the number of planes for each layer with which the error of all stays small enough.

    Parameters
    ----------
    bounds : SceneBounds
    scene : Scene
    tolerance : float
        Tolerance of the image; `SLICING_SHARE` of it is for the planes of all layers together.
    absorption : bool
        Whether layers absorb their own light.

    Returns
    -------
    list of int
        Number of planes for each layer of the scene, in its order; 1 for flat layers.

    Raises
    ------
    InputError
        If more than `MOST_PARTS` planes would be needed (twice as many with absorption).
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
    """Bound the error of the slabs of a layer that absorbs, by number of slabs.

    Half of these slabs lie close to the layer's faces. `even` bounds the error of a number of equal
    slabs if nothing were absorbed; with absorption the error of equal slabs as wide as the widest
    is no larger.
    """
    absorbing = AbsorbingSlabs(bounds, layer)

    def change(slabs: int) -> float:
        widest = float(np.diff(slab_edges(layer, slabs)).max())
        return min(absorbing.change(slabs), even(1 / widest))

    return change


def count_colours(bounds: SceneBounds, tolerance: float) -> int:
    """Find the number of focal lengths that represent the band of light accurately enough.

    Parameters
    ----------
    bounds : SceneBounds
    tolerance : float
        Tolerance of the image; `SLICING_SHARE` of it is for the colours.

    Raises
    ------
    InputError
        If more than `MOST_PARTS` focal lengths would be needed.
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
    """Bound the error of `parts` midpoints in place of an integral over depth or colour.

    It is the smaller of two bounds, derived on the page "How many slabs" of the documentation. The
    first-order bound assumes that all light of a part comes from where it displaces the bundle
    most. For the second-order bound, let a pixel's bundle, a box, move over the layer by ``travel``
    times its own width in total. As a function of position in the spread, the light of the pixel
    has a kink of ``next * travel`` where an edge of the box passes from cell to cell, of which
    midpoints miss 1 / KINK; in between it has a second derivative of ``2 whole travel_y travel_x``,
    of which they miss 1 / CURVATURE.

    Parameters
    ----------
    bounds : SceneBounds
    layer : Layer
    parts : float
        Number of parts.
    smear : callable
        First-order change for an axis and a number of parts.
    """
    first, travels, kinks = 0.0, [], 0.0
    for axis in (0, 1):
        steps, box = bounds.steps[layer, axis], box_mm(bounds, layer, axis)
        first += smear(axis, parts)
        if box == 0 or steps.whole == 0:
            return first if box == 0 else 0.0
        # The change of a very small part is proportional to its displacement.
        smallest = smear(axis, MOST_PARTS) * MOST_PARTS
        travels.append(TRAVEL_PER_MEAN * smallest / change_rate(steps, box) / box)
        crossed = BOX_EDGES * (travels[axis] * box / steps.cell_mm + BOUNDARIES_BESIDE)
        kinks += crossed * steps.next * travels[axis] / KINK
    whole = max(bounds.steps[layer, axis].whole for axis in (0, 1))
    curvature = 2 * whole * travels[0] * travels[1]
    return min(first, (kinks + curvature / CURVATURE) / parts**2)


def _count_parts(bound: Callable[[int], float], probes: Sequence[Probes], request: Request) -> int:
    """Find the smallest number of parts with an error, bounded or measured, that is accepted."""
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
