"""Bounds for what spreads light to both sides alike: thickness, colour, defocus, diffraction.

They hold where light only adds and reaches a pixel through its own lenslet; elsewhere they are
infinite, and only the bounds of `lf_flame.simulation.planning.effects` by the farthest move hold.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np

from lf_flame.optics import diffraction
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.ray_bundle import Footprint, trace_footprint
from lf_flame.scenes.scene import Layer
from lf_flame.simulation.bundle_shifts import focus_spread, misplaced_mm
from lf_flame.simulation.lenslet_blur import leaves_gaps, lenslet_kernel
from lf_flame.simulation.main_lens_blur import (
    gain_on_layer,
    main_lens_kernel,
    main_lens_spread_mm,
    throws_beyond,
)
from lf_flame.simulation.planning.axis_spread import (
    PATCHES,
    AxisSpread,
    Border,
    Box,
    Pairs,
    Rounding,
    Shifts,
)
from lf_flame.simulation.planning.bundle_widths import (
    BundleWidths,
    Interval,
    cell_width_mm,
    end_footprints,
    footprint_at,
    spread_ends,
)
from lf_flame.simulation.planning.cell_rounding import find_rounding
from lf_flame.simulation.planning.scene_bounds import SceneBounds, displaced
from lf_flame.simulation.planning.symmetric_spread import (
    spread_change,
)
from lf_flame.simulation.stops import neighbours, round_stops

STEPS = 12
"""Steps into which a move from the middle of a spread to its end is divided."""

FOCUS_STEPS = 3
"""Steps of depth and of colour by which neighbouring pixels' distance varies on a thick layer."""

GROUPS = 4
"""Parts of a spread of depth or colour whose bundles are told apart by their widths."""


DISTANCES = 24
"""Distances over which the main lens's pattern is divided: evenly in their logarithms."""

FAR_CELLS = 30
"""Distance in cells beyond which light that diffraction spreads counts as all of a layer's."""


@dataclass(frozen=True)
class Ways:
    """How far on a layer the pixels stand that a blur mixes, in mm, by their distance in the image.

    Attributes
    ----------
    apart, aside : ndarray
        Half of the distance between the two pixels of a pair, and how far their middle stands
        from the pixel between them.
    farther, nearer : ndarray
        Of the pair, from the pixel between them.
    across : ndarray
        What of it is due to the lenslets between them.
    """

    apart: np.ndarray
    aside: np.ndarray
    farther: np.ndarray
    nearer: np.ndarray
    across: np.ndarray

    @classmethod
    def of(cls, forward: np.ndarray, backward: np.ndarray, across: np.ndarray) -> "Ways":
        """Worst of the pairs of each view: signed distances, shape (views, pixels)."""
        one, other = np.abs(forward), np.abs(backward)
        found = (
            np.abs(forward - backward) / 2,
            np.abs(forward + backward) / 2,
            np.maximum(one, other),
            np.minimum(one, other),
            np.abs(across),
        )
        return cls(*(way.max(axis=0) for way in found))


def depth_change(bounds: SceneBounds, layer: Layer, parts: float = 1) -> float:
    """Bound on the change of a pixel if each of a thick layer's equal parts were a thin plane.

    Parameters
    ----------
    bounds : SceneBounds
    layer : Layer
    parts : float, optional
        Slabs, of the whole thickness over one; 1 leaves the thickness out.

    Returns
    -------
    float
        In the unit of the textures; infinite where it is not known.
    """
    return _focus_change(bounds, layer, 1 / parts, 0.0)


def colour_change(bounds: SceneBounds, layer: Layer, parts: int = 1) -> float:
    """Bound on the change of a pixel if equal parts of the band had one focal length each.

    The parameters are those of `depth_change`, with colours for slabs.
    """
    return _focus_change(bounds, layer, 0.0, 1 / parts)


def patch_change(bounds: SceneBounds, layer: Layer) -> float:
    """Bound on the change of a pixel if the patch of the main lens that it sees were a point."""
    if _unknown(bounds) or round_stops(bounds.camera):
        return math.inf
    axes = []
    for axis in (0, 1):
        box = BundleWidths(replace(bounds, defocus=True), layer, axis).box((-1, 1), (-1, 1))
        point = Box(box.lenslet, (0.0, 0.0))
        moves = box.pixel[1] / 2 * (np.arange(STEPS) + 1) / STEPS
        pairs = Pairs.alike(np.full(STEPS, 1 / STEPS), moves)
        rounding = find_rounding(
            pairs, cell_width_mm(layer, axis), point, [(point, point)], cut=False
        )
        axes.append(AxisSpread(point, _centres(bounds, layer, axis), pairs, rounding))
    return spread_change(layer, (axes[0], axes[1]), together=False)


def lenslet_blur_change(bounds: SceneBounds, layer: Layer) -> float:
    """Bound on the change of a pixel by the diffraction of its lenslet."""
    camera = bounds.camera
    if _unknown(bounds) or round_stops(camera) or not camera.falloff_corrected:
        return math.inf
    if leaves_gaps(camera):
        return math.inf
    kernel, beyond = lenslet_kernel(camera)
    count, view = np.arange(1, len(kernel) // 2 + 1), np.arange(camera.views)[:, None]

    def ways(step: float, view_step: float) -> Ways:
        """Beyond the edge of a micro-image follow the neighbour's views, from its other edge."""
        lenslets, back = (view + count) // camera.views, (view - count) // camera.views
        forward = lenslets * step + ((view + count) % camera.views - view) * view_step
        backward = back * step + ((view - count) % camera.views - view) * view_step
        return Ways.of(forward, backward, lenslets * step)

    near = _blur_change(bounds, layer, kernel, ways)
    return near + 2 * beyond * float(layer.texture.max())


def main_lens_blur_change(bounds: SceneBounds, layer: Layer) -> float:
    """Bound on the change of a pixel by the diffraction of the main lens."""
    if _unknown(bounds) or bounds.camera.rim_diameter_mm is not None:
        return math.inf
    camera, axes, far = bounds.camera, [], 0.0
    gain = max(gain_on_layer(camera, *place) for place in focus_spread(camera, layer))
    spread = main_lens_spread_mm(camera) * gain
    for axis in (0, 1):
        widths = BundleWidths(bounds, layer, axis)
        box = widths.box((-1, 1), (-1, 1))
        farthest = max(FAR_CELLS * widths.cell_mm, 4 * box.half_mm)
        moves = np.geomspace(min(spread, farthest) / 4, farthest, DISTANCES)
        beyond = throws_beyond(camera, moves, gain)
        pairs = Pairs.alike(-np.diff(beyond, prepend=1.0), moves)
        far += beyond[-1] * layer.texture.max()
        rounding = _rounding(widths, pairs, (0.0, 0.0))
        axes.append(AxisSpread(box, _centres(bounds, layer, axis), pairs, rounding))
    return spread_change(layer, (axes[0], axes[1]), together=False) + far


def _unknown(bounds: SceneBounds) -> bool:
    """Whether light is stopped on its way, or comes through other lenslets than a pixel's own."""
    camera = bounds.camera
    matter = any(layer.opaque or layer.optical_thickness.any() for layer in bounds.layers)
    return matter or any(misplaced_mm(camera)) or neighbours(camera) > 0


def _focus_change(bounds: SceneBounds, layer: Layer, depth: float, colour: float) -> float:
    """Bound on the change by a share of the spread of depth or of colour; the other share is 0."""
    if _unknown(bounds):
        return math.inf
    axes, uneven = [], 0.0
    for axis in (0, 1):
        widths = BundleWidths(bounds, layer, axis)
        pairs, lopsided = _focus_pairs(bounds, layer, axis, depth, colour)
        # The spread itself has its middle where the layer or the mean colour stands.
        middle = float(depth != 1), float(colour != 1)
        centres = _centres(bounds, layer, axis, *middle)
        rounding = _rounding(widths, pairs, (depth, colour))
        box = widths.box((-1, 1), (-1, 1))
        axes.append(AxisSpread(box, centres, pairs, rounding))
        uneven += displaced(bounds, layer, axis, lopsided, box.lenslet[0])
    return spread_change(layer, (axes[0], axes[1]), together=True) + uneven


def _focus_pairs(
    bounds: SceneBounds, layer: Layer, axis: int, depth: float, colour: float
) -> tuple[Pairs, float]:
    """How far rays move from the middle of a spread to its ends, and the pairs are from even.

    For the parts at the ends of the whole spread too; what lies between moves no farther.
    """
    moves, widening, lopsided = np.zeros(PATCHES), 0.0, 0.0
    for place, focus in spread_ends(bounds.camera, layer):
        here = footprint_at(bounds.camera, layer, axis, place, focus)
        ends = [
            footprint_at(bounds.camera, layer, axis, place + sign * depth, focus + sign * colour)
            for sign in (-1, 1)
        ]
        lit = _lit(layer, axis, [here, *ends])
        centres = [(end.centres_mm - here.centres_mm)[:, lit] for end in ends]
        lenslets = [end.lenslet_width_mm - here.lenslet_width_mm for end in ends]
        pixels = [end.pixel_width_mm - here.pixel_width_mm for end in ends]
        even = np.abs(centres[0] + centres[1]).max(initial=0.0) / 2
        lopsided = max(lopsided, even + (abs(sum(lenslets)) + abs(sum(pixels))) / 4)
        for centre, lenslet, pixel in zip(centres, lenslets, pixels, strict=True):
            widens = abs(pixel) if bounds.defocus else 0.0
            middle = np.abs(centre).max(initial=0.0) + abs(lenslet)
            edges = middle + np.linspace(-0.5, 0.5, PATCHES + 1) * widens
            moves = np.maximum(moves, np.maximum(np.abs(edges[:-1]), np.abs(edges[1:])))
            widening = max(widening, widens)
    part = (np.arange(STEPS) + 1) / STEPS
    return Pairs(np.full(STEPS, 1 / STEPS), part[:, None] * moves, part * widening), lopsided


def _rounding(widths: BundleWidths, pairs: Pairs, way: tuple[float, float]) -> Rounding:
    """Find what steps between cells add, with the spread of depth and colour or without it.

    way: share of each spread that the pairs go to either side; at 0 they stay where they are. A
    spread that is looked at as a whole has its middle in one place; in parts, all over.
    """
    # The ways of a whole spread are told apart by how far they go; those of its parts are short.
    steps = np.linspace(0, 1, STEPS + 1).tolist() if 1 in way else (0, 1)
    cells = list(pairwise(np.linspace(-1, 1, GROUPS + 1).tolist()))
    spreads = [
        [(0.0, 0.0)] if share == 1 or not wide else cells
        for share, wide in zip(way, widths.spreads, strict=True)
    ]

    def moved(depths: Interval, colours: Interval, low: float, high: float) -> Box:
        """Bundles between two shares of the way from a part of the spreads."""
        depth, colour = sorted((way[0] * low, way[0] * high)), sorted((way[1] * low, way[1] * high))
        return widths.box(
            (depths[0] + depth[0], depths[1] + depth[1]),
            (colours[0] + colour[0], colours[1] + colour[1]),
        )

    def at(depths: Interval, colours: Interval) -> Rounding:
        ends = [
            (moved(depths, colours, -low, -high), moved(depths, colours, low, high))
            for low, high in pairwise(steps)
        ]
        return find_rounding(pairs, widths.cell_mm, widths.box(depths, colours), ends, widths.cut)

    # Each other spread may be simulated, or left out.
    options = [
        [each] if share or not wide else [each, [(0.0, 0.0)]]
        for each, share, wide in zip(spreads, way, widths.spreads, strict=True)
    ]
    means = [
        np.mean([list(vars(at(d, c)).values()) for d, c in product(depths, colours)], axis=0)
        for depths, colours in product(*options)
    ]
    return Rounding(*np.max(means, axis=0))


def _blur_change(
    bounds: SceneBounds,
    layer: Layer,
    kernel: np.ndarray,
    ways: Callable[[float, float], Ways],
) -> float:
    """Bound on the change by a blur of the pixels, symmetric in their order along each axis.

    ways: from the distances of neighbouring lenslets' and views' bundles on the layer.
    """
    axes, far = [], 0.0
    for axis in (0, 1):
        widths = BundleWidths(bounds, layer, axis)
        box = widths.box((-1, 1), (-1, 1))
        shares, mixed = _mixed(bounds.camera, layer, axis, kernel[len(kernel) // 2 + 1 :], ways)
        limit = max(FAR_CELLS * widths.cell_mm, 4 * box.half_mm)
        near = np.maximum(mixed.farther, mixed.across) <= limit
        far += 3 * shares[~near].sum() * layer.texture.max()
        near_ways = {name: way[near] for name, way in vars(mixed).items()}
        shares = shares[near]
        pairs = Pairs.alike(2 * shares, near_ways["apart"])
        axes.append(
            AxisSpread(
                box,
                _centres(bounds, layer, axis),
                pairs,
                _rounding(widths, pairs, (0.0, 0.0)),
                Shifts(2 * shares, near_ways["aside"]),
                _border(bounds, layer, axis, shares, near_ways),
            )
        )
    return spread_change(layer, (axes[0], axes[1]), together=False) + far


def _border(bounds: SceneBounds, layer: Layer, axis: int, shares, ways) -> Border | None:
    """Pixels near the image's border, beyond which its outermost pixels go on, if they are lit."""
    seen = end_footprints(bounds.camera, layer, axis)
    low, high = layer.extent_mm(layer.texture, axis)
    farthest = float(ways["farther"].max(initial=0.0))
    reach = max(footprint.half_width_mm for footprint in seen) + farthest
    regions = []
    for side in (0, -1):
        ends = [footprint.centres_mm[:, side] for footprint in seen]
        first, last = min(end.min() for end in ends), max(end.max() for end in ends)
        if first - farthest - reach < high and last + farthest + reach > low:
            regions.append((float(first) - farthest, float(last) + farthest))
    if not regions or not farthest:
        return None
    # There the main lens's blur does not go on from lenslet to lenslet either.
    blurred = diffraction.share_leaving(main_lens_kernel(bounds.camera))
    lost = Shifts(2 * blurred * shares, ways["across"])
    return Border(
        tuple(regions), Shifts(shares, ways["farther"]), Shifts(shares, ways["nearer"]), lost
    )


def _mixed(
    camera: PlenopticCamera,
    layer: Layer,
    axis: int,
    weights: np.ndarray,
    ways: Callable[[float, float], Ways],
) -> tuple[np.ndarray, Ways]:
    """Weights and ways of a kernel, over the depths and colours from which light may come.

    Half of them as at the middle of the spread or as of the nearer half, half as at its farthest:
    no less than with the spread, or without it.
    """
    steps = (np.arange(FOCUS_STEPS) + 1) / FOCUS_STEPS
    depths = layer.thickness_mm / 2 * steps if layer.thickness_mm else np.zeros(1)
    shift = camera.chromatic_shift * camera.main_lens_focal_mm / 2
    colours = shift * steps if shift else np.zeros(1)

    def at(depth: float, colour: float) -> np.ndarray:
        place = layer.depth_mm + depth, camera.main_lens_focal_mm + colour
        return np.stack(list(vars(ways(*_pixel_steps(camera, axis, *place))).values()))

    middle, halves = at(0.0, 0.0), []
    for depth, colour in product(depths, colours):
        both = np.sort([at(i * depth, j * colour) for i in (-1, 1) for j in (-1, 1)], axis=0)
        alone = [np.min([at(i * depth, 0.0) for i in (-1, 1)], axis=0),
                 np.min([at(0.0, j * colour) for j in (-1, 1)], axis=0)]  # fmt: skip
        halves += [np.max([middle, both[1], *alone], axis=0), np.max([middle, both[3]], axis=0)]
    shares = np.tile(weights / len(halves), len(halves))
    return shares, Ways(*np.stack(halves, axis=1).reshape(5, -1))


def _pixel_steps(
    camera: PlenopticCamera, axis: int, depth_mm: float, focal_mm: float
) -> tuple[float, float]:
    """How far the bundles of neighbouring lenslets, and of neighbouring views, stand apart."""
    footprint = trace_footprint(camera, depth_mm, axis, focal_mm)
    pixel = footprint.pixel_width_mm / camera.pixel_mm
    # A lenslet further on, and its micro-image with it.
    step = footprint.shift_per_lenslet_shift * camera.lenslet_pitch_mm
    return step - pixel * camera.micro_image_pitch_mm, -footprint.pixel_width_mm


def _centres(
    bounds: SceneBounds, layer: Layer, axis: int, depth: float = 1.0, colour: float = 1.0
) -> tuple[float, float]:
    """First and last centre of the pixels' bundles, over shares of the spreads."""
    seen = [
        footprint_at(bounds.camera, layer, axis, depth * place, colour * focus)
        for place, focus in spread_ends(bounds.camera, layer)
    ]
    return (
        float(min(footprint.centres_mm.min() for footprint in seen)),
        float(max(footprint.centres_mm.max() for footprint in seen)),
    )


def _lit(layer: Layer, axis: int, seen: list[Footprint]) -> np.ndarray:
    """Lenslets of which some bundle meets the layer, here or there."""
    low, high = layer.extent_mm(layer.texture, axis)
    lowest = np.min([f.centres_mm.min(axis=0) - f.half_width_mm for f in seen], axis=0)
    highest = np.max([f.centres_mm.max(axis=0) + f.half_width_mm for f in seen], axis=0)
    return (highest > low) & (lowest < high)
