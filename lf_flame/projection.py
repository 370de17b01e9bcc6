"""Refocused images directly from a scene, without a light field.

Where light only adds, the map from scene to image is linear and separable. A plane with cells of
radiance ``X`` gives view (v, u) as ``K[v] X K[u]'`` (`lf_flame.simulation.integration`);
shift-and-sum shifts and averages lines of K, and blocks average them again. A refocused image is
therefore ``B X B'``, with ``B`` the mean over v of ``K[v]``, shifted by ``slope (v - vc)`` and
averaged over blocks. Both B are narrow bands, and no light field is formed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from lf_flame._common.arrays import centred
from lf_flame._common.threads import parallel
from lf_flame.errors import InputError
from lf_flame.lightfield import as_view_weights
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.refocus._arguments import as_block, as_slopes, as_view_indices
from lf_flame.refocus.shift import shift_taps, view_shifts
from lf_flame.scenes.scene import Scene
from lf_flame.simulation.integration import bundle_bands
from lf_flame.simulation.optical_pass import OpticalPass, optical_passes
from lf_flame.simulation.planning.plan import EffectPlan
from lf_flame.simulation.rendering import planned_planes
from lf_flame.simulation.slabs import Plane

Block = tuple[int, int]
"""Number of lenslets averaged into one pixel, along (t, s)."""

MOST_KEPT = 64
"""Largest number of planes times passes with bundles that are kept for later images: about 50 MB
for 15 x 15 views of 270 x 540 lenslets. More, as for many colours, are traced for each image."""


class Bands(NamedTuple):
    """Weights of a plane's cells in the pixels' bundles, along one axis.

    Attributes
    ----------
    start : ndarray of int64, shape (view, lenslet)
        First cell of each bundle.
    weight : ndarray of float64, shape (view, lenslet, cell)
        Weights of the cells from there on.
    low, high : ndarray of int64, shape (view,)
        First lenslet that sees the plane, and one past the last.
    """

    start: np.ndarray
    weight: np.ndarray
    low: np.ndarray
    high: np.ndarray


class Projector:
    """Refocused images and aligned views of a scene, computed without its light field.

    Parameters
    ----------
    scene : Scene
        Scene to project.
    camera : PlenopticCamera
        Camera in front of it.
    plan : EffectPlan
        Plan from `lf_flame.plan_effects`, with nothing in `not_separable`.

    Raises
    ------
    InputError
        If a layer is outside the field, or the plan keeps an effect that needs a light field.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import PAPER_CAMERA, Layer, Scene, plan_effects
    >>> from lf_flame.projection import Projector
    >>> scene = Scene([Layer(np.ones((8, 8)), depth_mm=10.0, size_mm=(4.0, 4.0))])
    >>> projector = Projector(scene, PAPER_CAMERA, plan_effects(scene, PAPER_CAMERA))
    >>> projector.refocus([0.0, 1.17], block=(3, 3)).shape
    (2, 90, 180)
    """

    def __init__(self, scene: Scene, camera: PlenopticCamera, plan: EffectPlan):
        if plan.not_separable:
            reasons = ", ".join(f"{name} {why}" for name, why in plan.not_separable.items())
            raise InputError(f"These images need a light field, as {reasons}; render it.")
        self.camera = camera
        self._planes = [p for p in planned_planes(scene, camera, plan) if p.emission.any()]
        self._passes = [
            replace(optics, neighbour=neighbour)
            for optics in optical_passes(camera, plan.kept, plan.traced, plan.colours)
            for neighbour in optics.neighbours
        ]
        few = len(self._planes) * len(self._passes) <= MOST_KEPT
        self._kept = list(self._trace()) if few else None

    def refocus(
        self,
        slopes: ArrayLike,
        interpolation: str = "linear",
        block: Block = (1, 1),
        weights: ArrayLike | None = None,
    ) -> np.ndarray:
        """Refocused images, as `lf_flame.refocus.shift_and_sum` makes them from the light field.

        Parameters
        ----------
        slopes : float or sequence of float
            Slopes in lenslets per view step, whatever the block.
        interpolation : {"linear", "nearest", "cubic"}, optional
            Interpolation between lenslets.
        block : (int, int), optional
            Number of lenslets averaged into one pixel, along (t, s), after refocusing.
        weights : array_like, shape (v, u), optional
            Weight of each view, 0 or above; divided by their sum. Default: all equal.

        Returns
        -------
        ndarray of float32, shape (n, t / block, s / block)

        Raises
        ------
        InputError
            If an argument cannot be used.
        """
        slopes = as_slopes(slopes)
        shape = (self.camera.views,) * 2
        weights = np.ones(shape) if weights is None else as_view_weights(weights, shape)
        down, across = split_rows(weights)
        return self._project(slopes, (down[None], across[None]), interpolation, block)

    def align_views(
        self, slopes: ArrayLike, view_indices: Sequence[tuple[int, int]], block: Block = (1, 1)
    ) -> np.ndarray:
        """Shift selected views, as `lf_flame.refocus.align_views` shifts those of the light field.

        Parameters
        ----------
        slopes : float or sequence of float
            Slopes in lenslets per view step; 0 leaves the views unshifted.
        view_indices : sequence of (int, int)
            Row and column of each view.
        block : (int, int), optional
            Number of lenslets averaged into one pixel, along (t, s), after shifting.

        Returns
        -------
        ndarray of float32, shape (n, views, t / block, s / block)

        Raises
        ------
        InputError
            If an argument cannot be used.
        """
        slopes, views = as_slopes(slopes), self.camera.views
        indices = as_view_indices(view_indices, (views, views))
        one = np.tile(np.eye(views)[indices], (len(slopes), 1, 1, 1))  # [n, k, axis, view]
        shares = one.reshape(-1, 2, 1, views)
        repeated = np.repeat(slopes, len(indices))
        images = self._project(repeated, (shares[:, 0], shares[:, 1]), "linear", block)
        return images.reshape(len(slopes), len(indices), *images.shape[1:])

    def _project(self, slopes, shares, interpolation: str, block: Block) -> np.ndarray:
        """Images at given slopes; shares[axis][n or 1, p, view] are the weights of their terms."""
        lenslets = self.camera.lenslets
        block = as_block(block, lenslets)
        down, across = (
            sum_lines(slopes, shares[axis], lenslets[axis], block[axis], interpolation)
            for axis in (0, 1)
        )
        size = (length // count for length, count in zip(lenslets, block, strict=True))
        out = np.zeros((len(slopes), *size))
        for cells, rows, columns in self._trace() if self._kept is None else self._kept:
            add_images(cells, rows, columns, down, across, out)
        return out.astype(np.float32)

    def _trace(self) -> Iterator[tuple[np.ndarray, Bands, Bands]]:
        """Radiance of each plane, column by row, with the bundles' bands along y and x, by pass."""
        for plane in self._planes:
            # All passes have the same share of the light.
            cells = np.multiply(plane.emission.T, self._passes[0].share, order="C")
            for optics in self._passes:
                yield cells, _trace_bands(plane, optics, 0), _trace_bands(plane, optics, 1)


def _trace_bands(plane: Plane, optics: OpticalPass, axis: int) -> Bands:
    start, weight = bundle_bands(plane, optics, axis)
    low, high = np.empty((2, len(weight)), np.int64)
    find_seen(weight, low, high)
    return Bands(start, weight, low, high)


class LineSums(NamedTuple):
    """Lines of images as sums of lines of views: shifted, interpolated, averaged over blocks.

    Line k of image n is, in its term p, the sum over v and j of
    ``weights[n, p, v, j] * lines[v, k * block + first[n, v] + j]``, coordinates clamped.

    Attributes
    ----------
    first : ndarray of int64, shape (n, v)
        Offset of the first line that is read.
    weights : ndarray of float64, shape (n, p, v, tap)
        Weight of each line.
    block : int
        Number of lenslets averaged into one pixel.
    """

    first: np.ndarray
    weights: np.ndarray
    block: int


def sum_lines(
    slopes: np.ndarray, shares: np.ndarray, length: int, block: int, interpolation: str
) -> LineSums:
    """Plan the sums of lines at given slopes: interpolation, shift and mean over a block.

    shares[n or 1, p, v]: weight of each line of views in each term of an image. length: number of
    lenslets along the axis, a multiple of `block`, the number averaged into one pixel.
    """
    first, taps = shift_taps(view_shifts(slopes, centred(shares.shape[2]), length), interpolation)
    merged = np.zeros((len(taps) + block - 1, *first.shape))
    for j, tap in enumerate(taps):
        merged[j : j + block] += tap / block
    weights = np.multiply(shares[..., None], merged.T[:, None], order="C")
    return LineSums(first.T.copy(), weights, block)


def split_rows(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Write weights of views as a sum of products of weights along v and along u.

    Rows of views with the same weights share a product: one product suffices for equal weights or
    a single view; a round aperture of 15 x 15 views takes 8.

    Returns factors of shapes (p, v) and (p, u): ``down.T @ across`` are the weights, 0 or above
    with at least one above 0, divided by their sum.
    """
    rows_of: dict[bytes, list[int]] = {}
    for v in np.flatnonzero(weights.any(axis=1)).tolist():
        rows_of.setdefault(weights[v].tobytes(), []).append(v)
    down = np.zeros((len(rows_of), len(weights)))
    for p, rows in enumerate(rows_of.values()):
        down[p, rows] = 1
    return down, weights[[rows[0] for rows in rows_of.values()]] / weights.sum()


# The compiled loops sum in float64, each image in one thread and in a fixed order.


@parallel(lambda low: low.size)
def find_seen(v, weight, low, high):
    """Find the first line of each view that is not 0, and one past the last; weight[v, t, i]."""
    low[v], high[v] = 0, weight.shape[1]
    while low[v] < high[v] and not np.any(weight[v, low[v]]):
        low[v] += 1
    while low[v] < high[v] and not np.any(weight[v, high[v] - 1]):
        high[v] -= 1


@njit
def sum_bands(bands, first, weights, block, sums, reach):
    """Sum lines of a banded matrix: sums[k, cell], 0 before cell reach[k, 0] and from reach[k, 1].

    bands: start[v, t] and weight[v, t, i] of the lines, and low[v], high[v]: lines outside are 0.
    first[v], weights[v, j]: lines that make up line k, and their weights; see `sum_lines`.
    reach[k]: first cell that is not 0, and one past the last.
    """
    length = bands.start.shape[1]
    for k in range(sums.shape[0]):
        line = sums[k]
        line[:] = 0.0
        near, far = line.size, 0
        for v in range(weights.shape[0]):
            for j in range(weights.shape[1]):
                at, w = min(max(k * block + first[v] + j, 0), length - 1), weights[v, j]
                if w == 0.0 or at < bands.low[v] or at >= bands.high[v]:
                    continue
                start, band = bands.start[v, at], bands.weight[v, at]
                near, far = min(near, start), max(far, start + band.size)
                cells = line[start : start + band.size]
                for i in range(np.uint64(band.size)):
                    cells[i] += w * band[i]
        reach[k, 0], reach[k, 1] = near, far


@njit
def weigh_rows(rows, weights, low, high, total):
    """Add rows low to high, weighted: total[i] += sum over j of weights[j] * rows[j, i]."""
    j = low
    while j + 4 <= high:  # four rows at a time take fewer loads and stores per product
        a, b, c, d = weights[j], weights[j + 1], weights[j + 2], weights[j + 3]
        one, two, three, four = rows[j], rows[j + 1], rows[j + 2], rows[j + 3]
        for i in range(np.uint64(total.size)):
            total[i] += (a * one[i] + b * two[i]) + (c * three[i] + d * four[i])
        j += 4
    for k in range(j, high):
        w, row = weights[k], rows[k]
        for i in range(np.uint64(total.size)):
            total[i] += w * row[i]


@njit
def span(reach):
    """Find the first line, or cell, that is in reach, and one past the last."""
    near, far = np.int64(0), np.int64(0)
    for k in range(reach.shape[0]):
        if reach[k, 0] < reach[k, 1]:
            if far == 0:
                near = k
            far = k + 1
    return near, far


@njit
def add_product(cells, down, down_reach, across, across_reach, out):
    """Add ``down @ cells.T @ across.T`` to an image, out[t, s]; cells[j, i] is column by row."""
    left, right = span(across_reach)
    top, bottom = span(down_reach)
    if left == right or top == bottom:
        return
    lines = np.empty((cells.shape[1], right - left))
    total = np.empty(cells.shape[1])
    for s in range(left, right):
        total[:] = 0.0
        weigh_rows(cells, across[s], across_reach[s, 0], across_reach[s, 1], total)
        lines[:, s - left] = total
    for t in range(top, bottom):
        weigh_rows(lines, down[t], down_reach[t, 0], down_reach[t, 1], out[t, left:right])


@parallel(lambda out: len(out))
def add_images(n, cells, rows, columns, down, across, out):
    """Add a plane's light to images, out[n, t, s].

    cells[j, i]: radiance of the plane, column by row.
    rows, columns: bands of the bundles along y and x, see `Bands`.
    down, across: sums of lines along y and x, see `LineSums`.
    """
    count, height, width = out.shape
    tall, wide = np.empty((height, cells.shape[1])), np.empty((width, cells.shape[0]))
    tall_reach, wide_reach = np.empty((height, 2), np.int64), np.empty((width, 2), np.int64)
    for p in range(down.weights.shape[1]):
        sum_bands(rows, down.first[n], down.weights[n, p], down.block, tall, tall_reach)
        sum_bands(columns, across.first[n], across.weights[n, p], across.block, wide, wide_reach)
        add_product(cells, tall, tall_reach, wide, wide_reach, out[n])
