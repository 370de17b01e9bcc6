"""Raw lenslet images: reading and decoding them, and planning that for many."""

import logging
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from lf_flame._common.input_files import printable
from lf_flame.errors import InputError
from lf_flame.formats.images import is_lytro, read_image
from lf_flame.formats.lytro.picture import read_lytro
from lf_flame.formats.lytro.white import mosaic_like
from lf_flame.formats.raw.decode_plan import DecodePlan
from lf_flame.formats.raw.lenslet_grid import LensletGrid, grid_from_pitch
from lf_flame.formats.raw.lenslet_search import estimate_grid
from lf_flame.formats.raw.sensor_images import as_image, subtract_dark
from lf_flame.lightfield import LightField

LOGGER = logging.getLogger(__name__)


def decode_raw(
    raw: ArrayLike,
    grid: LensletGrid,
    views: int | None = None,
    white: ArrayLike | None = None,
    *,
    dark: ArrayLike | None = None,
    bayer: str | None = None,
) -> LightField:
    """Resample the micro-images of a raw lenslet image into views.

    For several images of one camera, `DecodePlan` prepares once what they share.

    Parameters
    ----------
    raw : array_like, shape (rows, columns) or (rows, columns, channels)
        Image, linear in radiance, of any real type.
    grid, views, white, dark, bayer : optional
        As in `DecodePlan`.

    Returns
    -------
    LightField
        Views of the largest block of whole micro-images, with the weights of views.

    Raises
    ------
    InputError
        If an argument cannot be used, no micro-image lies entirely in the image, or a grey image
        shows the 2 x 2 pattern of a mosaic that is not stated.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.formats import decode_raw, grid_from_pitch
    >>> raw = np.random.default_rng(1).uniform(size=(60, 80))
    >>> decode_raw(raw, grid_from_pitch(raw.shape, 10.0))
    LightField(9 x 9 views of 6 x 8 pixels, grey)
    """
    image, shape = as_image(raw, "raw"), np.shape(raw)
    plan = DecodePlan(grid, shape=shape, views=views, white=white, dark=dark, bayer=bayer)
    return plan.decode(image)


def read_raw(
    path: str | Path,
    white: str | Path | None = None,
    pitch: float | None = None,
    layout: str | None = None,
    views: int | None = None,
    *,
    lenslets: str | Path | None = None,
    dark: str | Path | None = None,
    bayer: str | None = None,
) -> tuple[LightField, LensletGrid]:
    """Read and decode the raw lenslet image of any plenoptic camera.

    Parameters
    ----------
    path : str or Path
        Raw image: grey, in colour, or a Bayer mosaic; or a raw picture of a Lytro camera,
        decoded into views in the camera's colours: a container (``.lfp``, ``.lfr``), or packed
        pixels (``.raw``) with their metadata beside them, in ``.json`` or ``.txt``.
    white : str or Path, optional
        White image (flat field), in which the micro-images are found and by which the views are
        divided, as in `DecodePlan`. For a Lytro picture also the camera's folder of MOD_*.RAW and
        MOD_*.TXT, or ``caldata-SERIAL.tar``, of which the nearest in zoom and focus is taken;
        default: the one in the picture's file, else the lenslets are found in the picture.
    pitch : float, optional
        Distance between micro-images in pixels. With a white image a rough value suffices. Without
        one it is required, and the array is assumed to be upright and centred in the image.
    layout : {"rectangular", "hexagonal"}, optional
        Arrangement of the lenslets. Default: found in the white image; rectangular without one.
    views : int, optional
        Number of views along each axis. Default: the largest odd number not above the rounded
        pitch.
    lenslets : str or Path, optional
        Image that shows where the lenslets are, and leaves the views' brightness alone: a picture
        with the main lens's aperture closed, in which each lenslet makes a spot, a white image, or
        the raw image itself, if its gaps between micro-images are seen. Default: the white image.
    dark : str or Path, optional
        Image without light, which is subtracted from raw, white and lenslet image.
    bayer : {"rggb", "bggr", "grbg", "gbrg"}, optional
        Colours of the upper left 2 x 2 pixels of a mosaic, row by row. Default: those that a Lytro
        picture states, otherwise no mosaic.

    Returns
    -------
    LightField
        Decoded views.
    LensletGrid
        Positions of the micro-images.

    Raises
    ------
    InputError
        If a file cannot be read, no grid is found, neither white image, lenslets nor pitch are
        given, or one image is of other lenslets, or rotated or shifted relative to the raw image.

    Examples
    --------
    >>> import numpy as np
    >>> import tifffile
    >>> from lf_flame.formats import read_raw
    >>> raw = np.random.default_rng(1).uniform(size=(60, 80))
    >>> tifffile.imwrite("raw.tif", raw)
    >>> light_field, grid = read_raw("raw.tif", pitch=10.0)
    >>> light_field
    LightField(9 x 9 views of 6 x 8 pixels, grey)
    """
    stated = {"pitch": pitch, "layout": layout, "views": views, "bayer": bayer}
    plan, image = plan_raw(path, white=white, lenslets=lenslets, dark=dark, **stated)
    return plan.decode(image), plan.grid


def read_frame(path: str | Path) -> np.ndarray:
    """Read a raw image for `DecodePlan.decode`, linear in radiance."""
    return read_lytro(path).radiance if is_lytro(path) else read_image(path)


def plan_raw(
    path: str | Path, *, white=None, lenslets=None, dark=None, pitch=None, layout=None, bayer=None,
    views=None,
) -> tuple[DecodePlan, np.ndarray]:  # fmt: skip
    """Read a raw image, and plan its decoding and that of others; arguments as in `read_raw`."""
    files = {"white": white, "dark": dark, "lenslet": lenslets}
    if is_lytro(path):
        picture = read_lytro(path)
        image, bayer = picture.radiance, bayer or picture.metadata.bayer
        others = {name: mosaic_like(picture, one, name) for name, one in files.items()}
        if others["white"] is None:
            LOGGER.warning(
                f"{printable(path)}: vignetting is not corrected, and outer views are too dark, as "
                f"no white image is given (--white)."
            )
            if others["lenslet"] is None:  # they are where the picture shows them
                others["lenslet"] = image
    else:
        image = read_image(path)
        others = {name: one if one is None else read_image(one) for name, one in files.items()}
    flat, black = others["white"], others["dark"]
    kind = "white" if others["lenslet"] is None else "lenslet"
    if (shown := others[kind]) is not None:
        grid = estimate_grid(subtract_dark(shown, black, kind, image.shape), pitch, layout)
    elif pitch is not None:
        grid = grid_from_pitch(image.shape, pitch, layout or "rectangular")
    else:
        raise InputError(
            f"To decode {path}, a white image, an image of the lenslets or the pitch in pixels "
            f"must be given."
        )
    plan = DecodePlan(grid, shape=image.shape, views=views, white=flat, dark=black, bayer=bayer)
    return plan, image
