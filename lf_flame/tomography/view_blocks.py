"""Blocks of a camera's lenslets, averaged for a fit with larger cells."""

import numpy as np

from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.optics.lens import Lens
from lf_flame.refocus import align_views


def known_blocks(light_field: LightField, camera: Lens, block: int) -> np.ndarray | None:
    """Find the blocks of a camera's lenslets of which all pixels are known; None if all are.

    Returns
    -------
    ndarray of bool, shape (v, u, t, s), or None
    """
    if light_field.valid is None:
        return None
    known = LightField.trusted(light_field.valid.astype(np.float32))
    return average_blocks(known, camera, block) > 1 - 1 / (2 * block**2)


def average_blocks(light_field: LightField, camera: Lens, block: int) -> np.ndarray:
    """Average blocks of a camera's lenslets.

    Returns
    -------
    ndarray of float32, shape (v, u, t, s)

    Raises
    ------
    InputError
        If the light field is not grey, or not of that camera.
    """
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
