"""Fit of a grid to the micro-images of a white image, from a first guess."""

import math
from dataclasses import replace
from itertools import product

import numpy as np
import scipy  # its parts load when they are used
from scipy import ndimage

from lf_flame.errors import InputError
from lf_flame.formats.raw.lenslet_grid import LensletGrid

SMOOTHING = math.sqrt(2) / (2 * math.pi)
"""Standard deviation, in pitches, of the Gaussian that locates a micro-image with least noise.

Noise in the gradient falls with sigma^-2, the gradient of a pattern of one pitch with
exp(-2 pi^2 sigma^2); their ratio is largest here.
"""

SHAPE_SMOOTHING = 0.12
"""Standard deviation, in pitches, of the Gaussian for the mean micro-image: it hardly changes the
shape, but widens narrow gaps."""

FIRST_REACH = 4
"""Number of lenslets around the central one with which the first guess is refined."""

WINDOW, WINDOWS = 20, 7
"""Side in pitches, and number along each axis, of the windows in which the micro-images of a large
image are located: some thousands suffice."""

LARGEST_RESIDUAL = 0.1
"""Largest root-mean-square distance, in pitches, of micro-images from the fitted grid."""


def no_grid(reason: str) -> InputError:
    """Error that says why no grid was found."""
    return InputError(
        f"No regular array of micro-images was found in the white image: {reason}; it must show "
        f"bright micro-images on darker gaps."
    )


def flattened(image: np.ndarray, width: float) -> np.ndarray:
    """Image over its local mean, minus 1: contrast without vignetting."""
    mean = image
    for _ in range(2):  # twice a box is a triangle, which squares the ripple left by a box
        mean = ndimage.uniform_filter(mean, 2 * round(width / 2) + 1)  # odd: symmetric
    return (image - mean) / np.maximum(mean, max(1e-3 * mean.max(), np.finfo(float).tiny))


def refine(grid: LensletGrid, white: np.ndarray) -> LensletGrid:
    """Fit a guessed grid to the micro-images, from the centre of the image outwards."""
    down, right = (_windows(length, grid.pitch) for length in white.shape)
    windows = list(product(down, right))
    middle = windows[len(windows) // 2]
    contrast = flattened(white[middle], 2 * grid.pitch)
    grid = _seen_from(middle, _in_phase(_seen_from(middle, grid), contrast), -1)
    shape = _mean_micro_image(_seen_from(middle, grid), contrast)
    likenesses = {}
    for window in windows:
        contrast = flattened(white[window], 2 * grid.pitch)
        likeness = scipy.signal.oaconvolve(contrast, shape, mode="same")
        likenesses[window[0].start, window[1].start] = ndimage.spline_filter(likeness)
    reach, extent = FIRST_REACH, max(len(i) for i in grid.indices(white.shape))
    while True:
        row, column, y, x, found = _micro_images(grid, likenesses, reach)
        if reach == FIRST_REACH and np.mean(found) < 0.5:
            raise no_grid("no micro-images are where it seemed to repeat itself")
        grid, residual = _fitted(grid, row, column, y, x, found)
        if reach >= extent:
            break
        reach *= 2
    if residual > LARGEST_RESIDUAL * grid.pitch:
        raise no_grid(f"what repeats itself is {residual:.2g} pixels off a grid")
    return grid


def _windows(length: int, pitch: float) -> list[slice]:
    """Parts of an axis in which micro-images are looked for: all of it, unless it is long."""
    side = math.ceil(WINDOW * pitch)
    if length <= WINDOWS * side:
        return [slice(0, length)]
    starts = np.linspace(0, length - side, WINDOWS).astype(int)
    return [slice(int(start), int(start) + side) for start in starts]


def _seen_from(window: tuple[slice, slice], grid: LensletGrid, sign: int = 1) -> LensletGrid:
    """Grid in the pixels of a window; with sign -1, back in those of the image."""
    down, right = window
    return replace(grid, y0=grid.y0 - sign * down.start, x0=grid.x0 - sign * right.start)


def _mean_micro_image(grid: LensletGrid, contrast: np.ndarray) -> np.ndarray:
    """Mean micro-image around the centre, made symmetric.

    Correlation with it, the matched filter, is the least noisy way to locate a known shape.
    """
    near = np.arange(-FIRST_REACH, FIRST_REACH + 1)
    centres = grid.position(near[:, None], near)
    half = round(grid.pitch / 2)
    pixels = np.mgrid[-half : half + 1, -half : half + 1]
    y, x = (np.add.outer(pixel, centre) for pixel, centre in zip(pixels, centres, strict=True))
    mean = _between(contrast, y, x).mean(axis=(2, 3))
    mean += mean[::-1, ::-1]
    return ndimage.gaussian_filter(mean - mean.mean(), SHAPE_SMOOTHING * grid.pitch)


def _in_phase(grid: LensletGrid, contrast: np.ndarray) -> LensletGrid:
    """Shift the grid within a cell to where the lenslets around the centre are brightest."""
    near = np.arange(-FIRST_REACH, FIRST_REACH + 1)
    y, x = grid.position(near[:, None], near)
    share = np.arange(16) / 16
    down, along = grid.turned(grid.row_pitch * share[:, None], grid.pitch * share)
    smooth = ndimage.gaussian_filter(contrast, SMOOTHING * grid.pitch)
    brightness = _between(smooth, np.add.outer(down, y), np.add.outer(along, x))
    best = np.unravel_index(brightness.mean(axis=(2, 3)).argmax(), down.shape)
    return replace(grid, y0=float(grid.y0 + down[best]), x0=float(grid.x0 + along[best]))


def _between(image: np.ndarray, y: np.ndarray, x: np.ndarray, order: int = 1) -> np.ndarray:
    """Values between the pixels of an image, or for order 3 of its spline coefficients."""
    return ndimage.map_coordinates(image, [y, x], order=order, mode="mirror", prefilter=False)


def _micro_images(grid: LensletGrid, likenesses: dict, reach: int):
    """Find micro-images up to `reach` lenslets from the central one.

    Parameters
    ----------
    likenesses : dict of (int, int) to ndarray
        Spline coefficients of the likeness to a micro-image in windows, by their first pixels.

    Returns rows and columns in the array, y, x, and whether each was found: its peak must not be
    much flatter than the others, and must be near its expected position.
    """
    seen = [
        _peaks_in_window(grid, first, likeness, reach) for first, likeness in likenesses.items()
    ]
    row, column, y, x, away, curvature = (np.concatenate(each) for each in zip(*seen, strict=True))
    if not row.size:
        raise no_grid("no micro-image lies clear of its border")
    found = (curvature > 0.2 * np.median(curvature)) & (away < grid.pitch / 4)
    return row, column, y, x, found


def _peaks_in_window(
    grid: LensletGrid, first: tuple[int, int], likeness: np.ndarray, reach: int
) -> tuple[np.ndarray, ...]:
    """Rows and columns of a window's micro-images, their y, x, distances and curvatures."""
    (top, left), (height, width) = first, likeness.shape
    local = replace(grid, y0=grid.y0 - top, x0=grid.x0 - left)
    rows, columns = (i[np.abs(i) <= reach] for i in local.indices(likeness.shape))
    row, column = (i.ravel() for i in np.meshgrid(rows, columns, indexing="ij"))
    y, x = local.position(row, column)
    clear = grid.pitch  # excludes those cut off by the border
    inside = (y >= clear) & (y <= height - 1 - clear) & (x >= clear) & (x <= width - 1 - clear)
    row, column, y, x = (values[inside] for values in (row, column, y, x))
    if not row.size:
        return row, column, y, x, y, x
    top_y, top_x, curvature = _peaks(likeness, y, x, grid.pitch / 6)
    return row, column, top_y + top, top_x + left, np.hypot(top_y - y, top_x - x), curvature


def _peaks(likeness: np.ndarray, y, x, step: float):
    """Peaks near y, x and the smaller of their curvatures along y and x.

    Parabolas are fitted again around their tops, which gives no bias for symmetric peaks even with
    wide steps.
    """
    for _ in range(4):
        top = _between(likeness, y, x, order=3)
        up, down = (_between(likeness, y + n, x, order=3) for n in (-step, step))
        left, right = (_between(likeness, y, x + n, order=3) for n in (-step, step))
        curvature = np.stack([2 * top - up - down, 2 * top - left - right])
        slope = np.stack([down - up, right - left]) / 2
        shift = step * slope / np.where(curvature > 0, curvature, np.inf)
        y, x = np.stack([y, x]) + np.clip(shift, -step, step)
    return y, x, curvature.min(axis=0)


def _fitted(grid: LensletGrid, row, column, y, x, found) -> tuple[LensletGrid, float]:
    """Fit a grid to points by least squares; also returns their root-mean-square distance.

    Points more than three times as far off as the median are left out.
    """
    kept = found
    for _ in range(4):
        if min(len(np.unique(row[kept])), len(np.unique(column[kept]))) < 3:
            raise no_grid("fewer than 3 x 3 micro-images stand clear of its border")
        grid = _least_squares(grid, row[kept], column[kept], y[kept], x[kept])
        fit_y, fit_x = grid.position(row, column)
        distance = np.hypot(fit_y - y, fit_x - x)
        kept = found & (distance <= 3 * np.median(distance[kept]))
    return grid, math.sqrt(np.mean(distance[kept] ** 2))


def _least_squares(grid: LensletGrid, row, column, y, x) -> LensletGrid:
    """Least squares in complex numbers: ``x + iy = z0 + turn (pitch along + i row_pitch row)``.

    The first fit has separate rotations for rows and columns; the second uses their mean, weighted
    by how far apart the points are.
    """
    along = column + (row % 2 / 2 if grid.layout == "hexagonal" else 0.0)
    z, design = x + 1j * y, np.stack([np.ones(len(row)), along, 1j * row], axis=1)
    (_, pitch, row_pitch), *_ = np.linalg.lstsq(design, z)
    turn = pitch * abs(pitch) * np.var(along) + row_pitch * abs(row_pitch) * np.var(row)
    turn /= abs(turn)
    pitch, row_pitch = (pitch / turn).real, (row_pitch / turn).real
    z0 = np.mean(z - turn * (pitch * along + 1j * row_pitch * row))
    return replace(
        grid,
        x0=float(z0.real),
        y0=float(z0.imag),
        pitch=float(pitch),
        rotation=float(np.angle(turn)),
        row_pitch=float(row_pitch),
    )
