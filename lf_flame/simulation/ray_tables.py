"""Tables that the ray kernels read: the planes, the rays on them, and each effect.

Numba takes these named tuples as they are. In their shapes (a, c) is the place of a pixel along y
and (b, d) along x, as in `lf_flame.simulation.optical_pass`: a and b count views, c and d rows and
columns. i and j count a pixel's rays along y and x, p the planes from front to back, k the stops.
"""

from typing import NamedTuple

import numpy as np


class PlaneTable(NamedTuple):
    """The cells of all planes, one plane behind the other in memory.

    Attributes
    ----------
    emission : ndarray of float64, shape (all cells,)
        Each plane row by row, with a border of one cell around it in which there is nothing, for
        the rays that miss it.
    transmission : ndarray of float64, shape (all cells,), or None
        Share of the light from behind that a cell lets pass, 1 in the border; None where the
        light of one plane only adds.
    first, stride : ndarray of int64, shape (p,)
        First cell of a plane, and its cells in a row, borders included.
    height, width : ndarray of int64, shape (p,)
        Rows and columns of a plane without its border.
    down, right : ndarray of float64, shapes (p, a, c) and (p, b, d)
        Factors of a plane's light in each pixel: of strips of a sheet that leans, else 1.
    sheet : ndarray of int64, shape (p,)
        Number of the sheet of which a plane is a strip, from 1 on; 0 for other planes.
    """

    emission: np.ndarray
    transmission: np.ndarray | None
    first: np.ndarray
    stride: np.ndarray
    height: np.ndarray
    width: np.ndarray
    down: np.ndarray
    right: np.ndarray
    sheet: np.ndarray


class RayTable(NamedTuple):
    """Where the rays meet the planes.

    Attributes
    ----------
    rows, columns : ndarray of int32, shapes (p, a, c, i) and (p, b, d, j)
        Their sum is the cell of plane p in which the box of ray (i, j) begins. With shifts:
        float64, the middle of the box in cells of the plane without its border.
    heights, widths : ndarray of float64, shape (p,)
        Size of a ray's box, in cells, at most 1.
    """

    rows: np.ndarray
    columns: np.ndarray
    heights: np.ndarray
    widths: np.ndarray


class WeightTable(NamedTuple):
    """Weights of the next cells in the boxes of finite-width rays.

    Attributes
    ----------
    down, right : ndarray of float64, shapes (p, a, c, i) and (p, b, d, j)
        Share of a ray's box that lies on the cell below, and on that to the right, of the one in
        which it begins.
    """

    down: np.ndarray
    right: np.ndarray


class ShiftTable(NamedTuple):
    """Shifts of bundles by lenslets that are not where the sensor is read.

    Attributes
    ----------
    rows, columns : ndarray of float64, shapes (p, b, d) and (p, a, c)
        Shift down, and to the right, by a turned array, in cells of each plane: by the lenslet's
        place on the other axis.
    turned_rows, turned_columns : ndarray of float64, shapes (p, j) and (p, i)
        Further shift by the turn of each lenslet's own square, by the ray's place on that axis.
    pitch_rows, pitch_columns : ndarray of float64, shape (p,)
        Shift for each lenslet pitch, in cells.
    stop_rows, stop_columns : ndarray of float64, shapes (k, b, d) and (k, a, c)
        Shift down, and to the right, on each stop, in mm. (The turn of a lenslet's own square is
        a ten thousandth of a stop at most.)
    stop_pitch : ndarray of float64, shape (k,)
        Shift for each lenslet pitch, in mm.
    """

    rows: np.ndarray
    columns: np.ndarray
    turned_rows: np.ndarray
    turned_columns: np.ndarray
    pitch_rows: np.ndarray
    pitch_columns: np.ndarray
    stop_rows: np.ndarray
    stop_columns: np.ndarray
    stop_pitch: np.ndarray


class StopTable(NamedTuple):
    """A round stop, and the places where rays cross it.

    Attributes
    ----------
    rows, columns : ndarray of float64, shapes (a, c, i) and (b, d, j)
        Places of the rays, in mm from the optical axis.
    radius : float
        Radius in mm.
    height, width : float
        Size of a ray's box in mm; below 0 where it lies upside down.
    """

    rows: np.ndarray
    columns: np.ndarray
    radius: float
    height: float
    width: float


class FalloffTable(NamedTuple):
    """Squared tangents of the pixels' central rays behind the main lens, for cos^4.

    Attributes
    ----------
    rows, columns : ndarray of float64, shapes (a, c) and (b, d)
    patch : float
        Mean of the squared tangents over a pixel's patch of the main lens, from its middle.
    """

    rows: np.ndarray
    columns: np.ndarray
    patch: float


class RayFalloffTable(NamedTuple):
    """Tangents of the rays behind the main lens, for cos^4.

    Attributes
    ----------
    rows, columns : ndarray of float64, shapes (a, c) and (b, d)
        Tangents of the pixels' central rays.
    down, right : ndarray of float64, shapes (i,) and (j,)
        Difference of each ray's tangent from the central ray's.
    patch : float
        Mean of the squared tangents over a ray's patch of the main lens, from its middle.
    """

    rows: np.ndarray
    columns: np.ndarray
    down: np.ndarray
    right: np.ndarray
    patch: float


class TiltTable(NamedTuple):
    """Change of the rays' tangents by lenslets that are not where the sensor is read.

    Attributes
    ----------
    rows, columns : ndarray of float64, shapes (b, d) and (a, c)
        Change along y, and along x, by a turned array.
    pitch : float
        Change for each lenslet pitch.
    """

    rows: np.ndarray
    columns: np.ndarray
    pitch: float


class MicroImageTable(NamedTuple):
    """Places of pixels on the sensor, for light through every lenslet that can send them any.

    Attributes
    ----------
    rows, columns : ndarray of float64, shapes (a, c) and (b, d)
        Places of the pixels from the middle of their lenslet's micro-image, in the pitch of the
        micro-images.
    shift_rows, shift_columns : ndarray of float64, shapes (b, d) and (a, c)
        Change of these places by a turned array.
    cosine, sine : float
        Cosine and sine of the angle by which the array is turned.
    reach : float
        Largest distance, along an axis of the array, at which a pixel gets any light.
    """

    rows: np.ndarray
    columns: np.ndarray
    shift_rows: np.ndarray
    shift_columns: np.ndarray
    cosine: float
    sine: float
    reach: float


class SquareTable(NamedTuple):
    """Rays on a pixel where micro-images are squares; None where round stops end them.

    Attributes
    ----------
    down, right : ndarray of float64, shapes (i,) and (j,)
        Middles of the rays' boxes on the sensor, from the pixel's, in the pitch of the
        micro-images.
    height, width : float
        Size of a ray's box on the sensor.
    pixel : float
        Width of a pixel.
    """

    down: np.ndarray
    right: np.ndarray
    height: float
    width: float
    pixel: float


class LensletTables(NamedTuple):
    """Tables of the kernel for light through every lenslet that can send a pixel any.

    Attributes
    ----------
    planes : PlaneTable
    rays : RayTable
    shifts : ShiftTable
    stop, second : StopTable, or None
        The first and the second round stop.
    micro_images : MicroImageTable
    squares : SquareTable, or None
    falloff : RayFalloffTable, or None
    tilt : TiltTable, or None
    """

    planes: PlaneTable
    rays: RayTable
    shifts: ShiftTable
    stop: StopTable | None
    second: StopTable | None
    micro_images: MicroImageTable
    squares: SquareTable | None
    falloff: RayFalloffTable | None
    tilt: TiltTable | None


class SeenTable(NamedTuple):
    """Pixels that see at least one plane.

    Attributes
    ----------
    lines : ndarray of bool, shape (a, c)
    first, last : ndarray of int64, shape (b,)
        First, and one past the last, place d.
    """

    lines: np.ndarray
    first: np.ndarray
    last: np.ndarray
