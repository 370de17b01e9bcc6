"""Views of a light field that a fit uses, which have equal weights."""

from dataclasses import replace

import numpy as np

from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.tomography.frustum_grid import FrustumGrid

FEWEST = 3
"""Smallest number of views along each axis with which depth can be found."""


def fitted_views(light_field: LightField, grid: FrustumGrid) -> tuple[FrustumGrid, tuple[str, ...]]:
    """Leave out views without weight from the views that a grid fits.

    Returns
    -------
    FrustumGrid
        Grid of the views that count.
    tuple of str
        A sentence that says so if views were left out.

    Raises
    ------
    InputError
        If too few views remain, or their weights differ.
    """
    weights, views = light_field.weights, grid.camera.views
    if weights is not None and weights.shape == (views, views):
        some = weights[weights > 0]
        if np.ptp(some) > 0:
            raise InputError(
                f"A fit needs views that all count alike, or not at all, got weights from "
                f"{some.min():g} to {some.max():g}."
            )
        counted = weights > 0 if grid.counted is None else (weights > 0) & grid.counted
        grid = replace(grid, counted=counted)
    if grid.counted is None:
        return grid, ()
    return grid, (
        f"{grid.view_count} of the {views**2} views are fitted: the others do not count, or the "
        f"round aperture cuts them.",
    )


def counted_views(
    light_field: LightField, camera: PlenopticCamera
) -> tuple[LightField, PlenopticCamera, tuple[str, ...]]:
    """Cut a light field to the largest inner square of views without weight 0.

    Fits give all views equal weights, as for a square pupil. Views of weight 0, such as those at
    the corners of a round aperture, are left out, with the part of the pupil that they see.

    Returns
    -------
    LightField
        Views of the inner square.
    PlenopticCamera
        Camera with this number of views, and the same pixels.
    tuple of str
        A sentence that says so if views were left out.

    Raises
    ------
    InputError
        If too few views remain, or their weights differ.
    """
    if light_field.weights is None or light_field.views.shape[:2] != (camera.views,) * 2:
        return light_field, camera, ()
    for out in range((camera.views + 1) // 2):
        inner = slice(out, camera.views - out)
        weights = light_field.weights[inner, inner]
        if weights.all():
            break
    count = len(weights)
    if not weights.all() or count < min(FEWEST, camera.views) or np.ptp(weights) > 0:
        raise InputError(
            f"A fit needs an inner square of {FEWEST} x {FEWEST} views or more that all count "
            f"alike, got one of {count} x {count} with weights from {weights.min():g} to "
            f"{weights.max():g}."
        )
    if count == camera.views:
        return light_field, camera, ()
    return (
        LightField.trusted(
            np.ascontiguousarray(light_field.views[inner, inner]),
            valid=None if light_field.valid is None else light_field.valid[inner, inner],
        ),
        replace(camera, views=count, pixel_pitch_mm=camera.pixel_mm),
        (
            f"Only the inner {count} x {count} of the {camera.views} x {camera.views} views are "
            f"fitted: the others are missing, hold light of neighbouring lenslets, or are mostly "
            f"dark.",
        ),
    )
