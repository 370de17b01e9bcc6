"""Search for the lenslets in an image that shows them: a white image, spots, or a raw image.

Only the array repeats over long distances: the contents of a raw image repeat with nearly its
period, but only over the few lenslets that see the same point. The array's frequencies are
therefore the sharp lines of the spectrum.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np
import scipy  # its parts load when they are used
from numpy.typing import ArrayLike
from scipy import fft, ndimage

from lf_flame.errors import InputError
from lf_flame.formats.raw.lenslet_grid import LensletGrid
from lf_flame.formats.raw.sensor_images import as_image

FIRST_REACH = 4
"""Number of lenslets around the central one with which the first guess is refined."""

WINDOW, WINDOWS = 20, 7
"""Side in pitches, and number along each axis, of the windows in which the micro-images of a large
image are located: several thousand suffice."""


def estimate_grid(
    white: ArrayLike, pitch: float | None = None, layout: str | None = None
) -> LensletGrid:
    """Find the lenslets in an image: a white image, spots, or a raw image that shows the array.

    The image is divided by its local mean, which removes vignetting. The nearest peaks of its
    autocorrelation are about the array's shortest vectors, whatever the shape of the micro-images;
    the sharp lines of the spectrum nearby make them exact. (The strongest line may be a harmonic,
    as for round micro-images that touch in a hexagonal array.) Correlation with the mean
    micro-image and its neighbours, in which gaps weigh more than contents, then locates each one to
    a fraction of a pixel, and the grid is fitted by least squares without outliers, from the
    centre of the image outwards.

    Parameters
    ----------
    white : array_like, shape (rows, columns) or (rows, columns, channels)
        Image of at least four lenslets along each side: a white image (flat field); spots, which
        the lenslets make of a bright field with the main lens's aperture closed; or a raw image
        whose gaps between micro-images are seen. Channels are averaged; it may be a Bayer mosaic.
    pitch : float, optional
        Rough pitch in pixels, within 30 %. Default: found, from 4 pixels up.
    layout : {"rectangular", "hexagonal"}, optional
        Arrangement of the lenslets. Default: found.

    Returns
    -------
    LensletGrid
        Grid with row and column 0 at the centre of the image, and the measured row pitch; of
        straight columns, if the lenslets form such.

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
    image = as_image(white, "white").mean(axis=2, dtype=np.float64)
    for i, j in np.ndindex(*np.minimum(image.shape, 2).tolist()):  # colours of a mosaic
        image[i::2, j::2] /= image[i::2, j::2].mean() or 1.0
    grid = _guess(image, pitch)
    # Rows of an array in straight columns would be 30 degrees off.
    if grid.layout == "hexagonal" and abs(grid.rotation) > math.pi / 12:
        grid = _refined(_guess(image.T, pitch), image.T)
        grid = replace(grid, x0=grid.y0, y0=grid.x0, columns=True)
    else:
        grid = _refined(grid, image)
    if layout not in (None, grid.layout):
        raise InputError(
            f"layout must be {grid.layout}, as in the white image, or left out, got {layout!r}."
        )
    return grid


def _no_grid(reason: str) -> InputError:
    return InputError(
        f"No regular array of micro-images was found in the image: {reason}; it must show bright "
        f"micro-images on darker gaps."
    )


def flattened(image: np.ndarray, width: float) -> np.ndarray:
    """Image over its local mean, minus 1: contrast without vignetting."""
    mean = image
    for _ in range(2):  # twice a box is a triangle, which squares the ripple left by a box
        mean = ndimage.uniform_filter(mean, 2 * round(width / 2) + 1)  # odd: symmetric
    return (image - mean) / np.maximum(mean, max(1e-3 * mean.max(), np.finfo(float).tiny))


def _guess(white: np.ndarray, pitch: float | None) -> LensletGrid:
    """Grid of about the right vectors, with an arbitrary phase."""
    top, left = (max(0, (n - 1024) // 2) for n in white.shape)
    patch = white[top : top + 1024, left : left + 1024]  # the central part suffices
    vectors = _sharpened(_shortest_vectors(patch, pitch), patch)
    one, other = sorted(vectors, key=abs)
    # Half-way from a right angle to the 60 degrees of a hexagonal array.
    is_square = abs((one * other.conjugate()).real) < abs(one * other) / 4
    third = [] if is_square else [min(one - other, one + other, key=abs)]
    ahead = (v if v.real >= 0 else -v for v in (one, other, *third))
    along = max(ahead, key=lambda v: v.real / abs(v))
    area = abs((one.conjugate() * other).imag)
    y, x = ((n - 1) / 2 for n in white.shape)
    layout = "rectangular" if is_square else "hexagonal"
    turn = math.atan2(along.imag, along.real)
    return LensletGrid(x, y, abs(along), turn, layout, area / abs(along))


def _shortest_vectors(patch: np.ndarray, pitch: float | None) -> tuple[complex, complex]:
    """Two shortest vectors ``x + iy`` that repeat the patch and are not parallel."""
    correlation = _autocorrelation(patch)
    reach = correlation.shape[0] // 2
    y, x = np.nonzero((correlation == ndimage.maximum_filter(correlation, 3))[1:-1, 1:-1])
    height = correlation[y + 1, x + 1]
    lag = (x + 1 - reach) + 1j * (y + 1 - reach)
    height[np.abs(lag) < 4] = 0  # a smaller micro-image has no shape that could be found
    # A lag is one of the array's from half of the highest correlation.
    lags = sorted(lag[height >= max(0.5 * height.max(initial=0), 0.1)], key=abs)
    if not lags:
        raise _no_grid("it does not repeat itself")
    if pitch is not None and not abs(abs(lags[0]) - pitch) <= 0.3 * pitch:
        raise _no_grid(f"it repeats itself every {abs(lags[0]):.3g} pixels, not every {pitch:g}")
    across = [v for v in lags if abs((v.conjugate() * lags[0]).imag) > abs(v * lags[0]) / 2]
    if not across:
        raise _no_grid("it repeats itself in one direction only")
    exact = []
    for found in (lags[0], across[0]):
        y, x = int(found.imag) + reach, int(found.real) + reach
        down, along = correlation[y - 1 : y + 2, x], correlation[y, x - 1 : x + 2]
        exact.append(found + complex(_top(*along), _top(*down)))
    return exact[0], exact[1]


def _top(before: float, middle: float, after: float) -> float:
    """Position of the top of the parabola through values at -1, 0 and 1."""
    return (before - after) / (2 * (before - 2 * middle + after))


def _autocorrelation(patch: np.ndarray) -> np.ndarray:
    """Autocorrelation of a patch, 1 at lag 0, which is at the centre of the result."""
    (height, width), reach = patch.shape, min(patch.shape) // 3
    window = np.outer(np.hanning(height), np.hanning(width))
    contrast = ndimage.gaussian_filter(window * flattened(patch, min(patch.shape) / 4), 1)
    near = np.s_[height - 1 - reach : height + reach, width - 1 - reach : width + reach]
    correlation, overlap = (
        scipy.signal.fftconvolve(one, one[::-1, ::-1])[near] for one in (contrast, window)
    )
    if not correlation[reach, reach] > 1e-12 * overlap[reach, reach]:
        raise _no_grid("it is uniform")
    correlation = correlation / overlap
    return correlation / correlation[reach, reach]


def _sharpened(vectors: tuple[complex, complex], patch: np.ndarray) -> tuple[complex, complex]:
    """Vectors of the array by the sharp lines of the spectrum next to those of rough vectors.

    A line is sharp by its ratio to the mean around it: that of contents is broad.
    """
    longest = max(map(abs, vectors))
    if min(patch.shape) < 12 * longest:  # too few lenslets for sharp lines
        return vectors
    contrast = np.clip(flattened(patch, 2 * longest), -1, 1)
    window = np.hanning(patch.shape[0])[:, None] * np.hanning(patch.shape[1])
    spectrum = np.abs(fft.fft2(contrast * window))
    side = 2 * (min(patch.shape) // (4 * round(longest))) + 1  # half-way to the next line
    ratio = spectrum / ndimage.uniform_filter(spectrum, side, mode="wrap")
    basis = np.array([[v.imag, v.real] for v in vectors])
    exact = []
    for wave in np.linalg.inv(basis).T:  # in periods per pixel, down and along
        far = [math.ceil(0.25 * np.hypot(*wave) * n) for n in patch.shape]
        places = [
            (round(float(k) * n) + np.arange(-f, f + 1)) % n
            for k, n, f in zip(wave, patch.shape, far, strict=True)
        ]
        y, x = (np.linspace(-1, 1, 2 * f + 1) for f in far)
        near = ratio[np.ix_(*places)] * (np.hypot(y[:, None], x) <= 1)
        sharpest = np.unravel_index(near.argmax(), near.shape)
        # The highest of several thousand values of noise, in a Rayleigh distribution, is 3.5.
        if near[sharpest] < 5.0:
            raise _no_grid("what repeats itself does so over a few lenslets only, as contents do")
        y, x = (p[k] for p, k in zip(places, sharpest, strict=True))
        tops = []
        for line, at in ((spectrum[:, x], y), (spectrum[y], x)):
            place = at + _top(*np.log(line[np.arange(at - 1, at + 2) % line.size]))
            tops.append(place / line.size - round(place / line.size))
        exact.append(tops)
    one, other = (complex(x, y) for y, x in np.linalg.inv(np.array(exact)).T)
    return one, other


def _refined(grid: LensletGrid, white: np.ndarray) -> LensletGrid:
    """Fit a guessed grid to the micro-images, from the centre of the image outwards."""
    down, along = (_windows(length, grid.pitch) for length in white.shape)
    middle = down[len(down) // 2], along[len(along) // 2]
    contrast, (top, left) = _gaps(white[middle], grid), (part.start for part in middle)
    local = _in_phase(replace(grid, y0=grid.y0 - top, x0=grid.x0 - left), contrast)
    # Neighbours average contents out; near the border of a small image there are none.
    reach = 3.5 if min(white.shape) > 2 * WINDOW * grid.pitch else 0.5
    shape = _mean_micro_image(local, contrast, reach)
    grid = replace(local, y0=local.y0 + top, x0=local.x0 + left)
    match = np.zeros(white.shape)
    for part in product(down, along):
        found = scipy.signal.oaconvolve(_gaps(white[part], grid), shape, mode="same")
        match[part] = ndimage.spline_filter(found)
    reach, extent = FIRST_REACH, max(len(i) for i in grid.indices(white.shape))
    while True:
        rows, columns = (i[np.abs(i) <= reach] for i in grid.indices(white.shape))
        row, column = (i.ravel() for i in np.meshgrid(rows, columns, indexing="ij"))
        y, x = grid.position(row, column)
        # A window's border cuts others off.
        whole = _lie_within(y, down, 0.55 * grid.pitch) & _lie_within(x, along, 0.55 * grid.pitch)
        if not whole.any():
            raise _no_grid("no micro-image lies clear of its border")
        row, column, y, x = (values[whole] for values in (row, column, y, x))
        top_y, top_x, curvature = _peaks(match, y, x, grid.pitch / 6)
        away = np.hypot(top_y - y, top_x - x)
        found = (curvature > 0.2 * np.median(curvature)) & (away < grid.pitch / 4)
        if reach == FIRST_REACH and np.mean(found) < 0.5:
            raise _no_grid("no micro-images are where it seemed to repeat itself")
        grid, residual = _fitted(grid, row, column, top_y, top_x, found)
        if reach >= extent:
            break
        reach *= 2
    if residual > 0.1 * grid.pitch:
        raise _no_grid(f"what repeats itself is {residual:.2g} pixels off a grid")
    return grid


def _gaps(white: np.ndarray, grid: LensletGrid) -> np.ndarray:
    """Contrast, at most 0: what is brighter than the mean is scene content.

    Spots, which are little more than their bright part, keep theirs.
    """
    contrast = flattened(white, 2 * grid.pitch)
    return np.minimum(contrast, 0) if np.median(contrast) > -0.5 else contrast


def _windows(length: int, pitch: float) -> list[slice]:
    """Parts of an axis in which micro-images are searched for: all of it, unless it is long."""
    side = math.ceil(WINDOW * pitch)
    if length <= WINDOWS * side:
        return [slice(0, length)]
    starts = np.linspace(0, length - side, WINDOWS).astype(int)
    return [slice(int(start), int(start) + side) for start in starts]


def _lie_within(places: np.ndarray, windows: list[slice], border: float) -> np.ndarray:
    """Find the positions along an axis that lie within a window, off its border."""
    inside = [(places >= w.start + border) & (places <= w.stop - 1 - border) for w in windows]
    return np.any(inside, axis=0)


def _mean_micro_image(grid: LensletGrid, contrast: np.ndarray, reach: float) -> np.ndarray:
    """Mean micro-image around the centre and up to `reach` pitches beside it, made symmetric.

    Correlation with it, the matched filter, is the least noisy way to locate a known shape.
    """
    near = np.arange(-FIRST_REACH, FIRST_REACH + 1)
    centres = grid.position(near[:, None], near)
    half = round(reach * grid.pitch)
    pixels = np.mgrid[-half : half + 1, -half : half + 1]
    y, x = (np.add.outer(pixel, centre) for pixel, centre in zip(pixels, centres, strict=True))
    mean = _between(contrast, y, x).mean(axis=(2, 3))
    mean += mean[::-1, ::-1]
    return ndimage.gaussian_filter(mean - mean.mean(), 0.12 * grid.pitch)  # fills narrow gaps


def _in_phase(grid: LensletGrid, contrast: np.ndarray) -> LensletGrid:
    """Shift the grid within a cell to where the lenslets around the centre are brightest."""
    near = np.arange(-2 * FIRST_REACH, 2 * FIRST_REACH + 1)
    y, x = grid.position(near[:, None], near)
    share = np.arange(16) / 16
    down, along = grid.rotated(grid.row_pitch * share[:, None], grid.pitch * share)
    # Noise falls with 1 / sigma^2, a pattern of one pitch with exp(-2 pi^2 sigma^2): their ratio is
    # largest for this Gaussian.
    smooth = ndimage.gaussian_filter(contrast, math.sqrt(2) / (2 * math.pi) * grid.pitch)
    brightness = _between(smooth, np.add.outer(down, y), np.add.outer(along, x))
    best = np.unravel_index(brightness.mean(axis=(2, 3)).argmax(), down.shape)
    return replace(grid, y0=float(grid.y0 + down[best]), x0=float(grid.x0 + along[best]))


def _between(image: np.ndarray, y: np.ndarray, x: np.ndarray, order: int = 1) -> np.ndarray:
    """Values between the pixels of an image, or for order 3 of its spline coefficients."""
    return ndimage.map_coordinates(image, [y, x], order=order, mode="mirror", prefilter=False)


def _peaks(match: np.ndarray, y, x, step: float):
    """Peaks near y, x and the smaller of their curvatures along y and x.

    Parabolas are fitted again around their tops, which gives no bias for symmetric peaks even with
    wide steps.
    """
    for _ in range(4):
        top = _between(match, y, x, order=3)
        up, down = (_between(match, y + n, x, order=3) for n in (-step, step))
        left, right = (_between(match, y, x + n, order=3) for n in (-step, step))
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
            raise _no_grid("fewer than 3 x 3 micro-images are clear of its border")
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
    turn = np.angle(turn)
    return replace(grid, x0=z0.real, y0=z0.imag, pitch=pitch, rotation=turn, row_pitch=row_pitch)
