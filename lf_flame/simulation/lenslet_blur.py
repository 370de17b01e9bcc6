"""Diffraction at the lenslets, as a blur of the light on the sensor."""

import math
from dataclasses import replace

import numpy as np

from lf_flame.errors import InputError
from lf_flame.optics import diffraction
from lf_flame.optics.camera import PlenopticCamera

SAME_PITCH = 1e-9
"""Relative difference at which pixels still tile a micro-image."""

COLUMNS_AT_ONCE = 256
"""Number of columns of an image that are held as float64 at a time."""

MOST_TILES = 2**30
"""Largest number of tiles of the whole sensor; more would fill the memory."""


def lenslet_share_leaving(camera: PlenopticCamera) -> float:
    """Fraction of an evenly lit pixel's light that lenslet diffraction brings from others."""
    return diffraction.share_leaving_square(_spread_mm(camera), camera.pixel_mm, False)


def leaves_gaps(camera: PlenopticCamera) -> bool:
    """Whether there is light between the pixels of neighbouring micro-images."""
    return camera.views * camera.pixel_mm < camera.micro_image_pitch_mm * (1 - SAME_PITCH)


def tiled_sensor(camera: PlenopticCamera, parts: int = 1) -> PlenopticCamera:
    """Camera whose pixels leave no gaps: tiles no wider than such parts of the pixels.

    Raises
    ------
    InputError
        If so many tiles are out of reach.
    """
    ratio = camera.micro_image_pitch_mm / camera.pixel_mm * parts
    tiles = max(math.ceil(ratio * (1 - SAME_PITCH)), camera.views * parts)
    if tiles**2 * math.prod(camera.lenslets) > MOST_TILES:
        raise InputError(
            f"Diffraction of lenslets needs the light under each in {tiles} x {tiles} tiles, which "
            f"is too many; use a larger pixel_pitch_mm or tolerance, or force lenslet_diffraction "
            f"off."
        )
    return replace(camera, views=tiles, pixel_pitch_mm=None)


def blur_on_sensor(
    tiles: np.ndarray, tiled: PlenopticCamera, camera: PlenopticCamera
) -> np.ndarray:
    """Let the lenslets diffract the light on a sensor, and let the pixels gather it.

    The light is taken as even over each tile. Beyond the border the outermost tiles go on.

    Parameters
    ----------
    tiles : ndarray, shape (t * tiles, s * tiles)
        Raw image on the tiles.
    tiled : PlenopticCamera
        Camera of the tiles, from `tiled_sensor`.
    camera : PlenopticCamera
        Camera of the pixels.

    Returns
    -------
    ndarray of float32, shape (t * v, s * u)
    """
    image = tiles
    for axis, lenslets in enumerate(camera.lenslets):
        lines = np.moveaxis(image, axis, 0)
        found = np.empty((lenslets * camera.views, lines.shape[1]), np.float32)
        for low in range(0, lines.shape[1], COLUMNS_AT_ONCE):
            part = np.s_[:, low : low + COLUMNS_AT_ONCE]
            blurred = diffraction.blur_lines(lines[part], 0, _spread_mm(camera), tiled.pixel_mm)
            found[part] = _pixel_means(blurred, tiled, camera, lenslets)
        image = np.moveaxis(found, 0, axis)
    return np.ascontiguousarray(image)


def _pixel_means(
    lines: np.ndarray, tiled: PlenopticCamera, camera: PlenopticCamera, lenslets: int
) -> np.ndarray:
    """Take the means of tiles over the pixels, along the first axis.

    Where tiles do not lie on pixels, as differences of their sum, which is interpolated between the
    edges of tiles by cubics: what was blurred is smooth there.
    """
    if not leaves_gaps(camera):
        return lines.reshape(lenslets * camera.views, -1, lines.shape[1]).mean(axis=1)
    tiles_of_pixel = camera.pixel_mm / tiled.pixel_mm
    views = np.arange(camera.views + 1) - camera.views / 2
    edges = (np.arange(lenslets)[:, None] + 0.5) * tiled.views + views * tiles_of_pixel
    around = np.pad(lines, ((2, 2), (0, 0)), "edge")
    sums = np.cumsum(around, axis=0)  # up to the end of each tile
    here = np.floor(edges + SAME_PITCH).astype(int)
    part = np.maximum(edges - here, 0)
    part[part < SAME_PITCH] = 0
    up_to = np.zeros((*edges.shape, lines.shape[1]))
    for step, weight in zip((-1, 0, 1, 2), _cubic(part), strict=True):
        up_to += weight[..., None] * sums[here + step + 1]
    means = np.diff(up_to, axis=1) / tiles_of_pixel
    return means.reshape(-1, lines.shape[1])


def _cubic(part: np.ndarray) -> tuple[np.ndarray, ...]:
    """Weights of Lagrange's cubic through -1, 0, 1 and 2."""
    before, after, far = part + 1, part - 1, part - 2
    return (
        -part * after * far / 6,
        before * after * far / 2,
        -before * part * far / 2,
        before * part * after / 6,
    )


def _spread_mm(camera: PlenopticCamera) -> float:
    return wavelength_mm(camera) * camera.lenslet_focal_mm / camera.lenslet_pitch_mm


def wavelength_mm(camera: PlenopticCamera) -> float:
    """Take a camera's wavelength in mm, or refuse to go on without one."""
    if camera.wavelength_nm is None:
        raise InputError("Diffraction needs the camera's wavelength_nm, got none.")
    return camera.wavelength_nm * 1e-6
