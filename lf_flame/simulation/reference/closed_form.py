"""Images of flat layers in closed form and float64, also with occlusion: the reference of studies.

The code is slow and simple; nothing is compiled, sampled or rounded to float32. The rays of a pixel
fill a unit square along each axis: position on the lenslet times position on the pixel. A cell of a
layer is a strip of this square. Cells of two layers are seen through the intersection of two
strips, the area of which is computed edge by edge.
"""

import numpy as np

from lf_flame.errors import InputError
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.ray_bundle import Footprint, trace_footprint, trapezoid_cdf
from lf_flame.scenes.scene import Layer, Scene


def closed_form(scene: Scene, camera: PlenopticCamera) -> np.ndarray:
    """Integrate flat layers, each of them occluded by at most one opaque layer.

    Parameters
    ----------
    scene : Scene
        Layers without optical thickness and thickness.
    camera : PlenopticCamera
        Camera, of which only optics and geometry count: no stops, no noise.

    Returns
    -------
    ndarray of float64, shape (v, u, t, s)

    Raises
    ------
    InputError
        If the scene has layers of another kind.
    """
    layers = scene.front_to_back
    if any(layer.thickness_mm or layer.optical_thickness.any() for layer in layers):
        raise InputError("The closed form takes layers that are flat and do not absorb.")
    raw: np.ndarray | float = 0.0
    cards: list[Layer] = []
    for layer in layers:
        if layer.texture.any():
            if len(cards) > 1:
                raise InputError(f"The closed form takes one opaque layer in front of a glow, "
                                 f"got {len(cards)}.")  # fmt: skip
            raw = raw + _open(layer, camera)
            raw = raw - _hidden(cards[0], layer, camera) if cards else raw
        cards += [layer] if layer.opaque else []
    views, (lines, columns) = camera.views, camera.lenslets
    shape = (views, lines, views, columns)
    return np.broadcast_to(raw, (views * lines, views * columns)).reshape(shape).swapaxes(1, 2)


def _open(layer: Layer, camera: PlenopticCamera) -> np.ndarray:
    """Light of a layer with nothing in front, shape (v * t, u * s)."""
    weights = []
    for axis in (0, 1):
        footprint, edges = _edges(layer, camera, axis)
        widths = abs(footprint.lenslet_width_mm), abs(footprint.pixel_width_mm)
        weights.append(np.diff(trapezoid_cdf(edges, *widths), axis=1))
    return weights[0] @ layer.texture @ weights[1].T


def _hidden(front: Layer, behind: Layer, camera: PlenopticCamera) -> np.ndarray:
    """Light of a layer that another one hides."""
    rows, columns = (_crossings(front, behind, camera, axis) for axis in (0, 1))
    opacity = np.broadcast_to(front.opacity, front.texture.shape)
    hidden = np.zeros((len(rows), len(columns)))
    for i in np.flatnonzero(opacity.any(axis=1)):
        hidden += rows[:, i] @ behind.texture @ np.tensordot(opacity[i], columns, (0, 1)).T
    return hidden


def _edges(layer: Layer, camera: PlenopticCamera, axis: int) -> tuple[Footprint, np.ndarray]:
    """Edges of the cells from the centre of each pixel's bundle, shape (pixels, cells + 1)."""
    footprint = trace_footprint(camera, layer.depth_mm, axis)
    return footprint, layer.cell_edges_mm(axis) - footprint.centres_mm.reshape(-1, 1)


def _crossings(front: Layer, behind: Layer, camera: PlenopticCamera, axis: int) -> np.ndarray:
    """Share of each bundle that meets a cell of both layers, shape (pixels, cells, cells)."""
    (one, near), (other, far) = (_edges(layer, camera, axis) for layer in (front, behind))
    widths = np.array([[f.lenslet_width_mm, f.pixel_width_mm] for f in (one, other)])
    if np.any(np.abs(widths[:, 1]) < 1e-9 * np.abs(widths[:, 0])):
        widths = widths[:, ::-1]  # in focus: no place on the pixel is the one on an edge
    area = [_corner_area(near[:, i : i + 1], far, widths) for i in range(near.shape[1])]
    return np.diff(np.diff(np.stack(area, axis=1), axis=1), axis=2)


def _corner_area(near: np.ndarray, far: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """Area of the unit square where ``w[0] a + w[1] b`` lies below an edge for both layers.

    For each a the places b form an interval, whose length is linear between the a where an edge
    enters or leaves the square or both cross: the trapezoid rule between these is exact.
    """
    height = [edge / w[1] for edge, w in zip((near, far), widths, strict=True)]
    slope = [-w[0] / w[1] for w in widths]
    with np.errstate(divide="ignore", invalid="ignore"):
        bends = [(side - h) / m for h, m in zip(height, slope, strict=True) for side in (-0.5, 0.5)]
        bends.append((height[1] - height[0]) / (slope[0] - slope[1]))
    a = np.nan_to_num(np.stack(np.broadcast_arrays(-0.5, *bends, 0.5)))
    a = np.sort(np.clip(a, -0.5, 0.5), axis=0)
    low, high = np.full_like(a, -0.5), np.full_like(a, 0.5)
    for h, m, w in zip(height, slope, widths, strict=True):
        edge = np.clip(h + m * a, -0.5, 0.5)
        if w[1] > 0:
            np.minimum(high, edge, out=high)
        else:
            np.maximum(low, edge, out=low)
    length = np.maximum(high - low, 0)
    return ((length[1:] + length[:-1]) / 2 * np.diff(a, axis=0)).sum(axis=0)
