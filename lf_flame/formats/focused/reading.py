"""Raw pictures of cameras with focused lenslets: reading them, and planning their views."""

from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from lf_flame.errors import InputError
from lf_flame.formats.focused.lenslets import FocusedLenslets
from lf_flame.formats.focused.raytrix import is_raytrix, read_raytrix
from lf_flame.formats.focused.views import FocusedPlan
from lf_flame.formats.images import is_lytro, read_image
from lf_flame.formats.raw.lenslet_search import estimate_grid
from lf_flame.formats.raw.sensor_images import less_dark, refuse_mosaic
from lf_flame.lightfield import LightField

LARGEST_SHIFT = 0.08
"""Largest displacement of the lenslets in a picture from those of the calibration, in pitches."""


def read_focused(
    path: str | Path,
    calibration: str | Path,
    *,
    virtual_depth: float | None = None,
    views: int | None = None,
    white: str | Path | None = None,
    dark: str | Path | None = None,
    bayer: str | None = None,
) -> LightField:
    """Read the raw picture of a camera with focused lenslets, such as a Raytrix, as views.

    Parameters
    ----------
    path : str or Path
        Raw picture: grey, in colour, or a Bayer mosaic.
    calibration : str or Path
        Calibration of a Raytrix camera (``.xml``), or a white image, in which the micro-images are
        found, and by which the picture is divided.
    virtual_depth : float, optional
        Virtual depth at which the views are rendered (`find_virtual_depth`). Default: the median
        of those found in the picture.
    views : int, optional
        Number of views along each axis; 1 for one picture in which everything is sharp.
    bayer : {"rggb", "bggr", "grbg", "gbrg"}, optional
        Colours of the upper left 2 x 2 pixels of a mosaic, row by row.
    white, dark : str or Path, optional
        White image (flat field) and image without light.

    Returns
    -------
    LightField

    Raises
    ------
    InputError
        If a file cannot be read, the calibration does not fit the picture, or no virtual depth is
        found or stated.

    Examples
    --------
    >>> import numpy as np
    >>> import tifffile
    >>> from lf_flame.formats import read_focused
    >>> y, x = np.indices((240, 320)) % 20 - 9.5
    >>> tifffile.imwrite("white.tif", np.clip(10.5 - np.hypot(y, x), 0, 1))
    >>> read_focused("white.tif", "white.tif", virtual_depth=4.0, views=3)
    LightField(3 x 3 views of 42 x 62 pixels, grey)
    """
    plan, image = plan_focused(
        path, calibration, virtual_depth=virtual_depth, views=views, white=white, dark=dark,
        bayer=bayer,
    )  # fmt: skip
    return plan.decode(image)


def plan_focused(
    path: str | Path,
    calibration: str | Path,
    *,
    virtual_depth: float | None = None,
    views: int | None = None,
    white: str | Path | None = None,
    dark: str | Path | None = None,
    bayer: str | None = None,
) -> tuple[FocusedPlan, np.ndarray]:
    """Read a raw picture, and plan its views and those of others by the same camera.

    Parameters and errors are those of `read_focused`.
    """
    if is_lytro(path):
        raise InputError(f"{path} is no raw picture of a camera with focused lenslets.")
    image = read_image(path)
    black = None if dark is None else read_image(dark)
    flat = None if white is None else read_image(white)
    if is_raytrix(calibration):
        lenslets = read_raytrix(calibration, image.shape)
        seen = image if flat is None else flat
        _check_fit(
            less_dark(seen, black, "raw" if flat is None else "white"), lenslets, calibration
        )
    else:
        shown = read_image(calibration)
        lenslets = FocusedLenslets(estimate_grid(less_dark(shown, black, "white")))
        flat = shown if flat is None else flat
    if bayer is None:
        refuse_mosaic(less_dark(image, black, "raw"), lenslets.grid, "raw")
    plan = FocusedPlan(
        lenslets, shape=image.shape, virtual_depth=virtual_depth, views=views, white=flat,
        dark=black, bayer=bayer,
    )  # fmt: skip
    return plan, image


def _check_fit(image: np.ndarray, lenslets: FocusedLenslets, calibration: object) -> None:
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
