"""Light fields from raw pictures of Lytro cameras: which white image, which grid, and the views."""

import logging
from pathlib import Path

import numpy as np

from lf_flame._common.printable import printable
from lf_flame.errors import InputError
from lf_flame.formats.images import LYTRO_SUFFIXES, is_lytro, read_image
from lf_flame.formats.lytro.picture import LytroPicture, read_lytro
from lf_flame.formats.lytro.white import find_white
from lf_flame.formats.raw.decode_plan import DecodePlan
from lf_flame.formats.raw.lenslet_grid import LensletGrid
from lf_flame.formats.raw.lenslet_search import estimate_grid

LOGGER = logging.getLogger(__name__)

AGREEMENT = 2e-3
"""Largest difference between a grid found in a picture and that of its metadata: in the pitches,
relative; in the rotation, in rad. Over half of an Illum's frame that is a half lenslet."""


def plan_lytro(
    path: str | Path,
    white: str | Path | None = None,
    views: int | None = None,
    *,
    lenslets: str | Path | None = None,
    dark: str | Path | None = None,
) -> tuple[DecodePlan, np.ndarray]:
    """Read a raw picture of a Lytro camera, and plan its decoding into linear colour views."""
    picture = read_lytro(path)
    black = None if dark is None else _as_mosaic(dark, picture, "dark")
    flat = None if white is None else _as_white(white, picture)
    if flat is None and picture.white_image is not None:
        flat = picture.white_image.radiance
    shown = flat if lenslets is None else _as_white(lenslets, picture)
    if shown is not None:
        grid = estimate_grid(shown)
    else:
        grid, origin = _grid_without_white(picture)
        LOGGER.warning(
            f"{printable(path)}: vignetting is not corrected, and outer views are too dark, as no "
            f"white image is given (--white with a MOD_*.RAW, its folder or caldata-"
            f"{printable(picture.metadata.serial or 'SERIAL', 40)}.tar); {origin}."
        )
    bayer, raw = picture.metadata.bayer, picture.radiance
    plan = DecodePlan(
        grid, shape=raw.shape, views=views, white=flat, dark=black, bayer=bayer, saturation=1.0
    )
    return plan, raw


def _as_white(white: str | Path, picture: LytroPicture) -> np.ndarray:
    """White image for a picture, linear in radiance, from a file, a folder or an archive."""
    if Path(white).is_dir() or Path(white).suffix.lower() == ".tar":
        return find_white(picture, white).radiance
    return _as_mosaic(white, picture, "white")


def _as_mosaic(path: str | Path, picture: LytroPicture, name: str) -> np.ndarray:
    """Mosaic like that of a picture, from a raw file of the camera; a white one from any image."""
    metadata = picture.metadata
    if is_lytro(path):
        other = read_lytro(path)
        _warn_of_camera(other, picture, name)
        image, bayer = other.radiance, other.metadata.bayer
    elif name == "white":  # in any unit
        image, bayer = read_image(path), metadata.bayer
    else:
        raise InputError(
            f"The {name} image of {picture.source} must be a raw file of the camera "
            f"({', '.join(LYTRO_SUFFIXES)}), got {path}."
        )
    if (*image.shape, bayer) != (*metadata.shape, metadata.bayer):
        raise InputError(
            f"The {name} image {path} must be a mosaic like {picture.source}, {metadata.bayer} of "
            f"shape {metadata.shape}, got {bayer} of shape {image.shape}."
        )
    return image


def _warn_of_camera(other: LytroPicture, picture: LytroPicture, name: str) -> None:
    """Warn of a white or dark image of another camera."""
    serials = other.metadata.serial, picture.metadata.serial
    if all(serials) and serials[0].upper() != serials[1].upper():
        LOGGER.warning(
            f"The {name} image {printable(other.source)} is of camera {printable(serials[0], 40)}, "
            f"the picture of {printable(serials[1], 40)}: lenslets and vignetting may not fit."
        )


def _grid_without_white(picture: LytroPicture) -> tuple[LensletGrid, str]:
    """Grid of a picture, and where it comes from, for a sentence."""
    stated = picture.metadata.grid
    if stated is None:
        raise InputError(
            f"The metadata of {picture.source} do not say where the lenslets are: give a white "
            f"image of the camera."
        )
    try:
        found = estimate_grid(picture.radiance, stated.pitch, stated.layout)
    except InputError:
        return stated, "the lenslets are where the metadata place them, as the picture shows none"
    if not _agrees(found, stated):
        return stated, (
            "the lenslets are where the metadata place them, as those found in the picture differ"
        )
    away = _distance(stated, found)
    return found, f"the lenslets were found in the picture, {away:.2g} pixels from the metadata's"


def _agrees(found: LensletGrid, stated: LensletGrid) -> bool:
    """Whether a found grid has the pitches and the rotation of the metadata."""
    return (
        abs(found.pitch / stated.pitch - 1) <= AGREEMENT
        and abs(found.row_pitch / stated.row_pitch - 1) <= AGREEMENT
        and abs(found.rotation - stated.rotation) <= AGREEMENT
    )


def _distance(stated: LensletGrid, found: LensletGrid) -> float:
    """Distance in pixels from a stated micro-image to the nearest one that was found."""
    row = round((stated.y0 - found.y0) / found.row_pitch)
    column = round((stated.x0 - found.x0) / found.pitch)
    rows, columns = np.mgrid[row - 2 : row + 3, column - 2 : column + 3]
    y, x = found.position(rows, columns)
    return float(np.hypot(y - stated.y0, x - stated.x0).min())
