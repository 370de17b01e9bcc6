"""Detection of colour mosaics (Bayer), so that such raw images are not read as grey ones.

The two pixels of each 2 x 2 on one of its diagonals are green. They are equally bright in any even
light, and brighter than red and blue together (in the mean of logarithms) in daylight, lamp light
and that of glowing soot.
"""

import math

import numpy as np

from lf_flame.errors import InputError
from lf_flame.formats.raw.bayer import PATTERNS
from lf_flame.formats.raw.lenslet_grid import LensletGrid

WEIGHTS = np.array([1.0, 4.0, 6.0, 4.0, 1.0])
"""Weights of the pixels around a micro-image's centre. Even and odd pixels get equal total weight
for constant light and for any cubic profile."""

SMALL_PITCH = 10.0
"""Pitch in pixels below which the profile of a grey micro-image may resemble a mosaic."""

LEAST_CONTRAST, LEAST_SMALL_CONTRAST = 0.15, 0.6
"""Smallest logarithm of (red blue / green^2) of a mosaic, from pitch SMALL_PITCH on and below.

With red and blue at half of green, as in daylight, it is 1.4; in lamp light (red 1, blue 0.4) 0.9.
It is 0 where the profile of a grey micro-image is a product of a function of y and one of x. Round
micro-images of an even pitch, with pixels that repeat like those of a mosaic, reach 0.12 if the lit
part has a radius of 2 pixels or more, and 0.54 at a radius of 1.2.
"""

GROUPS = 8
"""Number of groups of lenslets with separate contrasts, so that texture is not taken for colour."""

LEAST_DEVIATIONS = 8.0
"""Number of standard errors that a contrast must exceed."""


def refuse_mosaic(image: np.ndarray, grid: LensletGrid, name: str) -> None:
    """Refuse an image with the 2 x 2 pixel pattern of a Bayer mosaic.

    Parameters
    ----------
    image : ndarray, shape (rows, columns) or (rows, columns, channels)
        Image without its black level; one in colour is no mosaic.
    grid : LensletGrid
    name : str
        Name of the image, for the message.

    Raises
    ------
    InputError
        If, at the centres of the micro-images, the four pixels of each 2 x 2 differ in a way
        that no grey micro-image does.
    """
    image = np.atleast_3d(image)
    if image.shape[2] != 1:
        return
    sums = _phase_sums(image[..., 0], grid.centres(image.shape))
    if not np.all(sums > 0):  # too few lenslets, or no light
        return
    logs = np.log(sums)
    contrast = _certain(logs[:, 0, 0] + logs[:, 1, 1] - logs[:, 0, 1] - logs[:, 1, 0], grid)
    if contrast == 0:
        return
    raise InputError(
        f"The {name} image is a colour mosaic (Bayer), not grey: the four pixels of each 2 x 2 "
        f"have mean levels in the ratio {_ratio(sums)}; decode it as a raw image and state the "
        f"colours of the upper left four pixels, row by row, as the camera's maker gives them: "
        f"--bayer {_with_greens(contrast > 0)}, as the brighter diagonal is green in most light."
    )


def check_pattern(white: np.ndarray, grid: LensletGrid, bayer: str) -> str:
    """Refuse a pattern whose greens are not green in the white image; warn if that is likely.

    Parameters
    ----------
    white : ndarray, shape (rows, columns, 1)
        White image less its black level.
    grid : LensletGrid
    bayer : str
        Stated colours of the upper left 2 x 2 pixels, row by row.

    Returns
    -------
    str
        A sentence, or nothing.

    Raises
    ------
    InputError
        If the two greens differ more than the other two pixels do, and are darker.
    """
    sums = _phase_sums(white[..., 0], grid.centres(white.shape))
    if not np.all(sums > 0):
        return ""
    # The diagonal that is stated to be green first, then the other.
    logs = np.log(sums[:, [0, 1, 0, 1], [0, 1, 1, 0]]).reshape(-1, 2, 2)
    greens, others = np.moveaxis(logs if bayer[0] == "g" else logs[:, ::-1], 1, 0)
    unequal = _certain(_difference(greens) - _difference(others), grid)
    darker = _certain(others.sum(axis=1) - greens.sum(axis=1), grid)
    if unequal < 0 or (unequal == 0 and darker <= 0):
        return ""
    found = (
        f"in the white image the four pixels of each 2 x 2 have mean levels in the ratio "
        f"{_ratio(sums)}, by which the greens are on the other diagonal"
    )
    left = f"{_with_greens(bayer[0] != 'g')}, as the camera's maker gives them"
    if unequal > 0 and darker > 0:
        raise InputError(f"The colours cannot be in the order {bayer}: {found}; state {left}.")
    return f"The colours may not be in the order {bayer}: {found}; they may be {left}."


def _difference(pair: np.ndarray) -> np.ndarray:
    """Difference of two pixels in each group, shape (GROUPS,), positive in their mean."""
    difference = pair[:, 0] - pair[:, 1]
    return difference * np.sign(difference.mean())


def _certain(values: np.ndarray, grid: LensletGrid) -> float:
    """Mean over the groups, or 0 if texture or the profile of micro-images may be the reason."""
    mean, error = float(values.mean()), values.std(ddof=1) / math.sqrt(GROUPS)
    least = LEAST_CONTRAST if grid.pitch >= SMALL_PITCH else LEAST_SMALL_CONTRAST
    return mean if abs(mean) >= max(least, LEAST_DEVIATIONS * error) else 0.0


def _ratio(sums: np.ndarray) -> str:
    levels = sums.sum(axis=0) / sums.sum(axis=0).max()
    return ", ".join(f"{level:.2f}" for level in levels.flat)


def _with_greens(on_main: bool) -> str:
    """Patterns whose greens are on the diagonal from the upper left, or on the other one."""
    return " or ".join(name for name in PATTERNS if (name[0] == "g") == on_main)


def _phase_sums(image: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Sum the weighted light of pixels in even and odd rows and columns: (GROUPS, 2, 2)."""
    reach = len(WEIGHTS) // 2
    y, x = np.rint(centres.reshape(-1, 2)).astype(int).T
    inside = (y >= reach) & (y < image.shape[0] - reach)
    inside &= (x >= reach) & (x < image.shape[1] - reach)
    y, x = y[inside], x[inside]
    sums = np.zeros((GROUPS, 2, 2))
    group = np.arange(len(y)) % GROUPS
    for dy, weight_y in enumerate(WEIGHTS, -reach):
        for dx, weight_x in enumerate(WEIGHTS, -reach):
            light = weight_y * weight_x * image[y + dy, x + dx].astype(np.float64)
            np.add.at(sums, (group, (y + dy) % 2, (x + dx) % 2), light)
    return sums
