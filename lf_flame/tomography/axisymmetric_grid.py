"""Nodes for the emission of a flame that is axisymmetric about an upright axis.

The unknown is a half section: emission by height and distance from the axis, linear between nodes.
The flame is cut into slabs along the line of sight, which makes it a stack of layers; the views of
layers are the closed-form integral with which scenes are rendered. A node's emission is a product
of a function of height and one of radius, and both stay separate. Therefore the operator is two
small matrices for each slab, and its Gram matrix is a short sum of Kronecker products.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy import sparse

from lf_flame.errors import InputError
from lf_flame.optics.lens import Lens
from lf_flame.scenes.scene import Layer
from lf_flame.tomography.frustum_grid import MOST_PLANES, FrustumGrid
from lf_flame.tomography.projection_operator import layer_bands

PARALLAX = 0.25
"""Largest displacement in any view between a slab's faces and its centre, in cells."""

FINE = 3
"""Number of cells of a layer between two nodes; emission is constant over a cell."""

SAMPLES = 4
"""Number of points across a cell at which a node's emission is averaged."""

PARTS = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5

MOST_NODES = 40_000
"""Largest number of nodes of the half section; with more, its matrices fill the memory."""

WHICH_VIEWS = ("all", "central")


@dataclass(frozen=True)
class AxisymmetricGrid:
    """Nodes of the half section of a flame that is axisymmetric about an upright axis.

    Parameters
    ----------
    camera : Lens
        Camera, as for `FrustumGrid`.
    axis_mm : float
        Position of the axis across, from the optical axis, in mm.
    depth_mm : float
        Depth of the axis in mm, from the zero of the camera.
    radius_mm : float
        Radius that contains all emission, in mm.
    block : int, optional
        Number of lenslets along each axis that are averaged into one pixel; also the distance of
        nodes at the axis.
    which : {"all", "central"}, optional
        Views to use.
    burner_mm : float, optional
        Height from the optical axis, upwards, below which there is no emission: a flame ends
        sharply at its burner, and a smooth section could not. Default: no burner.
    finer : int, optional
        Number of steps between nodes for each pixel, for a flame that is known in detail.
    used_views : array_like of bool, shape (views, views), optional
        Views that are fitted, as for `FrustumGrid`. Default: all that the aperture leaves whole.

    Raises
    ------
    InputError
        If a value cannot be used.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from lf_flame import PAPER_CAMERA
    >>> from lf_flame.tomography import AxisymmetricGrid
    >>> camera = replace(PAPER_CAMERA, views=3, lenslets=(24, 40))
    >>> grid = AxisymmetricGrid(camera, axis_mm=0.0, depth_mm=0.0, radius_mm=1.5)

    >>> grid.shape == (len(grid.heights_mm), len(grid.radii_mm))
    True
    """

    camera: Lens
    axis_mm: float
    depth_mm: float
    radius_mm: float
    block: int = 1
    which: str = "all"
    burner_mm: float | None = None
    finer: int = 1
    used_views: np.ndarray | None = field(default=None, repr=False, compare=False)

    def __post_init__(self):
        if self.which not in WHICH_VIEWS:
            raise InputError(f"which must be one of {WHICH_VIEWS}, got {self.which!r}.")
        if not self.finer >= 1 or self.finer % 1:
            raise InputError(f"finer must be a whole number, 1 or more, got {self.finer!r}.")
        if not np.isfinite([self.axis_mm, self.depth_mm, self.radius_mm]).all():
            raise InputError(
                f"Axis, depth and radius must be finite, got {self.axis_mm}, {self.depth_mm}, "
                f"{self.radius_mm} mm."
            )
        object.__setattr__(self, "used_views", self._middle.used_views)
        half_width = self.pixel_mm * self._middle.shape[2] / 2
        if abs(self.axis_mm) >= half_width:
            raise InputError(
                f"The axis must lie within the field, {half_width:.3g} mm to either side, got "
                f"{self.axis_mm} mm."
            )
        widest = min(2 * half_width, self.camera.distance_mm(self.depth_mm) / 2)
        if not 4 * self.pixel_mm <= self.radius_mm <= widest:
            raise InputError(
                f"radius_mm must be at least four pixels, {4.001 * self.pixel_mm:.5g} mm, and at "
                f"most the field's width, {widest:.4g} mm, got {self.radius_mm}."
            )
        top = self._highest_mm
        if self.burner_mm is not None and not -top < self.burner_mm < top - 4 * self.pixel_mm:
            raise InputError(
                f"burner_mm must be within the field, {-top:.3g} to {top - 4 * self.pixel_mm:.3g} "
                f"mm from the optical axis, got {self.burner_mm}."
            )
        (heights, radii), slabs = self.shape, len(self.slab_depths_mm)
        if heights * radii > MOST_NODES * self.finer**2 or slabs > MOST_PLANES:
            raise InputError(
                f"{heights} heights x {radii} radii in {slabs} slabs are more than {MOST_NODES} "
                f"nodes or {MOST_PLANES} slabs: take larger blocks, or a smaller radius."
            )

    @cached_property
    def _middle(self) -> FrustumGrid:
        return FrustumGrid(self.camera, [self.depth_mm], self.block, self.used_views)

    @cached_property
    def pixel_mm(self) -> float:
        """Side of a pixel at the axis, in mm."""
        return self._middle.cell_mm(self.depth_mm)

    @property
    def step_mm(self) -> float:
        """Distance between nodes in mm, along height and radius: one pixel, or a part of it."""
        return self.pixel_mm / self.finer

    @property
    def _highest_mm(self) -> float:
        """Height in mm of the highest cells that any view sees at the axis."""
        return self.pixel_mm * (self._middle.shape[1] - 1) / 2

    @cached_property
    def slab_depths_mm(self) -> Sequence[float]:
        """Depths of the slabs' centres in mm, nearest last."""
        # The most oblique ray: from the edge of the aperture to the edge of the field or flame.
        aperture = self.camera.views * self.camera.view_step_mm
        farthest = max(self._highest_mm, abs(self.axis_mm) + self.radius_mm)
        slope = (aperture / 2 + farthest) / self.camera.distance_mm(self.depth_mm)
        reach = len(self.radii_mm) * self.step_mm  # where the outermost node's emission ends
        count = max(1, int(np.ceil(reach * slope / (PARALLAX * self.pixel_mm))))
        edges = np.linspace(reach, -reach, count + 1)
        return tuple((self.depth_mm + (edges[1:] + edges[:-1]) / 2).tolist())

    def empty_slab(self, depth_mm: float) -> Layer:
        """Cells of a slab without light, from the burner, or from below all views, upwards."""
        rows, columns = len(self._cell_heights_mm), len(self._cell_places_mm)
        cell = self.step_mm / FINE
        down = -(self._cell_heights_mm[0] + self._cell_heights_mm[-1]) / 2
        size = (rows * cell, columns * cell)
        return Layer(np.zeros((rows, columns)), depth_mm, size, (float(down), self.axis_mm))

    @cached_property
    def _cell_heights_mm(self) -> np.ndarray:
        """Heights of the cells' centres in mm, the highest first."""
        below = FINE if self.burner_mm is None else 0
        count = (len(self.heights_mm) - 1) * FINE + FINE + below
        top = self.heights_mm[0] + self.step_mm
        return top - (np.arange(count) + 0.5) * self.step_mm / FINE

    @cached_property
    def _cell_places_mm(self) -> np.ndarray:
        """Positions of the cells' centres across in mm, from the axis."""
        count = 2 * FINE * len(self.radii_mm)
        return (np.arange(count) - (count - 1) / 2) * self.step_mm / FINE

    @cached_property
    def heights_mm(self) -> np.ndarray:
        """Heights of the nodes from the optical axis, in mm, the highest first."""
        top = self._highest_mm
        lowest = -top if self.burner_mm is None else self.burner_mm
        pixels = int(np.ceil((top - lowest) / self.pixel_mm - 1e-9))
        return lowest + np.arange(pixels * self.finer + 1)[::-1] * self.step_mm

    @cached_property
    def radii_mm(self) -> np.ndarray:
        """Radii of the nodes in mm; emission is 0 at the next radius."""
        pixels = int(np.ceil(self.radius_mm / self.pixel_mm - 1e-9))
        return np.arange(pixels * self.finer) * self.step_mm

    @property
    def shape(self) -> tuple[int, int]:
        """Number of heights and radii."""
        return len(self.heights_mm), len(self.radii_mm)

    @property
    def data_shape(self) -> tuple[int, int, int, int]:
        """Shape of the views that are used: (v, u, t, s), or one after the other, (n, 1, t, s)."""
        if self.which == "all":
            return self._middle.data_shape
        return (1, 1, *self._middle.pixels)

    @property
    def view_count(self) -> int:
        """Number of views that are used."""
        return self._middle.view_count if self.which == "all" else 1

    def pick(self, views: np.ndarray) -> np.ndarray:
        """Select the views that are used, in the shape `data_shape`."""
        if self.which == "all":
            return self._middle.pick(views)
        if views.shape[:2] == (1, 1):
            return views
        middle = self.camera.views // 2
        return views[middle : middle + 1, middle : middle + 1]

    def place(self, picked: np.ndarray, missing: float = 0.0) -> np.ndarray:
        """Place picked views, or one number for each, among all rows and columns of views."""
        return self._middle.place(picked, missing) if self.which == "all" else picked

    def view_groups(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Group view rows that use the same view columns: index arrays, together each view once."""
        one = np.zeros(1, int)
        return self._middle.view_groups() if self.which == "all" else [(one, one)]

    @cached_property
    def by_height(self) -> list[sparse.csr_array]:
        """Contribution of each node's height to a pixel row of a view row, for each slab.

        Each of float64, shape (views * rows, heights).
        """
        return [self.bands(depth, 0) @ self.cells_by_height for depth in self.slab_depths_mm]

    @cached_property
    def cells_by_height(self) -> sparse.csr_array:
        """Contribution of each node's height to a row of a slab's cells, (cells, heights)."""
        place = (self.heights_mm[0] - self._cell_heights_mm) / self.step_mm
        return _linear_weights(place, len(self.heights_mm))

    @cached_property
    def by_radius(self) -> np.ndarray:
        """Contribution of each node's radius to a pixel column of a view column, for each slab.

        Lengths in mm along the line of sight, float64, shape (slabs, views * columns, radii).
        """
        return np.stack(
            [self.bands(depth, 1) @ self.cells_by_radius(depth) for depth in self.slab_depths_mm]
        )

    def bands(self, depth: float, axis: int) -> sparse.csr_array:
        """Contribution of a slab's cells to the used views, along y (axis 0) or x (axis 1)."""
        bands = layer_bands(self.empty_slab(depth), self.camera, self.block, axis)
        if self.which == "all":
            return bands
        pixels = self._middle.pixels[axis]
        first = self.camera.views // 2 * pixels
        return bands[first : first + pixels]

    def cells_by_radius(self, depth: float) -> np.ndarray:
        """Integrate each node's emission over a slab's thickness, averaged over its cells across.

        Float64, shape (cells, radii). The integral along depth is exact for any slab thickness:
        between two nodes emission is linear in the radius, which has a closed integral.
        """
        across = (self._cell_places_mm[:, None] / self.step_mm + PARTS / FINE).ravel()
        slab_mm = 2 * len(self.radii_mm) * self.step_mm / len(self.slab_depths_mm)
        middle, half = (depth - self.depth_mm) / self.step_mm, slab_mm / 2 / self.step_mm
        cones = _cones_to(middle + half, across, len(self.radii_mm))
        cones -= _cones_to(middle - half, across, len(self.radii_mm))
        # A node's emission is the second difference of three cones.
        nodes = np.diff(cones, 2, axis=1).reshape(-1, SAMPLES, len(self.radii_mm))
        return nodes.mean(axis=1) * self.step_mm


def _cones_to(depth: float, across: np.ndarray, nodes: int) -> np.ndarray:
    """Integrate cones max(0, k - r) along depth, starting at the axis, at positions across.

    For k from -1 to `nodes`, float64, shape (places, nodes + 2); a cone is never below 0.
    """
    x = np.abs(across)[:, None]
    edge = np.arange(-1.0, nodes + 1)
    end = np.minimum(abs(depth), np.sqrt(np.clip(np.square(edge.clip(0)) - x**2, 0, None)))
    under = end * np.hypot(x, end) + x**2 * np.arcsinh(end / np.maximum(x, 1e-300))
    return np.sign(depth) * (edge * end - under / 2)


def _linear_weights(places: np.ndarray, nodes: int) -> sparse.csr_array:
    """Functions, linear between nodes 0, 1, 2, ... and 0 past the ends, at positions.

    float64, shape (places, nodes).
    """
    low = np.floor(places).astype(int)
    entries = []
    for node, share in ((low, low + 1 - places), (low + 1, places - low)):
        inside = (node >= 0) & (node < nodes)
        entries.append((share[inside], np.flatnonzero(inside), node[inside]))
    values, rows, columns = (np.concatenate(parts) for parts in zip(*entries, strict=True))
    return sparse.coo_array((values, (rows, columns)), shape=(len(places), nodes)).tocsr()
