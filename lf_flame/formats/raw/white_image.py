"""Estimation of the micro-image positions from a white image (flat field)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy import fft, ndimage

from lf_flame._common import progress
from lf_flame.errors import InputError
from lf_flame.formats.raw.grid_fit import flattened, no_grid, refine
from lf_flame.formats.raw.lenslet_grid import LensletGrid, check_layout

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
        grid = refine(_guess(white, pitch), white)
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
        raise no_grid("it does not repeat itself")
    if pitch is not None and not abs(abs(lags[0]) - pitch) <= PITCH_MARGIN * pitch:
        raise no_grid(f"it repeats itself every {abs(lags[0]):.3g} pixels, not every {pitch:g}")
    across = [v for v in lags if abs((v.conjugate() * lags[0]).imag) > abs(v * lags[0]) / 2]
    if not across:
        raise no_grid("it repeats itself in one direction only")
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
    contrast = flattened(patch, min(patch.shape) / 4)
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
        raise no_grid("it is uniform")
    correlation = correlation / overlap
    return correlation / correlation[reach, reach]
