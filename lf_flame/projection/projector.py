"""A scene in front of a camera, prepared for refocused images and views without a light field."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lf_flame.errors import InputError
from lf_flame.lightfield import as_view_weights
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.projection import _kernels
from lf_flame.projection.line_sums import split_rows, sum_lines
from lf_flame.refocus._arguments import as_block, as_slopes
from lf_flame.refocus.alignment import as_view_indices
from lf_flame.scenes.scene import Scene
from lf_flame.simulation.exact import bundle_bands
from lf_flame.simulation.gathering import optical_passes
from lf_flame.simulation.optical_pass import OpticalPass
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
            for neighbour in optics.lit_neighbours()
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
        self,
        slopes: ArrayLike,
        view_indices: Sequence[tuple[int, int]],
        block: Block = (1, 1),
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
        """Images at some slopes; shares[axis][n or 1, p, view] are the weights of their terms."""
        lenslets = self.camera.lenslets
        block = as_block(block, lenslets)
        down, across = (
            sum_lines(slopes, shares[axis], lenslets[axis], block[axis], interpolation)
            for axis in (0, 1)
        )
        size = (length // count for length, count in zip(lenslets, block, strict=True))
        out = np.zeros((len(slopes), *size))
        for cells, rows, columns in self._trace() if self._kept is None else self._kept:
            _kernels.add_images(cells, rows, columns, down, across, out)
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
    _kernels.find_seen(weight, low, high)
    return Bands(start, weight, low, high)
