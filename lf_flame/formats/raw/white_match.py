"""Whether a white image fits a raw one: where its gaps are, the raw image must be dark.

A raw image is the white image times the scene's light, so that it has little light between the
white image's micro-images whatever the scene, however much of a micro-image it fills. A white image
of other lenslets, or one that was moved or turned, puts its gaps where the raw image is bright.
"""

from typing import NamedTuple

import numpy as np

from lf_flame.errors import InputError
from lf_flame.formats.raw.lenslet_grid import LensletGrid

SIDE = 4
"""Number of lenslets along a side of a block, whose micro-images are averaged. In larger blocks
micro-images of another pitch would average out."""

MOST = 2_000_000
"""Number of pixels up to which all blocks are looked at; of larger images an even choice is."""

FEWEST = 4
"""Smallest number of blocks that can show a misfit."""

GAP, MIDDLE = 0.2, 0.5
"""Brightness of the white image, from 0 in its darkest pixel to 1 in its brightest, up to which a
pixel is between micro-images, and from which it is within one."""

DARK_GAPS, DARK_PIXELS = 0.3, 0.5
"""Largest level of the darkest pixel, relative to the brightest, of a white and of a raw block that
show micro-images with gaps. A level of black that was left in is far below in a white image."""

REPEATED = 0.7
"""Smallest correlation of the two halves of a block's lenslets; noise alone has 0."""

DOUBTFUL, WRONG = 0.35, 0.6
"""Light between the white image's micro-images, relative to that in them, from which there is a
warning and a refusal. It is 0.02 to 0.15 where both fit, among them a real microscope's; up to 0.29
for the rim of a flame that fills a part of the micro-images only; 0.6 for a white image that is
moved by a quarter of a pitch, and about 1 for one of another pitch."""

MOVED = 0.4
"""Smallest gain in correlation, by moving the white image's micro-images, of a refusal. A white
image with a smaller aperture leaves gaps where the raw image is bright too, but in place."""

CLEAR = 1 / 3
"""Smallest share of the lit blocks of the raw image that show gaps, for a refusal. It is 0.39 to 1
for white images of 0.7 to 2 times the raw image's pitch, and at most 0.28 where the aperture fills
the micro-images, so that the raw image has no gaps."""


class Misfit(NamedTuple):
    """Measures of how badly a white image fits a raw one."""

    between: float
    """Light between the white image's micro-images, relative to that in them."""
    moved: float
    """Gain in correlation of raw and white micro-images by moving the latter."""
    clear: float
    """Share of the raw image's lit blocks that show gaps."""

    @property
    def certain(self) -> bool:
        """Whether nothing but a wrong white image explains it."""
        return self.between >= WRONG and self.moved >= MOVED and self.clear >= CLEAR


def check_match(flat: np.ndarray, light: np.ndarray) -> str:
    """Refuse a white image that does not fit the raw one; warn of one that fits badly.

    Parameters
    ----------
    flat, light : ndarray
        Mean micro-images of the white and of the raw image (`mean_micro_images`).

    Returns
    -------
    str
        A sentence, or nothing; it says nothing either where one of them shows no dark gaps.

    Raises
    ------
    InputError
        If the raw image is bright between the white image's micro-images, and not in them.
    """
    misfit = find_misfit(flat, light)
    if misfit.between < DOUBTFUL:
        return ""
    found = (
        f"between the white image's micro-images the raw image is {misfit.between:.0%} as bright "
        f"as in them, where it should be dark"
    )
    if misfit.certain:
        raise InputError(
            f"The white image does not fit the raw image: {found}; it is the wrong one, or was "
            f"turned, mirrored or moved; give the white image of the raw image's camera, lens and "
            f"aperture, as the sensor recorded it."
        )
    return (
        f"The white image may not fit the raw image: {found}; it may be of another camera, lens "
        f"or aperture, or turned or moved, and then slopes and brightness are wrong."
    )


def find_misfit(flat: np.ndarray, light: np.ndarray) -> Misfit:
    """Measure how badly mean micro-images of a white image fit those of a raw one."""
    lit = _repeated(flat) & _repeated(light)
    flat, light = flat[lit].mean(axis=1), light[lit].mean(axis=1)
    usable = _has_gaps(flat, DARK_GAPS) & _has_gaps(light, DARK_PIXELS)
    if np.count_nonzero(usable) < FEWEST:
        return Misfit(0.0, 0.0, 0.0)
    flat, light = (a - a.min(axis=(1, 2), keepdims=True) for a in (flat[usable], light[usable]))
    level = flat / flat.max(axis=(1, 2), keepdims=True)
    between, within = (
        (np.sum(light * at, axis=(1, 2)) / np.count_nonzero(at, axis=(1, 2))).sum()
        for at in (level <= GAP, level >= MIDDLE)
    )
    between /= max(within, np.finfo(np.float32).tiny)
    return Misfit(float(between), _gain_by_moving(flat, light), float(usable.mean()))


def mean_micro_images(image: np.ndarray, grid: LensletGrid, step: int) -> np.ndarray:
    """Mean micro-images of blocks of lenslets, by the places of a grid.

    Parameters
    ----------
    image : ndarray, shape (rows, columns, channels)
    grid : LensletGrid
    step : int
        Distance of pixels of one colour: 2 in a mosaic, else 1.

    Returns
    -------
    ndarray, shape (block, 2, y, x)
        Means over every other lenslet, and over the others. In a mosaic each value is the mean of
        2 x 2 pixels, one of each colour, so that a coloured scene has no pattern of its own.
    """
    centres, first = _blocks(grid, image.shape)
    down, along = (np.arange(-(int(n) // 2), int(n) // 2 + 1) for n in grid.window)
    blocks = max(FEWEST, MOST // (down.size * along.size * centres.shape[1]))
    if len(centres) > blocks:
        centres = centres[np.linspace(0, len(centres) - 1, blocks).astype(int)]
    y = np.clip(centres[..., 0, None, None] + down[:, None], 0, image.shape[0] - 1)
    x = np.clip(centres[..., 1, None, None] + along, 0, image.shape[1] - 1)
    pixels = image[y, x].mean(axis=4, dtype=np.float32)
    means = np.stack([pixels[:, half].mean(axis=1) for half in (first, ~first)], axis=1)
    if step == 1:
        return means
    means = means[..., 1:, :] + means[..., :-1, :]
    return (means[..., 1:] + means[..., :-1]) / 4


def _blocks(grid: LensletGrid, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Pixels at the centres of each block's lenslets, (block, lenslet, 2), and every other one."""
    centres = np.rint(grid.centres(shape)).astype(int)
    rows, columns = (min(SIDE, n) for n in centres.shape[:2])
    down, along = centres.shape[0] // rows, centres.shape[1] // columns
    whole = centres[: down * rows, : along * columns].reshape(down, rows, along, columns, 2)
    first = np.add.outer(np.arange(rows), np.arange(columns)) % 2 == 0
    return whole.swapaxes(1, 2).reshape(down * along, rows * columns, 2), first.ravel()


def _repeated(halves: np.ndarray) -> np.ndarray:
    """Whether both halves of each block's lenslets show the same, shape (block,)."""
    contrast = halves - halves.mean(axis=(2, 3), keepdims=True)
    product = contrast.prod(axis=1).sum(axis=(1, 2))
    return product > REPEATED * np.sqrt((contrast**2).sum(axis=(2, 3)).prod(axis=1))


def _has_gaps(means: np.ndarray, darkest: float) -> np.ndarray:
    return means.min(axis=(1, 2)) < darkest * means.max(axis=(1, 2))


def _gain_by_moving(flat: np.ndarray, light: np.ndarray) -> float:
    """Rise of the correlation from that in place to the best one, weighted by the contrast."""
    flat, light = (a - a.mean(axis=(1, 2), keepdims=True) for a in (flat, light))
    spectrum = np.fft.rfft2(light) * np.fft.rfft2(flat).conj()
    product = np.fft.irfft2(spectrum, flat.shape[1:])
    gain = product.max(axis=(1, 2)) - product[:, 0, 0]
    pixels = flat[0].size
    return float((gain / flat.std(axis=(1, 2))).sum() / (pixels * light.std(axis=(1, 2)).sum()))
