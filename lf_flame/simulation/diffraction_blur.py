"""The blur of a camera's own apertures by diffraction, as weights on its pixels and lenslets."""

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
from scipy import sparse

from lf_flame._common.arrays import centred
from lf_flame.errors import InputError
from lf_flame.optics import diffraction
from lf_flame.optics.camera import PlenopticCamera

TAIL = 1e-3
"""Share of the light that a kernel may leave out."""

SAME_PITCH = 1e-9
"""Relative difference at which pixels still tile a micro-image."""

MOST_TILES = 2**30
"""Tiles of the whole sensor beyond which the gaps between the pixels would fill the memory."""


@lru_cache(maxsize=16)
def lenslet_kernel(camera: PlenopticCamera) -> np.ndarray:
    """Diffraction of a lenslet in pixels, shape (odd,): along one axis, for both."""
    return diffraction.square_kernel(_lenslet_spread_mm(camera), camera.pixel_mm, TAIL)


@lru_cache(maxsize=16)
def main_lens_kernel(camera: PlenopticCamera) -> np.ndarray:
    """Diffraction of the main lens in lenslets: (odd,), or (odd, odd) for a round aperture."""
    length = _wavelength_mm(camera) * camera.image_distance_mm
    if camera.aperture_diameter_mm is None:
        spread = length / camera.aperture_mm
        return diffraction.square_kernel(spread, camera.lenslet_pitch_mm, TAIL)
    spread = length / camera.aperture_diameter_mm
    return diffraction.round_kernel(spread, camera.lenslet_pitch_mm, TAIL)


def tiled_sensor(camera: PlenopticCamera) -> PlenopticCamera:
    """Camera whose pixels leave no gap between micro-images: itself, or one of narrower tiles.

    Raises
    ------
    InputError
        If so many tiles are out of reach.
    """
    pitch, pixel = camera.micro_image_pitch_mm, camera.pixel_mm
    if camera.views * pixel >= pitch * (1 - SAME_PITCH):
        return camera
    tiles = math.ceil(pitch / pixel * (1 - SAME_PITCH))
    if tiles**2 * math.prod(camera.lenslets) > MOST_TILES:
        raise InputError(
            f"Diffraction of lenslets needs the light between the pixels too, in {tiles} x {tiles} "
            f"tiles under each lenslet, which is too many; use a larger pixel_pitch_mm, or force "
            f"lenslet_diffraction off."
        )
    return replace(camera, views=tiles, pixel_pitch_mm=None)


def lenslet_share_leaving(camera: PlenopticCamera) -> float:
    """Largest share of its light that a pixel owes to others by diffraction at the lenslets."""
    if tiled_sensor(camera) is camera:
        return diffraction.share_leaving(lenslet_kernel(camera))
    _, edges = _pieces(camera)
    weights, reach = _piece_weights(camera)
    own = reach * (edges.size - 1) + _pixel_pieces(camera, edges)
    return 1 - float(weights[np.arange(camera.views), own].min()) ** 2


def blur_gapped(raw: np.ndarray, tiles: np.ndarray, camera: PlenopticCamera) -> np.ndarray:
    """Blur a raw image by diffraction at the lenslets where pixels do not tile the micro-images.

    The image is taken as constant over each pixel, and in the gaps over each tile: where pixels
    tile, this is `lf_flame.optics.diffraction.blur_raw`. Beyond the border the outermost tiles
    go on.

    Parameters
    ----------
    raw : ndarray, shape (t * v, s * u)
        Of the camera.
    tiles : ndarray, shape (t * tiles, s * tiles)
        The same light on the `tiled_sensor`.
    camera : PlenopticCamera

    Returns
    -------
    ndarray of float32, shape (t * v, s * u)
    """
    means, edges = _pieces(camera)
    own, pieces = _pixel_pieces(camera, edges), edges.size - 1
    image, places = tiles, []
    for axis, lenslets in enumerate(camera.lenslets):
        image = _apply(sparse.kron(sparse.eye(lenslets), means), image, axis)
        places.append(np.add.outer(np.arange(lenslets) * pieces, own).ravel())
    image[np.ix_(*places)] = raw
    for axis, lenslets in enumerate(camera.lenslets):
        image = _apply(_blur_matrix(camera, lenslets), image, axis)
    return image


def _apply(matrix, image: np.ndarray, axis: int) -> np.ndarray:
    """Multiply a sparse matrix on an axis of an image, in float64; float32 out."""
    found = matrix.tocsr() @ np.moveaxis(image, axis, 0)
    return np.moveaxis(found, 0, axis).astype(np.float32, order="C")


def _pixels_mm(camera: PlenopticCamera) -> np.ndarray:
    """Centres of the pixels under a lenslet, from the centre of its micro-image."""
    return centred(camera.views) * camera.pixel_mm


def _pixel_pieces(camera: PlenopticCamera, edges_mm: np.ndarray) -> np.ndarray:
    """Which of a micro-image's pieces are its pixels, shape (views,)."""
    return np.searchsorted(edges_mm, _pixels_mm(camera)) - 1


def _pieces(camera: PlenopticCamera) -> tuple[np.ndarray, np.ndarray]:
    """Pieces of a micro-image: the pixels, and beside them what the tiles leave of the gaps.

    Returns
    -------
    means : ndarray of float64, shape (pieces, tiles)
        Share of each tile in a piece.
    edges_mm : ndarray of float64, shape (pieces + 1,)
        From the centre of the micro-image.
    """
    pitch, tiles = camera.micro_image_pitch_mm, tiled_sensor(camera).views
    borders = (np.arange(tiles + 1) / tiles - 0.5) * pitch
    pixels = (np.arange(camera.views + 1) - camera.views / 2) * camera.pixel_mm
    above, below = borders[borders < pixels[0]], borders[borders > pixels[-1]]
    edges = np.concatenate([above, pixels, below])
    low = np.maximum(edges[:-1, None], borders[:-1])
    high = np.minimum(edges[1:, None], borders[1:])
    return (high - low).clip(0) / np.diff(edges)[:, None], edges


@lru_cache(maxsize=16)
def _piece_weights(camera: PlenopticCamera) -> tuple[np.ndarray, int]:
    """Weights of the pieces of near micro-images in the pixels of one, as far as `TAIL` allows.

    Returns
    -------
    weights : ndarray of float64, shape (views, (2 * reach + 1) * pieces)
        Each row of sum 1.
    reach : int
        Micro-images to each side.
    """
    _, edges = _pieces(camera)
    pitch, pixels = camera.micro_image_pitch_mm, _pixels_mm(camera)
    farthest = (lenslet_kernel(camera).size // 2 + 0.5) * camera.pixel_mm
    reach = math.ceil(farthest / pitch)
    near = np.arange(-reach, reach + 1)[:, None] * pitch
    # The last edge of a micro-image is the first of the next.
    along = np.append((near + edges[:-1]).ravel(), near[-1] + edges[-1])
    spread = _lenslet_spread_mm(camera)
    weights = diffraction.square_weights(spread, pixels, camera.pixel_mm, along)
    middles = (along[1:] + along[:-1]) / 2
    weights[np.abs(pixels[:, None] - middles) > farthest] = 0
    return weights / weights.sum(axis=1, keepdims=True), reach


def _blur_matrix(camera: PlenopticCamera, lenslets: int):
    """Weights of all pieces in all pixels along an axis, sparse, of so many lenslets."""
    weights, reach = _piece_weights(camera)
    pieces = weights.shape[1] // (2 * reach + 1)
    pixel, piece = np.nonzero(weights)
    lenslet = np.arange(lenslets)[:, None]
    rows = lenslet * camera.views + pixel
    columns = ((lenslet - reach) * pieces + piece).clip(0, lenslets * pieces - 1)
    entries = np.tile(weights[pixel, piece], (lenslets, 1))
    shape = lenslets * camera.views, lenslets * pieces
    return sparse.coo_array((entries.ravel(), (rows.ravel(), columns.ravel())), shape)


def _lenslet_spread_mm(camera: PlenopticCamera) -> float:
    return _wavelength_mm(camera) * camera.lenslet_focal_mm / camera.lenslet_pitch_mm


def _wavelength_mm(camera: PlenopticCamera) -> float:
    if camera.wavelength_nm is None:
        raise InputError("Diffraction needs the camera's wavelength_nm, got none.")
    return camera.wavelength_nm * 1e-6
