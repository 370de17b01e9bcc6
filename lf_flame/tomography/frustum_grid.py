"""Grid of cells for the emission: depth planes with cells that grow with their distance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from lf_flame._common.arrays import as_numbers
from lf_flame.errors import InputError
from lf_flame.optics.lens import Lens
from lf_flame.refocus._arguments import as_block
from lf_flame.scenes.scene import Layer, Scene

MOST_PLANES = 200
"""Largest number of depth planes; with more, the matrices by frequency fill the memory."""

FEWEST = 3
"""Smallest number of rows and of columns of views with which depth can be found."""

FEW_PLANES = 8
"""Largest number of planes that are treated as separate sheets; more planes sample a volume."""

NOT_MODELLED = ("rim_diameter_mm", "chromatic_shift", "lenslet_rotation_rad", "lenslet_pitch_error")
"""Properties of a camera with which views would be more than sums of shifted planes."""


@dataclass(frozen=True)
class FrustumGrid:
    """Depth planes of cells in front of a camera; a cell is a pixel of the central view.

    Every view therefore sees a plane as the central view does, shifted by the plane's slope for
    each view step, and blurred. The inversion relies on this.

    Parameters
    ----------
    camera : Lens
        Camera; with a round aperture, only views whose part of the lens is a whole square are used.
    depths_mm : sequence of float
        Depths of the planes in mm, from the zero of the camera (a `PlenopticCamera`: its focal
        plane); increasing or decreasing, all different.
    block : int, optional
        Number of lenslets along each axis that are averaged into one pixel, and into one cell.
    used_views : array_like of bool, shape (views, views), optional
        Views that are fitted; of these, the ones with a counterpart on the other side of the
        central view. Default: all that the aperture leaves whole.

    Attributes
    ----------
    used_views : ndarray of bool, shape (views, views), or None
        Views that are fitted; None if all are.

    Raises
    ------
    InputError
        If a depth cannot be used, the lenslets are not a multiple of the block, or the camera is
        not ideal.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from lf_flame import PAPER_CAMERA
    >>> from lf_flame.tomography import FrustumGrid
    >>> grid = FrustumGrid(replace(PAPER_CAMERA, views=5, lenslets=(32, 40)), [6.0, -6.0])
    >>> round(grid.cell_mm(6.0), 3)  # side of a cell
    0.134
    """

    camera: Lens
    depths_mm: Sequence[float]
    block: int = 1
    used_views: np.ndarray | None = field(default=None, repr=False, compare=False)
    slopes: np.ndarray = field(init=False, repr=False, compare=False)

    def __post_init__(self):
        depths = _checked_depths(self.depths_mm)
        self.camera.check_depths(depths)
        object.__setattr__(self, "depths_mm", tuple(depths.tolist()))
        object.__setattr__(self, "slopes", np.asarray(self.camera.depth_to_slope(depths)))
        as_block((self.block, self.block), self.camera.lenslets)
        _check_ideal(self.camera)
        object.__setattr__(self, "used_views", self._find_used_views())

    @property
    def seen_from(self) -> Lens:
        """Camera of as many views as are fitted, along the axis of fewer."""
        if self.used_views is None:
            return self.camera
        return self.camera.with_views(min(int(self.used_views.any(axis=k).sum()) for k in (0, 1)))

    def _find_used_views(self) -> np.ndarray | None:
        whole = self.camera.whole_views()
        stated = whole if self.used_views is None else as_numbers(self.used_views, "used_views")
        if stated.shape != whole.shape:
            raise InputError(f"used_views must be of shape {whole.shape}, got {stated.shape}.")
        used_views = whole & stated.astype(bool)
        used_views = used_views & used_views[::-1, ::-1]
        spans = [int(used_views.any(axis=axis).sum()) for axis in (1, 0)]
        if min(spans) < min(FEWEST, self.camera.views):
            raise InputError(
                f"A fit needs whole views in {FEWEST} rows and {FEWEST} columns or more, got "
                f"{spans[0]} and {spans[1]}: the others have weight 0, or the aperture cuts them."
            )
        return None if used_views.all() else used_views

    @property
    def view_count(self) -> int:
        """Number of views that are fitted."""
        return self.camera.views**2 if self.used_views is None else int(self.used_views.sum())

    @property
    def data_shape(self) -> tuple[int, int, int, int]:
        """Shape of the fitted views: (v, u, t, s), or one after the other, (n, 1, t, s)."""
        views = (self.camera.views,) * 2 if self.used_views is None else (self.view_count, 1)
        return (*views, *self.pixels)

    def pick(self, views: np.ndarray) -> np.ndarray:
        """Pick the views that are fitted from all, in the shape `data_shape`."""
        return views if self.used_views is None else views[self.used_views][:, None]

    def place(self, picked: np.ndarray, missing: float = 0.0) -> np.ndarray:
        """Place picked views, or one number for each, among all, the opposite of `pick`."""
        if self.used_views is None:
            return picked
        views = np.full((*self.used_views.shape, *picked.shape[2:]), missing, picked.dtype)
        views[self.used_views] = picked[:, 0]
        return views

    def view_groups(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Rows of views that fit the same columns, and these: indices, together each view once."""
        if self.used_views is None:
            every = np.arange(self.camera.views)
            return [(every, every)]
        columns, group = np.unique(self.used_views, axis=0, return_inverse=True)
        return [
            (np.flatnonzero(group.ravel() == k), np.flatnonzero(one))
            for k, one in enumerate(columns)
            if one.any()
        ]

    @property
    def pixels(self) -> tuple[int, int]:
        """Number of rows and columns of a view, in blocks of lenslets."""
        rows, columns = (count // self.block for count in self.camera.lenslets)
        return rows, columns

    @cached_property
    def reach(self) -> int:
        """Largest number of cells from a pixel to a cell that some view sees there."""
        steepest = float(np.abs(self.slopes).max())
        lenslets = steepest * (self.camera.views - 1) / 2 + (1 + steepest) / 2
        return int(np.ceil(lenslets / self.block)) + 1

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of planes, rows and columns of cells: all that any view sees."""
        rows, columns = (count + 2 * self.reach for count in self.pixels)
        return len(self.depths_mm), rows, columns

    def crop(self, cells: np.ndarray) -> np.ndarray:
        """Cut the last two axes of cells to the field of the central view."""
        return cells[..., self.reach : -self.reach, self.reach : -self.reach]

    def cell_mm(self, depth_mm: float) -> float:
        """Side of a cell at a depth, in mm."""
        rows_mm, _ = self.camera.field_mm(depth_mm)
        return rows_mm / self.pixels[0]

    def edges_mm(self, plane: int, axis: int) -> np.ndarray:
        """Edges of a plane's cells along an axis, in mm from the optical axis."""
        count = self.shape[1 + axis]
        return (np.arange(count + 1) - count / 2) * self.cell_mm(self.depths_mm[plane])

    def empty_layer(self, plane: int, finer: int = 1) -> Layer:
        """Layer of a scene with a plane's cells, or finer ones along each axis, without light."""
        depth = self.depths_mm[plane]
        cells = np.zeros([finer * count for count in self.shape[1:]])
        side = self.cell_mm(depth)
        return Layer(cells, depth, (side * self.shape[1], side * self.shape[2]))

    def scene(self, cells: ArrayLike) -> Scene:
        """Scene with the emission of cells, (planes, rows, columns), constant over each."""
        sides = (self.cell_mm(depth) for depth in self.depths_mm)
        return Scene(
            [
                Layer(plane, depth, (side * self.shape[1], side * self.shape[2]))
                for plane, depth, side in zip(np.asarray(cells), self.depths_mm, sides, strict=True)
            ]
        )

    def average(self, layer: Layer, plane: int) -> np.ndarray:
        """Average a layer over the cells of a plane, as if it were at that plane's depth."""
        down = _shares(layer.cell_edges_mm[0], self.edges_mm(plane, 0))
        across = _shares(layer.cell_edges_mm[1], self.edges_mm(plane, 1))
        return down @ layer.texture @ across.T


def _checked_depths(depths_mm: Sequence[float]) -> np.ndarray:
    depths = np.atleast_1d(as_numbers(depths_mm, "depths_mm"))
    if depths.ndim != 1 or not 1 <= depths.size <= MOST_PLANES or not np.isfinite(depths).all():
        raise InputError(
            f"depths_mm must be 1 to {MOST_PLANES} finite depths in mm, got {depths_mm}."
        )
    steps = np.diff(depths)
    if not (np.all(steps > 0) or np.all(steps < 0)):
        raise InputError(
            f"depths_mm must increase or decrease, no two equal: planes at one depth cannot be "
            f"separated; got {depths.tolist()}."
        )
    return depths


def _shares(edges: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Fraction of each wanted cell that each given cell covers, shape (wanted, given)."""
    low = np.maximum(edges[None, :-1], wanted[:-1, None])
    high = np.minimum(edges[None, 1:], wanted[1:, None])
    return np.clip(high - low, 0, None) / np.diff(wanted)[:, None]


def _check_ideal(camera: Lens) -> None:
    """Refuse a camera whose views are not sums of shifted planes."""
    for name in NOT_MODELLED:
        if getattr(camera, name, None):
            raise InputError(
                f"Emission by depth needs a camera without {name} (got "
                f"{getattr(camera, name)}): its views are not sums of shifted planes."
            )
    if not getattr(camera, "falloff_corrected", True):
        raise InputError(
            "Emission by depth needs images divided by a white image (falloff_corrected)."
        )


def planes_between(from_mm: float, to_mm: float, step_mm: float) -> Sequence[float]:
    """Depths of evenly spaced planes, both ends included; the step must divide their distance."""
    if not (np.isfinite([from_mm, to_mm, step_mm]).all() and step_mm > 0):
        raise InputError(
            f"Depths need finite ends and a step above 0 mm, got {from_mm}, {to_mm}, {step_mm}."
        )
    steps = abs(to_mm - from_mm) / step_mm
    if not steps < MOST_PLANES:
        raise InputError(
            f"Depths must be at most {MOST_PLANES} planes, got {from_mm:g} to {to_mm:g} mm in "
            f"steps of {step_mm:g} mm."
        )
    count = round(steps)
    if abs(count * step_mm - abs(to_mm - from_mm)) > 1e-6 * step_mm:
        raise InputError(
            f"The step of {step_mm} mm must divide the distance from {from_mm} to {to_mm} mm."
        )
    return [float(depth) for depth in np.linspace(from_mm, to_mm, count + 1)]
