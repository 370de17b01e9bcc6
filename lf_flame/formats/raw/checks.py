"""Checks of raw, white and dark images against each other: a refusal, or one sentence.

Light comes to a pixel through its lenslet, so that a raw image is the white image times the
scene's light: dark between micro-images, whatever the scene. Black level, mosaic and a wrong white
or dark image show in the light at the centres of micro-images and in the gaps between them.
"""

import math

import numpy as np

from lf_flame.errors import InputError
from lf_flame.formats.raw.lenslet_grid import LensletGrid
from lf_flame.formats.raw.sensor_images import PATTERNS

LEAST_EVEN, LEAST_CONTRAST, LEAST_SMALL_CONTRAST = 0.03, 0.15, 0.6
"""Smallest logarithm of (red blue / green^2) of a mosaic: it is 1.4 in daylight, 0.9 in lamp light.
Round grey micro-images reach 0.12 if their pixels repeat like those of a mosaic, 0.54 below a pitch
of 10 pixels, and only differences of amplifiers where centres lie evenly on the four pixels."""

DOUBTFUL, WRONG = 0.4, 0.6
"""Light between the white image's micro-images relative to that in them, from which there is a
warning (0.01 to 0.37 where both fit, most with a flame beside the picture; 0.52 for a white image
that is moved by 0.22 of a pitch) and a refusal (0.78 for 0.35 of a pitch)."""


def refuse_mosaic(image: np.ndarray, grid: LensletGrid, name: str) -> None:
    """Refuse a grey image with the 2 x 2 pattern of a Bayer mosaic, which no grey one has."""
    sums, sign = _pattern(image, grid)
    if not sign:
        return
    levels = sums / sums.max()
    brighter = [one for one in PATTERNS if (one[0] == "g") == (sign > 0)]
    raise InputError(
        f"The {name} image is a colour mosaic (Bayer), not grey: the four pixels of each 2 x 2 "
        f"have mean levels in the ratio {', '.join(f'{level:.2f}' for level in levels.flat)}; "
        f"decode it as a raw image and state the colours of the upper left four pixels, row by "
        f"row, as the camera's maker gives them: --bayer {' or '.join(brighter)}, as the brighter "
        f"diagonal is green in most light."
    )


def note_on_colours(white: np.ndarray, grid: LensletGrid, bayer: str) -> str:
    """Say that the stated greens are darker than red and blue in the white image."""
    _, sign = _pattern(white, grid)
    if not sign or (sign > 0) == (bayer[0] == "g"):
        return ""
    return (
        f"The white image is darker in the pixels that are green by --bayer {bayer} than in the "
        f"others: unless its light is reddish, the order of the colours is another."
    )


def _pattern(image: np.ndarray, grid: LensletGrid) -> tuple[np.ndarray, int]:
    """Light of the pixels of each 2 x 2, and which diagonal is brighter: 1, -1, or 0 for neither.

    image: (rows, columns[, channels]), without its black level; one in colour is no mosaic. The
    pattern is that of the light around the centres of eight groups of lenslets, whose mean must
    exceed 8 standard errors: texture is then not taken for colour.
    """
    image, none = np.atleast_3d(image), (np.zeros((2, 2)), 0)
    if image.shape[2] != 1 or min(image.shape[:2]) < 2 * grid.pitch:
        return none
    centres = grid.centres(image.shape).reshape(-1, 2)
    is_even = abs(np.exp(1j * math.pi * centres.sum(axis=1)).mean()) < 0.01
    y, x = np.rint(centres).astype(int).T
    inside = (y >= 2) & (y < image.shape[0] - 2) & (x >= 2) & (x < image.shape[1] - 2)
    y, x = y[inside], x[inside]
    sums, group = np.zeros((8, 2, 2)), np.arange(len(y)) % 8
    # These weights have equal totals on even and odd pixels, for light that is constant or cubic.
    weights = np.outer([1.0, 4.0, 6.0, 4.0, 1.0], [1.0, 4.0, 6.0, 4.0, 1.0])
    for (dy, dx), weight in np.ndenumerate(weights):
        light = weight * image[y + dy - 2, x + dx - 2, 0].astype(np.float64)
        np.add.at(sums, (group, (y + dy) % 2, (x + dx) % 2), light)
    if not np.all(sums > 0):  # too few lenslets, or no light
        return none
    logs = np.log(sums)
    contrast = logs[:, 0, 0] + logs[:, 1, 1] - logs[:, 0, 1] - logs[:, 1, 0]
    least = LEAST_EVEN if is_even else LEAST_SMALL_CONTRAST if grid.pitch < 10 else LEAST_CONTRAST
    if abs(contrast.mean()) < max(least, 8 * contrast.std(ddof=1) / math.sqrt(8)):
        return none
    return sums.sum(axis=0), int(np.sign(contrast.mean()))


def refuse_spots(lit: np.ndarray) -> None:
    """Refuse a calibration with a closed aperture as a white image, by the views that it lights.

    An aperture that fills the micro-images lights 0.7 or more; spots of 5 pixels in 10 light 0.2.
    """
    if lit.size >= 25 and lit.mean() <= 0.25:
        raise InputError(
            f"The white image shows a small spot under each lenslet, which lights {lit.sum()} of "
            f"{lit.size} views: it is a calibration with a closed aperture, which shows where the "
            f"lenslets are, and not how bright the views are; give it as --lenslets, and as "
            f"--white one with the aperture of the raw image, or none."
        )


def note_on_white(white: np.ndarray) -> str:
    """Say that a white image is saturated: many of its pixels have the very highest level."""
    top = white.max()
    share = np.count_nonzero(white == top) / white.size
    if share < 0.01 or white.min() == top:
        return ""
    return (
        f"{share:.0%} of the white image's pixels have its highest level, {top:.4g}: if it is "
        f"saturated there, brightness is wrong by several per cent; expose it less."
    )


def check_dark(black: np.ndarray, light: np.ndarray, bright: float, grid: LensletGrid) -> str:
    """Refuse a dark image that is brighter than the raw one, or shows lenslets; note a high one.

    black, light: dark image, and raw image less it. bright: level of the bright pixels of the white
    or else of the raw image, with black.
    """
    (lit, gap), (centres, gaps) = (_at_centres_and_gaps(one, grid) for one in (black, light))
    if min(lit.size, gap.size) < 20:
        return ""
    level = float(np.median(black))
    error = 5 * max(np.std(gaps), np.std(centres), np.std(gap)) / math.sqrt(gaps.size)
    reach = max(0.05 * float(np.percentile(np.abs(centres), 95)), error)
    low = min(np.median(gaps), np.median(centres))
    shown = np.median(lit) - np.median(gap)
    noise = 5 * math.hypot(np.std(lit), np.std(gap)) / math.sqrt(lit.size)
    wrong = ""
    if low < -reach:
        wrong = f"less it, the median of the raw image's micro-images or gaps is {low:.3g}, below 0"
    elif shown > max(noise, 0.05 * abs(bright - level)):
        wrong = f"it shows the micro-images, {shown:.3g} brighter than the gaps between them"
    if wrong:
        raise InputError(
            f"The dark image does not fit: {wrong}; it must be taken with the lens covered, at the "
            f"exposure and with the number of bits of the raw image."
        )
    if bright <= level or level <= 0.15 * bright:
        return ""
    return (
        f"The dark image is at {level:.3g}, {level / bright:.0%} of the bright pixels: more than a "
        f"sensor's black level usually is; if it was not taken with the lens covered, at the raw "
        f"image's exposure, all brightness is wrong."
    )


def note_on_black(image: np.ndarray, grid: LensletGrid) -> str:
    """Say if the gaps between micro-images are even and far above 0, without a dark image.

    Light in the gaps, of micro-images that touch, differs as these do.
    """
    light, black = _at_centres_and_gaps(image, grid)
    if min(light.size, black.size) < 20:
        return ""
    dark, bright = np.percentile(light, (5, 95))
    low, level, high = np.percentile(black, (5, 50, 95))
    uneven = bright - dark
    if level < 0.02 * bright or uneven <= 0.2 * bright or high - low > 0.05 * uneven:
        return ""
    return (
        f"The gaps between the micro-images are evenly at {level:.3g}, {level / bright:.0%} of the "
        f"bright micro-images: black is probably not 0 here, and all brightness is wrong; give a "
        f"dark image, taken with the lens covered (--dark)."
    )


def _at_centres_and_gaps(image: np.ndarray, grid: LensletGrid) -> tuple[np.ndarray, np.ndarray]:
    """Values at the centres of micro-images, and at the places farthest from all of them."""
    centres = grid.centres(image.shape)
    down = grid.row_pitch / 2
    if grid.layout == "hexagonal":  # the place that is as far from three neighbours
        down = (grid.row_pitch**2 - grid.pitch**2 / 4) / (2 * grid.row_pitch)
    found = []
    for places in (centres, centres + np.array(grid.turned(down, grid.pitch / 2))):
        y, x = np.floor(places.reshape(-1, 2) + 0.5).astype(int).T
        inside = (y >= 0) & (x >= 0) & (y < image.shape[0]) & (x < image.shape[1])
        found.append(image[y[inside], x[inside]].mean(axis=1, dtype=np.float64))
    return found[0], found[1]


def check_match(flat: np.ndarray, light: np.ndarray, lit: np.ndarray) -> str:
    """Refuse a white image that does not fit the raw one; say of one that fits badly.

    flat, light: mean micro-images of the white and the raw image, from `mean_micro_images`. lit:
    views that the white image lights. Nothing is said where one of them shows no dark gaps.
    """
    usable = np.ones(len(flat), bool)
    for halves in (flat, light):  # both show the same; of noise alone they correlate by 0
        contrast = halves - halves.mean(axis=(2, 3), keepdims=True)
        power = (contrast**2).sum(axis=(2, 3)).prod(axis=1)
        usable &= contrast.prod(axis=1).sum(axis=(1, 2)) > 0.7 * np.sqrt(power)
    flat, light = flat[usable].mean(axis=1), light[usable].mean(axis=1)
    shown = (flat.min(axis=(1, 2)) < 0.3 * flat.max(axis=(1, 2))) & (
        light.min(axis=(1, 2)) < 0.5 * light.max(axis=(1, 2))
    )
    if np.count_nonzero(shown) < 4:
        return ""
    flat, light = (a - a.min(axis=(1, 2), keepdims=True) for a in (flat[shown], light[shown]))
    level = flat / flat.max(axis=(1, 2), keepdims=True)
    between, within = (
        (np.sum(light * at, axis=(1, 2)) / np.count_nonzero(at, axis=(1, 2))).sum()
        for at in (level <= 0.2, level >= 0.5)
    )
    between = float(between / max(within, np.finfo(np.float32).tiny))
    if between < DOUBTFUL:
        return ""
    refuse_spots(lit)
    found = (
        f"between the white image's micro-images the raw image is {between:.0%} as bright as in "
        f"them, where it should be dark"
    )
    if between >= WRONG:
        raise InputError(
            f"The white image does not fit the raw image: {found}; it is the wrong one, or was "
            f"turned, mirrored or moved; give the white image of the raw image's camera, lens and "
            f"aperture, as the sensor recorded it."
        )
    return (
        f"The white image may not fit the raw image: {found}; it may be of another camera, lens "
        f"or aperture, or turned or moved, and then slopes and brightness are wrong."
    )


def mean_micro_images(image: np.ndarray, grid: LensletGrid, step: int) -> np.ndarray:
    """Mean micro-images of blocks of 4 x 4 lenslets, each in two halves: (block, 2, y, x).

    In larger blocks micro-images of another pitch would average out. In a mosaic each value is the
    mean of 2 x 2 pixels, so that a coloured scene has no pattern of its own.
    """
    centres = np.rint(grid.centres(image.shape)).astype(int)
    rows, columns = (min(4, n) for n in centres.shape[:2])
    down, along = centres.shape[0] // rows, centres.shape[1] // columns
    whole = centres[: down * rows, : along * columns].reshape(down, rows, along, columns, 2)
    centres = whole.swapaxes(1, 2).reshape(down * along, rows * columns, 2)
    first = (np.add.outer(np.arange(rows), np.arange(columns)) % 2 == 0).ravel()
    dy, dx = (np.arange(-(int(n) // 2), int(n) // 2 + 1) for n in grid.window)
    blocks = max(4, 2_000_000 // (dy.size * dx.size * centres.shape[1]))  # an even choice
    if len(centres) > blocks:
        centres = centres[np.linspace(0, len(centres) - 1, blocks).astype(int)]
    y = np.clip(centres[..., 0, None, None] + dy[:, None], 0, image.shape[0] - 1)
    x = np.clip(centres[..., 1, None, None] + dx, 0, image.shape[1] - 1)
    pixels = image[y, x].mean(axis=4, dtype=np.float32)
    means = np.stack([pixels[:, half].mean(axis=1) for half in (first, ~first)], axis=1)
    if step == 1:
        return means
    means = means[..., 1:, :] + means[..., :-1, :]
    return (means[..., 1:] + means[..., :-1]) / 4
