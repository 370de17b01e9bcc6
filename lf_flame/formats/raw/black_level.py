"""Black level of a raw image, as it shows between its micro-images."""

import numpy as np

from lf_flame.formats.raw.lenslet_grid import LensletGrid

EVEN = 0.05
"""Largest scatter of the gaps, relative to that of the micro-images, that is no light: light in the
gaps, of micro-images that touch, differs as these do."""

UNEVEN = 0.2
"""Smallest scatter of the micro-images, relative to the brightest, that tells light from black."""

LEAST = 0.02
"""Smallest black level that is said, relative to the brightest micro-images."""

FEWEST = 20
"""Smallest number of gaps."""


def note_on_black(image: np.ndarray, grid: LensletGrid) -> str:
    """Say if the gaps between micro-images are even and far above 0, or nothing.

    Parameters
    ----------
    image : ndarray, shape (rows, columns, channels)
        Raw image from which no dark image was subtracted.
    grid : LensletGrid

    Returns
    -------
    str
        A sentence, or nothing; it says nothing either where micro-images are evenly bright, or no
        gap is dark.
    """
    centres = grid.centres(image.shape)
    down = grid.row_pitch / 2
    if grid.layout == "hexagonal":  # the place that is as far from three neighbours
        down = (grid.row_pitch**2 - grid.pitch**2 / 4) / (2 * grid.row_pitch)
    gaps = centres + np.array(grid.turned(down, grid.pitch / 2))
    light, black = (_values(image, places.reshape(-1, 2)) for places in (centres, gaps))
    if min(light.size, black.size) < FEWEST:
        return ""
    (dark, bright), (low, level, high) = (
        np.percentile(light, (5, 95)),
        np.percentile(black, (5, 50, 95)),
    )
    if level < LEAST * bright or bright - dark <= UNEVEN * bright:
        return ""
    if high - low > EVEN * (bright - dark):
        return ""
    return (
        f"The gaps between the micro-images are evenly at {level:.3g}, {level / bright:.0%} of the "
        f"bright micro-images: black is probably not 0 here, and all brightness is wrong; give a "
        f"dark image, taken with the lens covered (--dark)."
    )


def _values(image: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Values at the nearest pixels of places that lie in the image, mean over channels."""
    y, x = np.floor(places + 0.5).astype(int).T
    inside = (y >= 0) & (x >= 0) & (y < image.shape[0]) & (x < image.shape[1])
    return image[y[inside], x[inside]].mean(axis=1, dtype=np.float64)
