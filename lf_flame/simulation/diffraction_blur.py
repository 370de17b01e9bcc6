"""The blur of a camera's own apertures by diffraction, as weights on its pixels and lenslets."""

from functools import lru_cache

import numpy as np

from lf_flame.errors import InputError
from lf_flame.optics import diffraction
from lf_flame.optics.camera import PlenopticCamera

TAIL = 1e-3
"""Share of the light that a kernel may leave out."""


@lru_cache(maxsize=16)
def lenslet_kernel(camera: PlenopticCamera) -> np.ndarray:
    """Diffraction of a lenslet in pixels, shape (odd,): along one axis, for both."""
    spread = _wavelength_mm(camera) * camera.lenslet_focal_mm / camera.lenslet_pitch_mm
    return diffraction.square_kernel(spread, camera.pixel_mm, TAIL)


@lru_cache(maxsize=16)
def main_lens_kernel(camera: PlenopticCamera) -> np.ndarray:
    """Diffraction of the main lens in lenslets: (odd,), or (odd, odd) for a round aperture."""
    length = _wavelength_mm(camera) * camera.image_distance_mm
    if camera.aperture_diameter_mm is None:
        spread = length / camera.aperture_mm
        return diffraction.square_kernel(spread, camera.lenslet_pitch_mm, TAIL)
    spread = length / camera.aperture_diameter_mm
    return diffraction.round_kernel(spread, camera.lenslet_pitch_mm, TAIL)


def _wavelength_mm(camera: PlenopticCamera) -> float:
    if camera.wavelength_nm is None:
        raise InputError("Diffraction needs the camera's wavelength_nm, got none.")
    return camera.wavelength_nm * 1e-6
