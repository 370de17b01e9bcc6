"""Views of a light field that a fit uses, of equal weights, averaged over blocks of lenslets."""

from dataclasses import replace
from typing import TypeVar

import numpy as np

from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.optics.lens import Lens
from lf_flame.refocus import align_views
from lf_flame.tomography.axisymmetric_grid import AxisymmetricGrid
from lf_flame.tomography.frustum_grid import FEWEST, FrustumGrid

Grid = TypeVar("Grid", bound=FrustumGrid | AxisymmetricGrid)


def fitted_views(light_field: LightField, grid: Grid) -> tuple[Grid, np.ndarray, np.ndarray | None]:
    """Pick the views that a grid fits, in its pixels: grid, views, and which rays are known.

    A ray is known if all pixels of its block are; None if all are.
    """
    camera = grid.camera
    if isinstance(grid, AxisymmetricGrid) and grid.which == "central":
        if light_field.views.shape[:2] == (1, 1):
            camera = camera.with_views(1)
    elif light_field.weights is not None and light_field.weights.shape == (camera.views,) * 2:
        weights = light_field.weights
        some = weights[weights > 0]
        if np.ptp(some) > 0:
            raise InputError(
                f"A fit needs views that all count alike, or not at all, got weights from "
                f"{some.min():g} to {some.max():g}."
            )
        counted = weights > 0 if grid.counted is None else (weights > 0) & grid.counted
        grid = replace(grid, counted=counted)
    views = grid.pick(_average_blocks(light_field, camera, grid.block))
    if light_field.valid is None:
        return grid, views, None
    one = LightField.trusted(light_field.valid.astype(np.float32))
    known = _average_blocks(one, camera, grid.block) > 1 - 1 / (2 * grid.block**2)
    return grid, views, grid.pick(known)


def inner_views(light_field: LightField, camera: Lens) -> tuple[LightField, Lens]:
    """Cut a light field, and its camera, to the largest inner square of whole views with weight."""
    if light_field.views.shape[:2] != (camera.views,) * 2:
        return light_field, camera
    counts = np.ones((camera.views,) * 2) if light_field.weights is None else light_field.weights
    counts = counts * camera.whole_views()
    for out in range((camera.views + 1) // 2):
        inner = slice(out, camera.views - out)
        weights = counts[inner, inner]
        if weights.all():
            break
    count = len(weights)
    if not weights.all() or count < min(FEWEST, camera.views) or np.ptp(weights) > 0:
        raise InputError(
            f"The axis is found in an inner square of {FEWEST} x {FEWEST} views or more that all "
            f"count alike, got one of {count} x {count} with weights from {weights.min():g} to "
            f"{weights.max():g}."
        )
    if count == camera.views:
        return light_field, camera
    views = np.ascontiguousarray(light_field.views[inner, inner])
    valid = None if light_field.valid is None else light_field.valid[inner, inner]
    return LightField.trusted(views, valid=valid), camera.with_views(count)


def _average_blocks(light_field: LightField, camera: Lens, block: int) -> np.ndarray:
    """Average blocks of a camera's lenslets, float32, shape (v, u, t, s)."""
    views = light_field.filled
    wanted = (camera.views, camera.views, *camera.lenslets)
    if views.shape != wanted:
        hint = "; in colour, its colours need a calibration (--colours)" if views.ndim == 5 else ""
        raise InputError(
            f"The light field must be grey, of the camera's {wanted[0]} x {wanted[1]} views of "
            f"{wanted[2]} x {wanted[3]} lenslets, got an array of shape {views.shape}{hint}."
        )
    if block == 1:
        return views
    # Alignment at slope 0 is the identity; it averages blocks at the speed of reading.
    indices = [(v, u) for v in range(camera.views) for u in range(camera.views)]
    aligned = align_views(views, 0.0, indices, block=(block, block))
    return aligned.reshape(*views.shape[:2], *aligned.shape[1:])
