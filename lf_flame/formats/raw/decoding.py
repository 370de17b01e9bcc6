"""Decoding of a plenoptic camera's raw lenslet image into a light field.

Micro-image pixels stay in sensor order, not flipped (`lf_flame.lightfield`). The rows and columns
of views follow the array, so that a rotation of the array against the sensor is removed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lf_flame.formats.raw.decode_plan import DecodePlan, as_image
from lf_flame.formats.raw.lenslet_grid import LensletGrid
from lf_flame.lightfield import LightField


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

    For several images of one camera, `DecodePlan` does what is common to all of them once.

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
        If an argument cannot be used, no micro-image lies whole in the image, or a grey image
        shows the 2 x 2 pattern of a mosaic that is not stated.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.formats import decode_raw, grid_from_pitch
    >>> raw = np.random.default_rng(1).uniform(size=(60, 80))
    >>> decode_raw(raw, grid_from_pitch(raw.shape, 10.0))
    LightField(9 x 9 views of 6 x 8 pixels, grey)
    """
    as_image(raw, "raw")  # refused before its shape is planned with
    return DecodePlan(
        grid, shape=np.shape(raw), views=views, white=white, dark=dark, bayer=bayer
    ).decode(raw)
