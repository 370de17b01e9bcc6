"""Lenslet images: one image with a micro-image of N x N pixels under each lenslet."""

import math
from pathlib import Path

import numpy as np

from lf_flame.errors import InputError
from lf_flame.formats.images import read_image, to_levels, write_image
from lf_flame.formats.raw.lenslet_grid import grid_from_pitch
from lf_flame.formats.raw.sensor_images import refuse_mosaic
from lf_flame.lightfield import LightField


def read_lenslet_image(path: str | Path, views: int | None = None) -> LightField:
    """Read a rectified lenslet image, such as the ESLF files of the Lytro cameras.

    Parameters
    ----------
    path : str or Path
        Image with sides that are multiples of `views`; micro-images in sensor order, not turned.
    views : int
        Number of pixels under a lenslet along each axis; 14 in files of the Lytro Illum.

    Returns
    -------
    LightField
        Views, with values from 0 to 1.

    Raises
    ------
    InputError
        If the image cannot be read, `views` is missing or does not divide its sides, or a grey
        image shows the 2 x 2 pattern of a colour mosaic.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import LightField, formats
    >>> light_field = LightField(np.random.default_rng(1).uniform(size=(3, 3, 20, 30)))

    >>> formats.write_lenslet_image(light_field, "lenslets.png")
    >>> formats.read_lenslet_image("lenslets.png", 3)
    LightField(3 x 3 views of 20 x 30 pixels, grey)
    """
    raw = read_image(path)
    return LightField(cut_views(raw, views, path))


def cut_views(raw: np.ndarray, views: int | None, source: str | Path) -> np.ndarray:
    """Cut a raw lenslet array into views; if `views` does not fit, the error says what would."""
    if views is None or views < 1 or any(n % views for n in raw.shape[:2]):
        common = math.gcd(*raw.shape[:2])
        fit = [str(n) for n in range(2, min(common, 64) + 1) if common % n == 0]
        size = f"the {raw.shape[0]} x {raw.shape[1]} pixels of {source}"
        if views is None:
            raise InputError(
                f"To read {source} as a lenslet image, state the pixels under a lenslet (views), "
                f"which divide {size} ({', '.join(fit) or 'only 1 does'}); to decode a raw image, "
                f"give a white image or the pitch."
            )
        raise InputError(
            f"The pixels under a lenslet (views) must divide {size}, got {views}; "
            f"{', '.join(fit) or 'only 1'} would."
        )
    if raw.ndim == 2 and views >= 5:  # with fewer pixels under a lenslet, views look like colours
        refuse_mosaic(raw, grid_from_pitch(raw.shape, views), "lenslet")
    return LightField.from_raw(raw, views=views).views


def write_lenslet_image(
    light_field: LightField, path: str | Path, bits: int = 16, *, linear: bool = True
) -> None:
    """Write a lenslet image, PNG or TIFF by the ending.

    Parameters
    ----------
    light_field : LightField
        Values from 0 to 1, unless written as floats; grey, or with 1 or 3 channels.
    path : str or Path
    bits, linear : optional
        As in `write_light_field`.

    Raises
    ------
    InputError
        If values, channels or the ending do not fit.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import LightField, formats
    >>> light_field = LightField(np.random.default_rng(1).uniform(size=(3, 3, 20, 30)))

    >>> formats.write_lenslet_image(light_field, "lenslets.png")
    >>> formats.read_lenslet_image("lenslets.png", 3)
    LightField(3 x 3 views of 20 x 30 pixels, grey)
    """
    raw = light_field.to_raw()
    write_image(path, raw if bits == 32 else to_levels(raw, bits), linear=linear)
