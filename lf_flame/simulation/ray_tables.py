"""What the ray kernel reads: tables of the planes, of the rays on them, and of each effect.

Numba takes these named tuples as they are. An image's pixel has its place along y in (a, c) and
along x in (b, d), as `lf_flame.simulation.layouts` has it; i and j count a pixel's rays along y
and x, p the planes from front to back, k the stops.
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
    """

    emission: np.ndarray
    transmission: np.ndarray | None
    first: np.ndarray
    stride: np.ndarray
    height: np.ndarray
    width: np.ndarray


class RayTable(NamedTuple):
    """Where the rays meet the planes.

    Attributes
    ----------
    rows, columns : ndarray of int32, shapes (p, a, c, i) and (p, b, d, j)
        Their sum is the cell of plane p in which the box of ray (i, j) begins. With a skew:
        float64, the middle of the box in cells of the plane without its border.
    heights, widths : ndarray of float64, shape (p,)
        Of a ray's box, in cells, at most 1.
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


class SkewTable(NamedTuple):
    """How far a rotated array shifts bundles along one axis, by their place on the other.

    Attributes
    ----------
    rows, columns : ndarray of float64, shapes (p, b, d) and (p, a, c)
        Shift down, and to the right, in cells of each plane.
    turned_rows, turned_columns : ndarray of float64, shapes (p, j) and (p, i)
        What the turn of each lenslet's own square adds, by the ray's place on the other axis.
    stop_rows, stop_columns : ndarray of float64, shapes (k, b, d) and (k, a, c)
        Shift down, and to the right, on each stop, in mm. (The turn of a lenslet's own square is
        a ten thousandth of a stop at most.)
    """

    rows: np.ndarray
    columns: np.ndarray
    turned_rows: np.ndarray
    turned_columns: np.ndarray
    stop_rows: np.ndarray
    stop_columns: np.ndarray


class StopTable(NamedTuple):
    """Round stops, and where the rays cross them.

    Attributes
    ----------
    rows, columns : ndarray of float64, shapes (k, a, c, i) and (k, b, d, j)
        In mm from the optical axis.
    radii : ndarray of float64, shape (k,)
        In mm.
    heights, widths : ndarray of float64, shape (k,)
        Of a ray's box, in mm.
    """

    rows: np.ndarray
    columns: np.ndarray
    radii: np.ndarray
    heights: np.ndarray
    widths: np.ndarray


class FalloffSkew(NamedTuple):
    """What a turned array adds to the tangents of the pixels' central rays.

    Attributes
    ----------
    rows, columns : ndarray of float64, shapes (b, d) and (a, c)
        To the tangents along y, and along x.
    patch : float
        Mean of the squared tangents over a pixel's patch of the main lens, from its middle.
    """

    rows: np.ndarray
    columns: np.ndarray
    patch: float


class FalloffTable(NamedTuple):
    """Tangents of the pixels' central rays behind the main lens, for cos^4.

    Attributes
    ----------
    rows, columns : ndarray of float64, shapes (a, c) and (b, d)
        Squared, with the patch in `rows`; with a skew, as they are.
    """

    rows: np.ndarray
    columns: np.ndarray


class SquareTable(NamedTuple):
    """Where the square micro-image of a lenslet ends, and the rays on a pixel.

    None where round stops end the micro-images.

    Attributes
    ----------
    half : float
        Half of its side, in mm.
    cosine, sine : float
        Of the angle by which it is turned.
    down, right : ndarray of float64, shapes (i,) and (j,)
        Middles of the rays' boxes on the sensor, from the pixel's, in mm.
    height, width : float
        Of a ray's box on the sensor, in mm.
    """

    half: float
    cosine: float
    sine: float
    down: np.ndarray
    right: np.ndarray
    height: float
    width: float


class MicroImageTable(NamedTuple):
    """Pixels that light can reach through the lenslet of a pass, where that is not all of them.

    Attributes
    ----------
    rows, columns : ndarray of float64, shapes (a, c) and (b, d)
        Places of the pixels from the middle of the micro-image, in mm.
    shift_rows, shift_columns : ndarray of float64, shapes (b, d) and (a, c)
        What a turned array adds to them.
    reach : float
        Along each axis no pixel farther off gets any light, in mm.
    """

    rows: np.ndarray
    columns: np.ndarray
    shift_rows: np.ndarray
    shift_columns: np.ndarray
    reach: float


class SeenTable(NamedTuple):
    """The pixels that can see anything at all.

    Attributes
    ----------
    lines : ndarray of bool, shape (a, c)
    first, last : ndarray of int64, shape (b,)
        First, and one past the last, place d.
    """

    lines: np.ndarray
    first: np.ndarray
    last: np.ndarray
