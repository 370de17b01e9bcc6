"""Bundles on a layer, over its depth and the band of colours: where they stand and how wide."""

from itertools import product

from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.ray_bundle import Footprint, trace_footprint
from lf_flame.scenes.scene import Layer
from lf_flame.simulation.planning.axis_spread import Box
from lf_flame.simulation.planning.scene_bounds import SceneBounds
from lf_flame.simulation.stops import round_stops

Interval = tuple[float, float]


class BundleWidths:
    """Widths of bundles on a layer along one axis, over its depth and the band of colours.

    Both spreads go from -1 to 1. Widths are linear in depth and in the power of the lens, so that
    what lies between some places is not wider than they are, nor narrower unless it passes 0.
    """

    def __init__(self, bounds: SceneBounds, layer: Layer, axis: int):
        self.defocus, self.cell_mm = bounds.defocus, cell_width_mm(layer, axis)
        self.spreads = layer.thickness_mm > 0, bounds.camera.chromatic_shift > 0
        self.cut = bool(round_stops(bounds.camera))
        self._shift = bounds.camera.chromatic_shift / 2
        corners = [
            footprint_at(bounds.camera, layer, axis, depth, colour)
            for depth, colour in product((0, 1), (0, 1))
        ]
        self._lenslets = _plane([corner.lenslet_width_mm for corner in corners])
        self._pixels = _plane([corner.pixel_width_mm for corner in corners])

    def box(self, depths: Interval, colours: Interval) -> Box:
        """Narrowest and widest between two depths and two colours."""
        places = [(d, self._power(c)) for d in depths for c in colours]
        pixel = self._range(self._pixels, places) if self.defocus else (0.0, 0.0)
        return Box(self._range(self._lenslets, places), pixel)

    def _power(self, colour: float) -> float:
        """Change of the power of the lens, over that at a colour of 1."""
        return colour * (1 + self._shift) / (1 + self._shift * colour)

    @staticmethod
    def _range(plane: tuple[float, ...], places: list[tuple[float, float]]) -> Interval:
        here, by_depth, by_power, by_both = plane
        widths = [here + d * by_depth + p * (by_power + d * by_both) for d, p in places]
        low, high = min(widths), max(widths)
        return (0.0 if low <= 0 <= high else min(abs(low), abs(high))), max(-low, high)


def _plane(corners: list[float]) -> tuple[float, float, float, float]:
    """Coefficients of what is linear in two numbers, from its values where each is 0 or 1."""
    here, other, deeper, both = corners
    return here, deeper - here, other - here, both - deeper - other + here


def cell_width_mm(layer: Layer, axis: int) -> float:
    """Width of a layer's cells along an axis."""
    edges = layer.cell_edges_mm(axis)
    return float(edges[1] - edges[0])


def spread_ends(camera: PlenopticCamera, layer: Layer) -> list[tuple[int, int]]:
    """List the ends of the spreads of depth and colour, -1 and 1, as far as there are any."""
    depths = (-1, 1) if layer.thickness_mm else (0,)
    return list(product(depths, (-1, 1) if camera.chromatic_shift else (0,)))


def footprint_at(
    camera: PlenopticCamera, layer: Layer, axis: int, depth: float, colour: float
) -> Footprint:
    """Bundles at a place in the spreads of depth and colour."""
    focal_mm = camera.main_lens_focal_mm * (1 + camera.chromatic_shift / 2 * colour)
    return trace_footprint(camera, layer.depth_mm + layer.thickness_mm / 2 * depth, axis, focal_mm)


def end_footprints(camera: PlenopticCamera, layer: Layer, axis: int) -> list[Footprint]:
    """Bundles at the ends of the spreads of depth and colour."""
    return [footprint_at(camera, layer, axis, *place) for place in spread_ends(camera, layer)]
