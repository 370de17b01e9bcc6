"""Thin planes that emit and attenuate light: the layers of a scene, front to back."""

from collections.abc import Set
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

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
        Layer that gives the place of the cells.
    """

    emission: np.ndarray
    transmission: np.ndarray | None
    depth_mm: float
    layer: Layer


def slice_scene(
    scene: Scene, slabs: dict[Layer, int], absorption: bool, dimming: Set[str]
) -> list[Plane]:
    """Cut the layers of a scene into planes, nearest to the main lens first.

    Parameters
    ----------
    scene : Scene
    slabs : dict
        Number of planes for layers that need more than one.
    absorption : bool
        Whether optically thick layers absorb their own light.
    dimming : set of str
        Set of "occlusion" and "self_absorption": whether opaque layers occlude, and optically thick
        layers attenuate, the light from behind.
    """
    planes = []
    for layer in scene.front_to_back:
        count = slabs.get(layer, 1)
        if count > 1 and absorption and layer.optical_thickness.any():
            planes += _absorbing_slabs(layer, count, dimming)
            continue
        tau = layer.optical_thickness / count if absorption else np.zeros(1)
        emission = layer.texture * (self_absorbed(tau) / count)
        transmission = _transmission(layer, tau, dimming)
        middles = (np.arange(count) + 0.5) / count - 0.5
        planes += [
            Plane(emission, transmission, layer.depth_mm + layer.thickness_mm * middle, layer)
            for middle in middles
        ]
    # A stable sort: slabs of thick layers may interleave, and at one depth glow precedes surface.
    return sorted(planes, key=lambda plane: plane.depth_mm)


def _absorbing_slabs(layer: Layer, count: int, dimming: Set[str]) -> list[Plane]:
    edges, planes = slab_edges(layer, count), []
    for low, high in pairwise(edges):
        tau = layer.optical_thickness * (high - low)
        emission = layer.texture * (self_absorbed(tau) * (high - low))
        depth_mm = layer.depth_mm + layer.thickness_mm * ((low + high) / 2 - 0.5)
        planes.append(Plane(emission, _transmission(layer, tau, dimming), depth_mm, layer))
    return planes


def slab_edges(layer: Layer, count: int) -> np.ndarray:
    """Edges of the slabs of a thick layer, as shares of its thickness from its front.

    Half of the slabs are equally thick. With optical thickness the other half crowd at the front
    and at the back, as ``exp(-tau d / 2)`` with d the distance from the nearer face: a ray that
    enters or leaves through the side of a strongly absorbing layer shows it only there ("How many
    slabs" in the documentation). Without, all are equally thick.

    Returns
    -------
    ndarray of float64, shape (count + 1,)
        From 0 to 1, rising.
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


def _transmission(layer: Layer, tau: np.ndarray, dimming: Set[str]) -> np.ndarray | None:
    opacity = layer.opacity if "occlusion" in dimming else 0.0
    passes = np.exp(-tau) if "self_absorption" in dimming else np.ones(1)
    if np.all(opacity == 0) and np.all(passes == 1):
        return None
    return np.broadcast_to((1 - opacity) * passes, layer.texture.shape)


def self_absorbed(tau: np.ndarray) -> np.ndarray:
    """Fraction of its light that leaves a layer of optical thickness tau: ``(1-exp(-tau))/tau``.

    expm1 keeps all digits for a small tau; the value is 1 at tau = 0.
    """
    tau = np.asarray(tau, np.float64)
    return np.divide(-np.expm1(-tau), tau, out=np.ones_like(tau), where=tau > 0)
