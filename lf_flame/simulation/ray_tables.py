"""Tables of rays that the kernels read, and the rays of all bundles along one axis.

Numba takes these named tuples as they are. In their shapes (a, c) is the position of a pixel along
y and (b, d) along x, as in `lf_flame.simulation.optical_pass`: a and b count views, c and d rows
and columns. i and j count a pixel's rays along y and x, p the planes from front to back, k the
stops. Arrays are float64 where nothing else is said.
"""

from typing import NamedTuple

import numpy as np


class PlaneTable(NamedTuple):
    """The cells of all planes, one plane behind the other in memory, row by row.

    Around each plane there is a border of one cell, for the rays that miss it: it emits nothing and
    lets all light pass.
    """

    emission: np.ndarray  # (all cells,)
    transmission: np.ndarray | None  # (all cells,); None where the light of one plane only adds
    first: np.ndarray  # int64, (p,): first cell of a plane
    stride: np.ndarray  # int64, (p,): its cells in a row, borders included
    height: np.ndarray  # int64, (p,): its rows without the border
    width: np.ndarray  # int64, (p,): its columns without the border
    # Factors of a plane's light through the pixels' own lenslets: of strips that lean, else 1.
    down: np.ndarray  # (p, a, c)
    right: np.ndarray  # (p, b, d)
    sheet: np.ndarray  # int64, (p,): sheet of which a plane is a strip, from 1 on; 0 for others


class RayTable(NamedTuple):
    """Where the rays meet the planes.

    The sum of row and column is the cell of plane p in which the box of ray (i, j) begins. With
    shifts they are the centre of the box, in cells of the plane without its border.
    """

    rows: np.ndarray  # int32, or float64 with shifts, (p, a, c, i)
    columns: np.ndarray  # the same, (p, b, d, j)
    heights: np.ndarray  # (p,): size of a ray's box in cells, at most 1
    widths: np.ndarray  # (p,)


class WeightTable(NamedTuple):
    """Share of a ray's box on the cells below, and to the right of, that in which it begins."""

    down: np.ndarray  # (p, a, c, i)
    right: np.ndarray  # (p, b, d, j)


class ShiftTable(NamedTuple):
    """Shifts of bundles by lenslets that are not where the sensor is read."""

    # Displacement of lenslets by a rotated array, by their position on the other axis, in mm.
    rows: np.ndarray  # (b, d)
    columns: np.ndarray  # (a, c)
    pitch: float  # the lenslets', in mm
    # For each mm, in cells of each plane, and of the factor of strips of a sheet that leans.
    plane_rows: np.ndarray  # (p,)
    plane_columns: np.ndarray  # (p,)
    lean_rows: np.ndarray  # (p,)
    lean_columns: np.ndarray  # (p,)
    # By the rotation of each lenslet's own square: by the ray's position on the other axis. (On
    # stops it is at most a ten thousandth of the stop.)
    turned_rows: np.ndarray  # (p, j)
    turned_columns: np.ndarray  # (p, i)
    stops: np.ndarray  # (k,): in mm on each stop, for each mm


class StopTable(NamedTuple):
    """A round stop, and the positions where rays cross it, in mm from the optical axis."""

    rows: np.ndarray  # (a, c, i)
    columns: np.ndarray  # (b, d, j)
    radius: float
    height: float  # of a ray's box; below 0 where it is inverted
    width: float


class RayFalloffTable(NamedTuple):
    """Tangents of the rays behind the main lens, for cos^4."""

    rows: np.ndarray  # (a, c), of the pixels' central rays
    columns: np.ndarray  # (b, d)
    down: np.ndarray  # (i,): difference of each ray's tangent from the central ray's
    right: np.ndarray  # (j,)
    patch: float  # mean of the squares over a ray's patch of the main lens, from its centre


class TiltTable(NamedTuple):
    """Change of the rays' tangents by lenslets that are not where the sensor is read."""

    rows: np.ndarray  # (b, d), by a rotated array
    columns: np.ndarray  # (a, c)
    pitch: float  # for each lenslet pitch


class MicroImageTable(NamedTuple):
    """Positions of pixels on the sensor, for light through every lenslet that can light them.

    From the centre of their lenslet's micro-image, in the pitch of the micro-images.
    """

    rows: np.ndarray  # (a, c)
    columns: np.ndarray  # (b, d)
    shift_rows: np.ndarray  # (b, d): change by a rotated array
    shift_columns: np.ndarray  # (a, c)
    cosine: float  # of the angle by which the array is rotated
    sine: float
    reach: float  # largest distance, along an axis of the array, at which a pixel gets any light


class SquareTable(NamedTuple):
    """Rays on a pixel where micro-images are squares, in the pitch of the micro-images."""

    down: np.ndarray  # (i,): centres of the rays' boxes on the sensor, from the pixel's
    right: np.ndarray  # (j,)
    height: float  # of a ray's box on the sensor
    width: float
    pixel: float  # width of a pixel


class LensletTables(NamedTuple):
    """Tables of the kernel for light through every lenslet that can light a pixel."""

    planes: PlaneTable
    rays: RayTable
    shifts: ShiftTable
    stop: StopTable | None
    second: StopTable | None
    micro_images: MicroImageTable
    squares: SquareTable | None  # None where round stops end the micro-images
    falloff: RayFalloffTable | None
    tilt: TiltTable | None


class SeenTable(NamedTuple):
    """Pixels that see at least one plane."""

    lines: np.ndarray  # bool, (a, c)
    first: np.ndarray  # int64, (b,): first position d
    last: np.ndarray  # int64, (b,): one past the last


class Tiling(NamedTuple):
    """Positions of the rays on a pixel and on its lenslet, in widths of each, -1/2 to 1/2."""

    along_pixel: np.ndarray  # (i,)
    along_lenslet: np.ndarray  # (i,)
    on_pixel: int  # number of tiles
    on_lenslet: int


class PlaneRays(NamedTuple):
    """Rays on planes along one axis; p counts the planes, other letters as in `RayGrid`."""

    edges_mm: tuple[np.ndarray, ...]  # of cells: the layer's, or wider if finer than a ray's box
    positions: np.ndarray  # (p, e, f, i): centres of the rays' boxes, in cells from the first edge
    boxes: np.ndarray  # (p,): breadth of a ray's box in cells, 0 to 1
    gains: np.ndarray  # (p,): shift of bundles in cells, per mm by which their lenslets move
    lenslet_cells: np.ndarray  # (p,): image of the lenslet, signed as the rays' positions on it
    cells: np.ndarray  # (p,): number of cells of each plane


class StopRays(NamedTuple):
    """Rays on stops along one axis; k counts the stops, other letters as in `RayGrid`."""

    places_mm: list[np.ndarray]  # [k], (e, f, i): centres of the rays' boxes
    boxes_mm: list[float]  # [k]: breadth of a ray's box, below 0 where it is inverted
    gains: np.ndarray  # (k,): shift of bundles per shift of their lenslets


class RayGrid(NamedTuple):
    """Rays of all bundles along one axis, on planes and stops, in the order of an image.

    They tile the bundle's two widths, over the pixel and over the lenslet. A ray's box has the
    tile's variance, so that all boxes together have the mean and the variance of the trapezoid.
    In the shapes of its tables e and f are the image's axes along this one, (a, c) or (b, d), and i
    counts the rays.
    """

    planes: PlaneRays
    stops: StopRays
    seen: np.ndarray  # bool, (e, f): whether a pixel can see any of the planes
    tiling: Tiling
    rays: int  # number of rays of each pixel
