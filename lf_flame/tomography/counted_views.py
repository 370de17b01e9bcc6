"""Views of a light field that a fit uses: an inner square of views with equal weights."""

from dataclasses import replace

import numpy as np

from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.optics.camera import PlenopticCamera

FEWEST = 3
"""Smallest number of views along each axis with which depth can be found."""


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
        LightField.trusted(np.ascontiguousarray(light_field.views[inner, inner])),
        replace(camera, views=count, pixel_pitch_mm=camera.pixel_mm),
        (
            f"Only the inner {count} x {count} of the {camera.views} x {camera.views} views are "
            f"fitted: the others are missing, hold light of neighbouring lenslets, or are mostly "
            f"dark.",
        ),
    )
