"""Scenes: planar layers of light at chosen depths.

Layer coordinates are those of the upright image: y runs down with the texture's rows, x runs
right with its columns, both in mm from the optical axis.
"""

from dataclasses import dataclass

import numpy as np

from lf_flame.errors import InputError


@dataclass(frozen=True, eq=False)
class Layer:
    """A flat, luminous rectangle perpendicular to the optical axis.

    Parameters
    ----------
    texture : array_like, shape (rows, columns)
        Radiance of its cells, 0 or above; constant over each cell. Stored as float64.
    depth_mm : float
        Depth from the focal plane, positive = farther from the main lens.
    size_mm : (float, float)
        Height and width.
    centre_mm : (float, float), optional
        Position (y, x) of its centre.
    opaque : bool, optional
        Whether it hides the layers behind it. Light only adds for now: `render` refuses True.

    Raises
    ------
    InputError
        If a value cannot be used; the message names it.
    """

    texture: np.ndarray
    depth_mm: float
    size_mm: tuple[float, float]
    centre_mm: tuple[float, float] = (0.0, 0.0)
    opaque: bool = False

    def __post_init__(self):
        texture = np.asarray(self.texture)
        if texture.ndim != 2 or texture.size == 0 or texture.dtype.kind not in "biuf":
            raise InputError(
                f"A layer's texture must be a grey image with rows and columns, "
                f"got an array of shape {texture.shape} and type {texture.dtype}."
            )
        texture = np.array(texture, dtype=np.float64)
        if not np.all(np.isfinite(texture)) or texture.min() < 0:
            raise InputError(
                f"A layer's texture must be finite and not negative, "
                f"got values from {texture.min()} to {texture.max()}."
            )
        texture.flags.writeable = False
        object.__setattr__(self, "texture", texture)
        for name, lowest in (("size_mm", 0.0), ("centre_mm", -np.inf)):
            pair = tuple(float(value) for value in getattr(self, name))
            if len(pair) != 2 or not all(np.isfinite(v) and v > lowest for v in pair):
                raise InputError(
                    f"{name} must be two finite lengths (y, x) in mm"
                    f"{' above 0' if lowest == 0 else ''}, got {getattr(self, name)}."
                )
            object.__setattr__(self, name, pair)
        if not np.isfinite(self.depth_mm):
            raise InputError(f"depth_mm of a layer must be finite, got {self.depth_mm}.")

    def cell_edges_mm(self, axis: int) -> np.ndarray:
        """Edges of the cells along an axis (0 = y, 1 = x), in mm, float64, cells + 1 of them."""
        cells = self.texture.shape[axis]
        offset = self.centre_mm[axis] - self.size_mm[axis] / 2
        return offset + np.arange(cells + 1) * (self.size_mm[axis] / cells)


@dataclass(frozen=True, eq=False)
class Scene:
    """Layers whose light adds up.

    Parameters
    ----------
    layers : sequence of Layer
        At least one, in any order.
    """

    layers: tuple[Layer, ...]

    def __post_init__(self):
        object.__setattr__(self, "layers", tuple(self.layers))
        if not self.layers:
            raise InputError("A scene needs at least one layer, got none.")

    @property
    def depths_mm(self) -> tuple[float, ...]:
        """The depths at which there are layers, each once, farthest first."""
        return tuple(sorted({layer.depth_mm for layer in self.layers}, reverse=True))
