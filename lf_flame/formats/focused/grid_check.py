"""Check that the lenslets of a calibration are those that a picture shows."""

import numpy as np
from scipy.spatial import cKDTree

from lf_flame.errors import InputError
from lf_flame.formats.focused.lenslets import FocusedLenslets
from lf_flame.formats.raw.lenslet_search import estimate_grid

LARGEST_SHIFT = 0.08
"""Largest displacement of the lenslets in a picture from those of the calibration, in pitches."""


def check_fit(image: np.ndarray, lenslets: FocusedLenslets, calibration: object) -> None:
    """Refuse a calibration whose lenslets are not where a picture, (rows, columns), shows them.

    Micro-images are dark between each other. Where a picture shows no lenslets, nothing is checked.
    """
    grey = np.atleast_3d(image).mean(axis=2, dtype=np.float64)
    pitch = lenslets.grid.pitch
    try:
        found = estimate_grid(grey, layout=lenslets.grid.layout).centres(grey.shape).reshape(-1, 2)
    except InputError:
        return
    stated = lenslets.array(grey.shape).centres.reshape(-1, 2)
    away = float(cKDTree(stated).query(found)[0].max())
    if away > LARGEST_SHIFT * pitch:
        raise InputError(
            f"The lenslets of {calibration} do not fit the picture, in which the micro-images lie "
            f"{away:.2g} pixels beside theirs or more: both must be of the same camera, and the "
            f"picture whole, neither scaled nor cropped."
        )
