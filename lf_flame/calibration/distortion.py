"""Radial distortion of the main lens, undone in all views alike."""

from dataclasses import replace

import numpy as np
from scipy.ndimage import map_coordinates

from lf_flame._common.arrays import centred
from lf_flame.errors import InputError
from lf_flame.lightfield import LightField

WHOLE = 1 - 1e-3
"""Interpolated fraction of known pixels above which a pixel is known."""

TURNS = 20
"""Number of Newton steps for a distance; they converge in fewer."""


def undistort(light_field: LightField, distortion: float) -> LightField:
    """Resample views so that they are free of radial distortion, by cubic splines.

    A distance r in pixels from the middle of a view becomes ``r (1 + k r^2)``. Beyond the picture
    its edges repeat.

    Parameters
    ----------
    light_field : LightField
    distortion : float
        Coefficient k per pixel squared, as `CameraLaw.distortion`.

    Raises
    ------
    InputError
        If the distortion folds the corners over.
    """
    size = light_field.views.shape[2:4]
    down, right = np.meshgrid(*(centred(n) for n in size), indexing="ij")
    free = np.hypot(down, right)
    if not 1 + 3 * distortion * float(free.max()) ** 2 > 0.1:
        raise InputError(
            f"A distortion of {distortion:g} per pixel squared folds the corners of views of "
            f"{size[0]} x {size[1]} pixels over."
        )
    seen = free.copy()
    for _ in range(TURNS):
        seen -= (seen * (1 + distortion * seen**2) - free) / (1 + 3 * distortion * seen**2)
    shrunk = np.divide(seen, free, out=np.ones_like(free), where=free > 0)
    at = np.stack([down * shrunk + (size[0] - 1) / 2, right * shrunk + (size[1] - 1) / 2])
    views = light_field.filled.reshape(-1, *size, light_field.channels)
    new = np.empty_like(views)
    for view, free_view in zip(views, new, strict=True):
        for channel in range(light_field.channels):
            one = view[..., channel]
            free_view[..., channel] = map_coordinates(one, at, order=3, mode="nearest")
    valid = light_field.valid
    if valid is not None:  # a pixel is known if all four are that it lies between
        known = [
            map_coordinates(one.astype(np.float32), at, order=1, mode="nearest") > WHOLE
            for one in valid.reshape(-1, *size)
        ]
        valid = np.reshape(known, valid.shape)
    return replace(light_field, views=new.reshape(light_field.views.shape), valid=valid)
