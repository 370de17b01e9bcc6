"""Estimation of the micro-image positions from a white image (flat field)."""

import math
from dataclasses import replace

import numpy as np
import scipy  # its parts load when they are used
from numpy.typing import ArrayLike
from scipy import fft, ndimage

from lf_flame._common import progress
from lf_flame.errors import InputError
from lf_flame.formats.lenslet_grid import LensletGrid, check_layout

SMALLEST_PITCH = 4.0
"""Smallest pitch in pixels; a smaller micro-image has no shape that could be found."""

PATCH = 1024
"""Side in pixels of the central part of a white image that gives the first guess."""

NOISE_WIDTH = 1.0
"""Standard deviation in pixels of the Gaussian that suppresses noise in the first guess."""

LEAST_CORRELATION = 0.1
"""Smallest fraction of the white image's variance that must repeat from lenslet to lenslet."""

EQUAL_PEAKS = 0.5
"""Smallest fraction of the highest correlation with which a lag is one of the array's."""

SAME_PEAKS = 0.9
"""The same for lags shorter than a stated pitch, which may be structure inside micro-images."""

PITCH_MARGIN = 0.3
"""Largest relative error of a rough pitch."""

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

LARGEST_RESIDUAL = 0.1
"""Largest root-mean-square distance, in pitches, of micro-images from the fitted grid."""


def estimate_grid(
    white: ArrayLike, pitch: float | None = None, layout: str | None = None
) -> LensletGrid:
    """Find the micro-images in a white image (flat field): bright spots with darker gaps.

    The white image is divided by its local mean, which removes vignetting. The nearest peaks of
    its autocorrelation are the array's shortest vectors, whatever the shape of the micro-images.
    (The strongest peak of the spectrum may be a harmonic, as for round micro-images that touch in
    a hexagonal array.) Each micro-image is then located to a fraction of a pixel by correlation
    with a mean micro-image, and the grid is fitted to these points by least squares without
    outliers, from the centre of the image outwards.

    Parameters
    ----------
    white : array_like, shape (rows, columns) or (rows, columns, channels)
        White image with at least five lenslets along each side; channels are averaged, and a Bayer
        mosaic is allowed.
    pitch : float, optional
        Rough pitch in pixels, within 30 %. Default: found, from 4 pixels up.
    layout : {"rectangular", "hexagonal"}, optional
        Arrangement of the lenslets. Default: found.

    Returns
    -------
    LensletGrid
        Grid with row and column 0 at the centre of the image, and the measured row pitch.

    Raises
    ------
    InputError
        If the image cannot be used, or shows no grid, or none of that pitch and layout.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.formats import estimate_grid
    >>> y, x = np.mgrid[:120, :160] + 0.5
    >>> white = np.cos(np.pi * (y / 10 - 0.5)) ** 2 * np.cos(np.pi * (x / 10 - 0.5)) ** 2
    >>> grid = estimate_grid(white)
    >>> round(grid.pitch, 2), grid.layout
    (10.0, 'rectangular')
    """
    white = _as_white(white)
    if layout is not None:
        check_layout(layout)
    if pitch is not None and not SMALLEST_PITCH <= pitch <= min(white.shape) / 3:
        raise InputError(
            f"pitch must lie between {SMALLEST_PITCH:g} pixels and a third of the white image's "
            f"shorter side, {min(white.shape) / 3:.4g}, got {pitch}."
        )
    with progress.stage("Looking for the micro-images in the white image"):
        grid = _refine(_guess(white, pitch), white)
    if layout not in (None, grid.layout):
        raise InputError(
            f"layout must be {grid.layout}, which the white image shows, or left out, "
            f"got {layout!r}."
        )
    if grid.layout == "hexagonal" and abs(grid.rotation) > math.pi / 12:
        raise InputError(
            f"The white image's hexagonal array must stand in straight rows, got straight columns, "
            f"rows being {math.degrees(grid.rotation):.3g} degrees off; turn the images by "
            f"90 degrees (numpy.rot90)."
        )
    return grid


def _as_white(white: ArrayLike) -> np.ndarray:
    white = np.asarray(white)
    if white.ndim not in (2, 3) or white.size == 0 or white.dtype.kind not in "uif":
        raise InputError(
            f"A white image must be grey or coloured, (rows, columns[, channels]), "
            f"got an array of shape {white.shape} and type {white.dtype}."
        )
    white = white.astype(np.float64) if white.ndim == 2 else white.mean(axis=2, dtype=np.float64)
    if not np.all(np.isfinite(white)):
        raise InputError(
            f"A white image must be finite, "
            f"got {np.count_nonzero(~np.isfinite(white))} NaN or infinite pixels."
        )
    if min(white.shape) < 4 * SMALLEST_PITCH:
        raise InputError(
            f"A white image must be at least {4 * SMALLEST_PITCH:g} pixels high and wide, "
            f"got {white.shape[0]} x {white.shape[1]}."
        )
    return white


def _no_grid(reason: str) -> InputError:
    return InputError(
        f"No regular array of micro-images was found in the white image: {reason}; it must show "
        f"bright micro-images on darker gaps."
    )


def _flattened(image: np.ndarray, width: float) -> np.ndarray:
    """Image over its local mean, minus 1: contrast without vignetting."""
    mean = image
    for _ in range(2):  # twice a box is a triangle, which squares the ripple left by a box
        mean = ndimage.uniform_filter(mean, 2 * round(width / 2) + 1)  # odd: symmetric
    return (image - mean) / np.maximum(mean, max(1e-3 * mean.max(), np.finfo(float).tiny))


def _guess(white: np.ndarray, pitch: float | None) -> LensletGrid:
    """Grid from the shortest vectors of the autocorrelation, with an arbitrary phase."""
    one, other = _shortest_vectors(_middle(white), pitch)
    cosine = abs((one * other.conjugate()).real) / abs(one * other)
    if cosine < 0.25:  # half-way from a right angle to the 60 degrees of a hexagonal array
        layout, vectors = "rectangular", [one, other]
    else:
        third = one - other if (one * other.conjugate()).real > 0 else one + other
        layout, vectors = "hexagonal", [one, other, third]
    along = max((v if v.real >= 0 else -v for v in vectors), key=lambda v: v.real / abs(v))
    rotation = math.atan2(along.imag, along.real)
    area = abs((one.conjugate() * other).imag)
    y, x = ((n - 1) / 2 for n in white.shape)
    return LensletGrid(x, y, abs(along), rotation, layout, area / abs(along))


def _middle(white: np.ndarray) -> np.ndarray:
    starts = [max(0, (n - PATCH) // 2) for n in white.shape]
    return white[starts[0] : starts[0] + PATCH, starts[1] : starts[1] + PATCH]


def _shortest_vectors(patch: np.ndarray, pitch: float | None) -> tuple[complex, complex]:
    """Two shortest vectors ``x + iy`` that repeat the patch and are not parallel."""
    correlation = _autocorrelation(patch)
    reach = correlation.shape[0] // 2
    peak = correlation == ndimage.maximum_filter(correlation, 3)
    y, x = np.nonzero(peak[1:-1, 1:-1])
    height = correlation[y + 1, x + 1]
    lag = (x + 1 - reach) + 1j * (y + 1 - reach)
    height[np.abs(lag) < SMALLEST_PITCH] = 0
    closer = np.abs(lag) < (1 - PITCH_MARGIN) * (pitch or 0)
    needed = np.where(closer, SAME_PEAKS, EQUAL_PEAKS) * height.max(initial=0)
    lags = sorted(lag[height >= np.maximum(needed, LEAST_CORRELATION)], key=abs)
    if not lags:
        raise _no_grid("it does not repeat itself")
    if pitch is not None and not abs(abs(lags[0]) - pitch) <= PITCH_MARGIN * pitch:
        raise _no_grid(f"it repeats itself every {abs(lags[0]):.3g} pixels, not every {pitch:g}")
    across = [v for v in lags if abs((v.conjugate() * lags[0]).imag) > abs(v * lags[0]) / 2]
    if not across:
        raise _no_grid("it repeats itself in one direction only")
    one, other = (_parabola_top(correlation, v, reach) for v in (lags[0], across[0]))
    return one, other


def _parabola_top(correlation: np.ndarray, lag: complex, reach: int) -> complex:
    """Sub-pixel position of a correlation peak."""
    y, x = int(lag.imag) + reach, int(lag.real) + reach
    offsets = []
    for before, top, after in (correlation[y, x - 1 : x + 2], correlation[y - 1 : y + 2, x]):
        offsets.append((before - after) / (2 * (before - 2 * top + after)))
    return lag + complex(*offsets)


def _autocorrelation(patch: np.ndarray) -> np.ndarray:
    """Autocorrelation of a patch, 1 at lag 0, which is at the centre of the result."""
    contrast = _flattened(patch, min(patch.shape) / 4)
    window = np.hanning(patch.shape[0])[:, None] * np.hanning(patch.shape[1])
    size = [fft.next_fast_len(2 * n, real=True) for n in patch.shape]  # room for every lag
    fy, fx = fft.fftfreq(size[0])[:, None], fft.rfftfreq(size[1])
    low_pass = np.exp(-((2 * math.pi * NOISE_WIDTH) ** 2) * (fy**2 + fx**2))
    power = np.abs(fft.rfft2(window * contrast, size)) ** 2 * low_pass
    window_power = np.abs(fft.rfft2(window, size)) ** 2
    reach = min(patch.shape) // 3
    lags = np.arange(-reach, reach + 1)
    correlation, overlap = (fft.irfft2(p, size)[np.ix_(lags, lags)] for p in (power, window_power))
    if not correlation[reach, reach] > 1e-12 * overlap[reach, reach]:
        raise _no_grid("it is uniform")
    correlation = correlation / overlap
    return correlation / correlation[reach, reach]


def _refine(grid: LensletGrid, white: np.ndarray) -> LensletGrid:
    """Fit a guessed grid to the micro-images, from the centre of the image outwards."""
    contrast = _flattened(white, 2 * grid.pitch)
    grid = _in_phase(grid, contrast)
    likeness = ndimage.spline_filter(_likeness(grid, contrast))
    reach, extent = FIRST_REACH, max(len(i) for i in grid.indices(white.shape))
    while True:
        row, column, y, x, found = _micro_images(grid, likeness, reach)
        if reach == FIRST_REACH and np.mean(found) < 0.5:
            raise _no_grid("no micro-images are where it seemed to repeat itself")
        grid, residual = _fitted(grid, row, column, y, x, found)
        if reach >= extent:
            break
        reach *= 2
    if residual > LARGEST_RESIDUAL * grid.pitch:
        raise _no_grid(f"what repeats itself is {residual:.2g} pixels off a grid")
    return grid


def _likeness(grid: LensletGrid, contrast: np.ndarray) -> np.ndarray:
    """Correlate the image with its mean micro-image, made symmetric: a peak at each centre.

    This is the matched filter, the least noisy way to locate a known shape.
    """
    near = np.arange(-FIRST_REACH, FIRST_REACH + 1)
    centres = grid.position(near[:, None], near)
    half = round(grid.pitch / 2)
    pixels = np.mgrid[-half : half + 1, -half : half + 1]
    y, x = (np.add.outer(pixel, centre) for pixel, centre in zip(pixels, centres, strict=True))
    mean = _between(contrast, y, x).mean(axis=(2, 3))
    mean += mean[::-1, ::-1]
    even = ndimage.gaussian_filter(mean - mean.mean(), SHAPE_SMOOTHING * grid.pitch)
    return scipy.signal.oaconvolve(contrast, even, mode="same")


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


def _micro_images(grid: LensletGrid, likeness: np.ndarray, reach: int):
    """Find micro-images up to `reach` lenslets from the central one.

    Returns rows and columns in the array, y, x, and whether each was found: its peak must not be
    much flatter than the others, and must be near its expected position.
    """
    rows, columns = (i[np.abs(i) <= reach] for i in grid.indices(likeness.shape))
    row, column = (i.ravel() for i in np.meshgrid(rows, columns, indexing="ij"))
    y, x = grid.position(row, column)
    clear, (height, width) = grid.pitch, likeness.shape  # excludes those cut off by the border
    inside = (y >= clear) & (y <= height - 1 - clear) & (x >= clear) & (x <= width - 1 - clear)
    if not inside.any():
        raise _no_grid("no micro-image lies clear of its border")
    row, column, y, x = (values[inside] for values in (row, column, y, x))
    top_y, top_x, curvature = _peaks(likeness, y, x, grid.pitch / 6)
    found = curvature > 0.2 * np.median(curvature)
    found &= np.hypot(top_y - y, top_x - x) < grid.pitch / 4
    return row, column, top_y, top_x, found


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
            raise _no_grid("fewer than 3 x 3 micro-images stand clear of its border")
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
