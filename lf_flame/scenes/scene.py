"""Scenes: layers of light, surfaces and flames at chosen depths.

Layer coordinates are those of the upright image: y runs down with the texture's rows, x runs
right with its columns, both in mm from the optical axis.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from lf_flame._common.arrays import as_numbers
from lf_flame.errors import InputError
from lf_flame.optics.camera import PlenopticCamera

LARGEST_MM, SMALLEST_MM = 1e303, 1e-250
"""Range of lengths in mm: sums and ratios with those of a camera are still float64 numbers."""

STEEPEST_DEG = 85
"""Largest tilt of a layer; a steeper one is seen almost edge on."""


# Both classes have their own constructor because they store other types than they accept.
@dataclass(frozen=True, eq=False, init=False)
class Layer:
    """A luminous rectangle across the optical axis: a flat picture, a surface, a flame.

    Parameters
    ----------
    texture : array_like, shape (rows, columns)
        Radiance of the cells, 0 or above, constant over each cell. Stored as float64. With an
        optical thickness, it is the radiance that would leave the layer without absorption. With
        a coverage, it already includes the covered fraction (premultiplied); a cell with coverage
        0 still emits its radiance.
    depth_mm : float
        Depth from the focal plane, positive = farther from the main lens; depth of the centre if
        the layer has a thickness.
    size_mm : (float, float)
        Height and width.
    centre_mm : (float, float), optional
        Position (y, x) of its centre.
    opaque : bool, optional
        Whether the layer occludes everything behind it.
    coverage : array_like, shape (rows, columns), optional
        Opaque fraction of each cell of an opaque layer: 1 inside, between 0 and 1 on the outline,
        0 in a hole. Default: 1 everywhere, so that a texture of zeros is a black card.
    optical_thickness : float or array_like of shape (rows, columns), optional
        Absorption along the line of sight, 0 or above, stored as float64 for each cell. Light from
        behind is attenuated by ``exp(-tau)``, the layer's own by ``(1 - exp(-tau)) / tau``
        (emission and absorption evenly mixed; Modest, Radiative Heat Transfer, chapter on the
        equation of transfer). It holds along the optical axis: the longer path of an oblique ray,
        by 1/cos, is neglected.
    thickness_mm : float, optional
        Extent along the optical axis over which light and absorption are spread evenly, 0 or above.
    tilt_deg : (float, float), optional
        Angle in degrees by which the layer leans, about the horizontal axis through its centre
        (positive: its top is farther away) or about the vertical one (positive: its right side is);
        one of them, within 85. Its height and width are those along the layer, its thickness and
        its optical thickness those along the optical axis.

    Attributes
    ----------
    cell_edges_mm : (ndarray, ndarray)
        Edges of the cells along y and x, in mm, float64, shapes (rows + 1,) and (columns + 1,), as
        seen along the optical axis: a tilted layer is foreshortened.
    opacity : ndarray or float
        Opaque fraction of each cell: the coverage, 1 without one, 0 if not opaque.
    depth_extent_mm : float
        Extent along the optical axis, by thickness and tilt.

    Raises
    ------
    InputError
        If a value cannot be used; the message names it.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import Layer
    >>> square = Layer(np.ones((8, 8)), depth_mm=10.0, size_mm=(4.0, 4.0), centre_mm=(0.0, 3.0))
    """

    texture: np.ndarray
    depth_mm: float
    size_mm: tuple[float, float]
    centre_mm: tuple[float, float]
    opaque: bool
    coverage: np.ndarray | None
    optical_thickness: np.ndarray
    thickness_mm: float
    tilt_deg: tuple[float, float]
    cell_edges_mm: tuple[np.ndarray, np.ndarray] = field(init=False, repr=False)
    opacity: np.ndarray | float = field(init=False, repr=False)
    depth_extent_mm: float = field(init=False, repr=False)

    def __init__(
        self,
        texture: ArrayLike,
        depth_mm: float,
        size_mm: ArrayLike,
        centre_mm: ArrayLike = (0.0, 0.0),
        opaque: bool = False,
        coverage: ArrayLike | None = None,
        optical_thickness: ArrayLike = 0.0,
        thickness_mm: float = 0.0,
        tilt_deg: ArrayLike = (0.0, 0.0),
    ):
        # Sums over a few layers of the largest radiance are still float32 numbers.
        cells = _checked_cells(texture, "texture", most=1e36)
        depth_mm, thickness_mm = _checked_pair((depth_mm, thickness_mm), "depth_mm, thickness_mm")
        if not (abs(depth_mm) < LARGEST_MM and 0 <= thickness_mm < LARGEST_MM):
            raise InputError(
                f"depth_mm of a layer must be finite and thickness_mm 0 or above, within "
                f"{LARGEST_MM:g} mm, got {depth_mm} and {thickness_mm}."
            )
        if coverage is not None:
            coverage = _checked_cells(coverage, "coverage", cells.shape, most=1)
            if not opaque:
                raise InputError("coverage needs opaque=True, got opaque=False.")
        tau = as_numbers(optical_thickness, "optical_thickness")
        tau = np.full(cells.shape, tau) if tau.ndim == 0 else tau
        tau = _checked_cells(tau, "optical_thickness", cells.shape)
        if opaque and (thickness_mm or tau.any()):
            raise InputError(
                f"An opaque layer is a surface: thickness_mm and optical_thickness must be 0, "
                f"got {thickness_mm} and up to {tau.max():g}."
            )
        size, centre = _checked_pair(size_mm, "size_mm"), _checked_pair(centre_mm, "centre_mm")
        tilt = _checked_pair(tilt_deg, "tilt_deg")
        if max(map(abs, tilt)) > STEEPEST_DEG or all(tilt):
            raise InputError(
                f"tilt_deg must be two angles (about the horizontal, about the vertical axis) "
                f"within {STEEPEST_DEG} degrees, one of them 0, got {tilt}."
            )
        rows, columns = map(_cell_edges_mm, cells.shape, size, centre, tilt)
        if not (np.diff(rows).min() > 0 and np.diff(columns).min() > 0):
            raise InputError(
                f"size_mm of a layer must be from {SMALLEST_MM:g} to {LARGEST_MM:g} mm, and "
                f"its cells larger than the rounding of centre_mm, got {size} and {centre}."
            )
        leaning = [abs(math.sin(math.radians(a))) * b for a, b in zip(tilt, size, strict=True)]
        vars(self).update(  # a frozen dataclass refuses `self.texture = cells`
            texture=cells,
            depth_mm=depth_mm,
            size_mm=size,
            centre_mm=centre,
            opaque=opaque,
            coverage=coverage,
            optical_thickness=tau,
            thickness_mm=thickness_mm,
            tilt_deg=tilt,
            cell_edges_mm=(rows, columns),
            opacity=(1.0 if coverage is None else coverage) if opaque else 0.0,
            depth_extent_mm=thickness_mm + sum(leaning),
        )

    def extent_mm(self, cells: np.ndarray, axis: int) -> tuple[float, float]:
        """Start and end, in mm, of the nonzero cells along an axis; NaN if all are 0."""
        filled = np.flatnonzero(cells.any(axis=1 - axis))
        if filled.size == 0:
            return (np.nan, np.nan)
        edges = self.cell_edges_mm[axis]
        return (float(edges[filled[0]]), float(edges[filled[-1] + 1]))


def _cell_edges_mm(cells: int, size: float, centre: float, tilt: float) -> np.ndarray:
    """Edges of cells along an axis, as seen along the optical axis; NaN for an impossible size."""
    if not SMALLEST_MM < size < LARGEST_MM:
        return np.full(2, np.nan)
    seen = size * math.cos(math.radians(tilt))
    return centre - seen / 2 + np.arange(cells + 1) * (seen / cells)


def _checked_cells(
    values: ArrayLike, name: str, shape: tuple[int, ...] | None = None, most: float = np.inf
) -> np.ndarray:
    """Read-only float64 cells from an argument, checked."""
    cells = as_numbers(values, f"A layer's {name}")
    if cells.ndim != 2 or cells.size == 0:
        raise InputError(
            f"A layer's {name} must be a grey image with rows and columns, "
            f"got an array of shape {cells.shape}."
        )
    if shape is not None and cells.shape != shape:
        raise InputError(
            f"A layer's {name} must have the texture's shape {shape}, got {cells.shape}."
        )
    if not np.all(np.isfinite(cells)) or cells.min() < 0 or cells.max() > most:
        limit = f", at most {most:g}" if most < np.inf else ""
        raise InputError(
            f"A layer's {name} must be finite and not negative{limit}, "
            f"got values from {cells.min()} to {cells.max()}."
        )
    cells.flags.writeable = False
    return cells


def _checked_pair(values: ArrayLike, name: str) -> tuple[float, float]:
    pair = as_numbers(values, name)
    if pair.shape != (2,) or not np.isfinite(pair).all():
        raise InputError(f"{name} must be two finite numbers, got {values!r}.")
    return float(pair[0]), float(pair[1])


@dataclass(frozen=True, eq=False, init=False)
class Scene:
    """Layers with light that adds up, except where one occludes or attenuates another.

    Parameters
    ----------
    layers : sequence of Layer
        Layers in any order, at least one; stored as a tuple.

    Attributes
    ----------
    front_to_back : tuple of Layer
        Layers, nearest to the main lens first; at one depth, glowing before opaque ones.

    Raises
    ------
    InputError
        If there is no layer, or if two opaque layers at one depth overlap, so that neither is in
        front.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import PAPER_CAMERA, Layer, Scene, render
    >>> scene = Scene([Layer(np.ones((8, 8)), depth_mm=10.0, size_mm=(4.0, 4.0))])
    >>> render(scene, PAPER_CAMERA)
    LightField(15 x 15 views of 270 x 540 pixels, grey)
    """

    layers: tuple[Layer, ...]
    front_to_back: tuple[Layer, ...] = field(init=False)

    def __init__(self, layers: Sequence[Layer]):
        given, layers = layers, () if isinstance(layers, Layer) else tuple(layers)
        if not layers or not all(isinstance(layer, Layer) for layer in layers):
            raise InputError(f"A scene needs a list of layers, one or more, got {given!r:.100}.")
        ordered = sorted(layers, key=lambda layer: (layer.depth_mm, layer.opaque))
        vars(self).update(layers=layers, front_to_back=tuple(ordered))
        for (i, one), (j, other) in combinations(enumerate(self.layers, 1), 2):
            meet = one.opaque and other.opaque and one.depth_mm == other.depth_mm
            if meet and all(_overlap(one, other, axis) for axis in (0, 1)):
                raise InputError(
                    f"Layers {i} and {j} are both opaque, and their extents overlap at depth "
                    f"{one.depth_mm} mm: one of them must be in front, by 0.001 mm for example."
                )

    def at_depths(self, depths_mm: Iterable[float], camera: PlenopticCamera) -> Scene:
        """Scene with each layer moved to another depth and scaled to look the same at the centre.

        The central view stays the same, so that the scenes differ only in parallax and defocus.
        This holds for glowing sheets; a layer that occludes, absorbs or has a thickness also looks
        different at another distance.
        """
        return Scene(
            [
                replace(
                    layer,
                    depth_mm=float(depth),
                    size_mm=(layer.size_mm[0] * ratio, layer.size_mm[1] * ratio),
                    centre_mm=(layer.centre_mm[0] * ratio, layer.centre_mm[1] * ratio),
                )
                for layer, depth in zip(self.layers, depths_mm, strict=True)
                for ratio in [camera.field_mm(depth)[0] / camera.field_mm(layer.depth_mm)[0]]
            ]
        )

    def __repr__(self) -> str:
        depths = ", ".join(f"{layer.depth_mm:g}" for layer in self.layers[:8])
        more = ", ..." if len(self.layers) > 8 else ""
        return f"Scene(layers at {depths}{more} mm)"


def _overlap(one: Layer, other: Layer, axis: int) -> bool:
    (low, high), (other_low, other_high) = (
        layer.extent_mm(np.broadcast_to(layer.opacity, layer.texture.shape), axis)
        for layer in (one, other)
    )
    # Layers that only touch do not overlap, whatever the rounding of their edges.
    touch = 1e-12 * (abs(low) + abs(high))
    # The extent of a layer that covers nothing is NaN, which np.minimum keeps and min may not.
    return bool(np.minimum(high, other_high) - np.maximum(low, other_low) > touch)
