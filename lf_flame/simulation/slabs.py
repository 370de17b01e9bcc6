"""Thin planes that emit and attenuate light: the layers of a scene, front to back."""

import math
from collections.abc import Set
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from lf_flame.errors import InputError
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.ray_bundle import trace_footprint
from lf_flame.scenes.scene import Layer, Scene

BISECTIONS = 60
"""Number of bisections for the edges of slabs: they are exact to the last digit."""


@dataclass(frozen=True, eq=False)
class Plane:
    """A layer, or one of the slabs of a thick one.

    Attributes
    ----------
    emission : ndarray of float64, shape (rows, columns)
        Radiance that each cell adds.
    transmission : ndarray of float64, shape (rows, columns), or None
        Fraction of the light from behind that each cell transmits; None where all is transmitted.
    depth_mm : float
    layer : Layer
        Layer that gives the position of the cells.
    lean : (float, float)
        Change of depth per mm along y and x, of a sheet that leans and shines, of which the plane
        is a strip. Oblique rays meet strips more often or less than the sheet; their light is
        multiplied by `OpticalPass.strip_gain` for that.
    sheet : int
        Number of a sheet without thickness that leans, from 1 on; 0 for other planes. A ray meets
        one of its strips.
    """

    emission: np.ndarray
    transmission: np.ndarray | None
    depth_mm: float
    layer: Layer
    lean: tuple[float, float] = (0.0, 0.0)
    sheet: int = 0


def check_field(scene: Scene, camera: PlenopticCamera) -> None:
    """Refuse layers that no pixel sees."""
    for layer in scene.layers:
        for axis in (0, 1):
            footprint = trace_footprint(camera, layer.depth_mm, axis)
            edges, reach = layer.cell_edges_mm[axis], footprint.half_width_mm
            low, high = footprint.centres_mm.min() - reach, footprint.centres_mm.max() + reach
            if edges[-1] <= low or edges[0] >= high:
                raise InputError(
                    f"The layer at depth {layer.depth_mm} mm lies outside the field: in "
                    f"{'yx'[axis]} it spans {edges[0]:.4g} to {edges[-1]:.4g} mm, "
                    f"and the camera sees {low:.4g} to {high:.4g} mm there."
                )


def slice_scene(
    scene: Scene, slabs: dict[Layer, int], absorption: bool, attenuating: Set[str]
) -> list[Plane]:
    """Cut the layers of a scene into planes, nearest to the main lens first.

    slabs: number of planes for layers that need more than one. absorption: whether optically thick
    layers absorb their own light. attenuating: set of "occlusion" and "self_absorption": whether
    opaque layers occlude, and optically thick layers attenuate, the light from behind.
    """
    planes: list[Plane] = []
    for layer in scene.front_to_back:
        count = slabs.get(layer, 1)
        if count > 1 and any(layer.tilt_deg):
            planes += _leaning_slabs(layer, count, absorption, attenuating, len(planes) + 1)
            continue
        if count > 1 and absorption and layer.optical_thickness.any():
            planes += _absorbing_slabs(layer, count, attenuating)
            continue
        tau = layer.optical_thickness / count if absorption else np.zeros(1)
        emission = layer.texture * (self_absorbed(tau) / count)
        transmission = _transmission(layer.opacity, tau, attenuating, layer.texture.shape)
        middles = (np.arange(count) + 0.5) / count - 0.5
        planes += [
            Plane(emission, transmission, layer.depth_mm + layer.thickness_mm * middle, layer)
            for middle in middles
        ]
    # A stable sort: slabs of thick layers may interleave, and at one depth glow precedes surface.
    return sorted(planes, key=lambda plane: plane.depth_mm)


def _absorbing_slabs(layer: Layer, count: int, attenuating: Set[str]) -> list[Plane]:
    edges, planes = slab_edges(layer, count), []
    for low, high in pairwise(edges):
        tau = layer.optical_thickness * (high - low)
        emission = layer.texture * (self_absorbed(tau) * (high - low))
        depth_mm = layer.depth_mm + layer.thickness_mm * ((low + high) / 2 - 0.5)
        planes.append(
            Plane(
                emission,
                _transmission(layer.opacity, tau, attenuating, layer.texture.shape),
                depth_mm,
                layer,
            )
        )
    return planes


def _leaning_slabs(
    layer: Layer, count: int, absorption: bool, attenuating: Set[str], number: int
) -> list[Plane]:
    """Cut a layer that leans into planes across the axis, each with the cells at its depth.

    Cells that are longer than a quarter of a slab are cut, too; a cell of a thick layer is shared
    by the slabs that its thickness reaches. number: of the sheet, if it has no thickness.
    """
    axis = 0 if layer.tilt_deg[0] else 1
    cells, angle = layer.texture.shape[axis], math.radians(layer.tilt_deg[axis])
    parts, thick = math.ceil(4 * count / cells), layer.thickness_mm
    places = (np.arange(cells * parts) + 0.5) / (cells * parts) - 0.5
    depths = places * layer.size_mm[axis] * math.sin(angle) * (-1 if axis == 0 else 1)
    faces = (np.arange(count + 1) / count - 0.5) * layer.depth_extent_mm
    faces[[0, -1]] = -math.inf, math.inf
    low_mm, high_mm = layer.cell_edges_mm[axis][[0, -1]].tolist()
    edges = np.linspace(low_mm, high_mm, cells * parts + 1)
    planes = []
    for low, high in pairwise(faces):
        inside = (depths >= low) & (depths < high)
        front, back = np.maximum(depths - thick / 2, low), np.minimum(depths + thick / 2, high)
        share = np.clip((back - front) / thick, 0, 1) if thick else inside.astype(float)
        here = np.flatnonzero(share)
        if here.size == 0:
            continue
        some = slice(here[0], here[-1] + 1)

        def cut(values, some=some):
            values = np.broadcast_to(values, layer.texture.shape).repeat(parts, axis)
            return values[some] if axis == 0 else values[:, some]

        shares = np.expand_dims(share[some], 1 - axis)
        tau = cut(layer.optical_thickness) * shares * absorption
        emission = cut(layer.texture) * shares * self_absorbed(tau)
        size, centre = list(layer.size_mm), list(layer.centre_mm)
        size[axis] = edges[some.stop] - edges[some.start]
        centre[axis] = (edges[some.stop] + edges[some.start]) / 2
        middle = np.average((front + back)[some] / 2, weights=share[some])
        depth_mm = layer.depth_mm + float(middle)
        place = Layer(emission, depth_mm, size, centre)
        transmission = _transmission(cut(layer.opacity) * shares, tau, attenuating, emission.shape)
        rise = math.tan(angle) * (-1 if axis == 0 else 1)
        lean = (rise, 0.0) if axis == 0 else (0.0, rise)
        sheet = 0 if thick else number
        planes.append(Plane(emission, transmission, depth_mm, place, lean, sheet))
    return planes


def slab_edges(layer: Layer, count: int) -> np.ndarray:
    """Edges of the slabs of a thick layer, as shares of its thickness from its front.

    Half of the slabs are equally thick. With optical thickness the other half crowd at the front
    and at the back, as ``exp(-tau d / 2)`` with d the distance from the nearer face: a ray that
    enters or leaves through the side of a strongly absorbing layer shows it only there. Without,
    all are equally thick.

    They increase from 0 to 1.
    """
    wanted, tau = np.arange(count + 1) / count, float(layer.optical_thickness.max())
    if tau == 0:
        return wanted
    near = np.minimum(wanted, 1 - wanted)  # from the nearer face, by symmetry
    low, high = np.zeros(count + 1), np.full(count + 1, 0.5)
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        crowded = np.expm1(-tau * middle / 2) / np.expm1(-tau / 4) / 2
        below = (middle + crowded) / 2 < near
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    found = np.where(near == 0, 0.0, np.where(near == 0.5, 0.5, (low + high) / 2))
    return np.where(wanted > 0.5, 1 - found, found)


def _transmission(opacity, tau: np.ndarray, attenuating: Set[str], shape) -> np.ndarray | None:
    opacity = opacity if "occlusion" in attenuating else 0.0
    passes = np.exp(-tau) if "self_absorption" in attenuating else np.ones(1)
    if np.all(opacity == 0) and np.all(passes == 1):
        return None
    return np.broadcast_to((1 - opacity) * passes, shape)


def self_absorbed(tau: np.ndarray) -> np.ndarray:
    """Fraction of its light that leaves a layer of optical thickness tau: ``(1-exp(-tau))/tau``.

    expm1 keeps all digits for a small tau; the value is 1 at tau = 0.
    """
    tau = np.asarray(tau, np.float64)
    return np.divide(-np.expm1(-tau), tau, out=np.ones_like(tau), where=tau > 0)
