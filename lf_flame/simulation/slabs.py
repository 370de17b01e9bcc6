"""Layers as the renderer sees them: thin planes, front to back, that emit and that dim."""

from collections.abc import Set
from dataclasses import dataclass

import numpy as np

from lf_flame.scenes.scene import Layer, Scene


@dataclass(frozen=True, eq=False)
class Plane:
    """A layer, or one of the slabs of a thick one.

    Attributes
    ----------
    emission : ndarray of float64, shape (rows, columns)
        Radiance that its cells add.
    transmission : ndarray of float64, shape (rows, columns), or None
        Share of the light from behind that its cells let pass; None where all of it does.
    depth_mm : float
    layer : Layer
        Where the cells lie.
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
        Whether optically thick layers dim their own light.
    dimming : set of str
        Out of "occlusion" and "self_absorption": whether opaque layers hide, and optically thick
        ones dim, what is behind them.
    """
    planes = []
    for layer in scene.front_to_back:
        count = slabs.get(layer, 1)
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


def _transmission(layer: Layer, tau: np.ndarray, dimming: Set[str]) -> np.ndarray | None:
    opacity = layer.opacity if "occlusion" in dimming else 0.0
    passes = np.exp(-tau) if "self_absorption" in dimming else np.ones(1)
    if np.all(opacity == 0) and np.all(passes == 1):
        return None
    return np.broadcast_to((1 - opacity) * passes, layer.texture.shape)


def self_absorbed(tau: np.ndarray) -> np.ndarray:
    """Share of its own light that leaves a layer of optical thickness tau: ``(1-exp(-tau))/tau``.

    By expm1, so that no digit is lost for a small tau; 1 at tau = 0.
    """
    tau = np.asarray(tau, np.float64)
    return np.divide(-np.expm1(-tau), tau, out=np.ones_like(tau), where=tau > 0)
