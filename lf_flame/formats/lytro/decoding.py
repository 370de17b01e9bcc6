"""Light fields from raw pictures of Lytro cameras: which white image, which grid, and the views."""

import logging
from pathlib import Path

import numpy as np

from lf_flame._common.input_files import printable
from lf_flame.errors import InputError
from lf_flame.formats.images import is_lytro, read_image
from lf_flame.formats.lytro.picture import LytroPicture, read_lytro
from lf_flame.formats.lytro.white import find_white
from lf_flame.formats.raw.decode_plan import DecodePlan
from lf_flame.formats.raw.lenslet_grid import LensletGrid
from lf_flame.formats.raw.lenslet_search import estimate_grid

LOGGER = logging.getLogger(__name__)


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
    black, flat, shown = (
        None if other is None else _mosaic_like(other, picture, name)
        for other, name in ((dark, "dark"), (white, "white"), (lenslets, "lenslet"))
    )
    if flat is None and picture.white_image is not None:
        flat = picture.white_image.radiance
    shown = flat if shown is None else shown
    if shown is not None:
        grid = estimate_grid(shown)
    else:
        grid, origin = _grid_without_white(picture)
        LOGGER.warning(
            f"{printable(path)}: vignetting is not corrected, and outer views are too dark, as no "
            f"white image is given (--white with a MOD_*.RAW, its folder or caldata-"
            f"{printable(picture.metadata.serial or 'SERIAL', 40)}.tar); the lenslets are where "
            f"{origin}."
        )
    bayer, raw = picture.metadata.bayer, picture.radiance
    plan = DecodePlan(
        grid, shape=raw.shape, views=views, white=flat, dark=black, bayer=bayer, saturation=1.0
    )
    return plan, raw


def _mosaic_like(path: str | Path, picture: LytroPicture, name: str) -> np.ndarray:
    """Mosaic like that of a picture, linear in radiance, from another file.

    From a raw file of the camera; but for a dark one, also from an image in any unit, or from the
    camera's folder or archive of white images.
    """
    metadata = picture.metadata
    if name != "dark" and (Path(path).is_dir() or Path(path).suffix.lower() == ".tar"):
        return find_white(picture, path).radiance
    if is_lytro(path):
        other = read_lytro(path)
        image, bayer, serial = other.radiance, other.metadata.bayer, other.metadata.serial
        if serial and metadata.serial and serial.upper() != metadata.serial.upper():
            LOGGER.warning(
                f"The {name} image {printable(path)} is of camera {printable(serial, 40)}, the "
                f"picture of {printable(metadata.serial, 40)}: lenslets and vignetting may not fit."
            )
    elif name != "dark":
        image, bayer = read_image(path), metadata.bayer
    else:
        raise InputError(
            f"The dark image of {picture.source} must be a raw file of the camera, got {path}."
        )
    if (*image.shape, bayer) != (*metadata.shape, metadata.bayer):
        raise InputError(
            f"The {name} image {path} must be a mosaic like {picture.source}, {metadata.bayer} of "
            f"shape {metadata.shape}, got {bayer} of shape {image.shape}."
        )
    return image


def _grid_without_white(picture: LytroPicture) -> tuple[LensletGrid, str]:
    """Grid of a picture, and where it comes from."""
    stated = picture.metadata.grid
    if stated is None:
        raise InputError(
            f"The metadata of {picture.source} do not say where the lenslets are: give a white "
            f"image of the camera."
        )
    try:
        found = estimate_grid(picture.radiance, stated.pitch, stated.layout)
    except InputError:
        return stated, "the metadata place them, as the picture shows none"
    differs = max(
        abs(found.pitch / stated.pitch - 1),
        abs(found.row_pitch / stated.row_pitch - 1),
        abs(found.rotation - stated.rotation),
    )
    if differs > 2e-3:  # half a lenslet over half of an Illum's frame
        return stated, "the metadata place them, as those found in the picture differ"
    return found, "the picture shows them"
