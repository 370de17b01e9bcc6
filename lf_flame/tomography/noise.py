"""Noise of a light field, by pixel and as neighbours share it, and a uniform background.

Decoded views are interpolated, so neighbouring ones share pixels of the sensor. A sum over views,
as every cell of a fit is, then has more noise than its number of pixels says.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from lf_flame.tomography.frustum_grid import FrustumGrid
from lf_flame.tomography.geometries import Geometry, backproject, project

NOISE_BLOCK = 9
"""Number of pixels along each axis over which noise is averaged beyond the photon noise."""

DARK = 0.01
"""Brightness of the smoothed mean of the views, relative to its maximum, below which a pixel is
noise and little else."""

FEWEST = 10_000
"""Smallest number of dark pixels with which correlation is measured: to about 5 %."""

LEAST = 1.3
"""Smallest factor of the variance that is taken as correlation: faint light may look like less."""

LEAST_DARK = 0.2
"""Smallest variance of the noise in dark pixels, relative to that of all pixels, from which they
show its correlation. Photon noise has almost none there."""

LEAST_NOISE = 3e-3
"""Smallest noise, relative to the brightest pixel, whose correlation is measured where there is
light, as what no emission explains is the error of decoding and of the model, too."""

Residuals = Callable[[], tuple[np.ndarray, np.ndarray | None]]
"""Function that finds the part of the views that no emission explains, shape (v, u, t, s), and that
of white noise, or None if it is nearly white."""

NEIGHBOURS = (0, 1), (1, -1), (1, 0), (1, 1)
"""One of each pair of opposite steps to a neighbour."""


def noise_variance(sd: float) -> float:
    """Variance of the noise, bounded above 0 so that one can divide by it."""
    return max(sd**2, float(np.finfo(np.float32).tiny))


def inner(one: np.ndarray, other: np.ndarray) -> float:
    """Sum of products of two float32 arrays: rows in float32, their sums in float64."""
    return float(np.einsum("...s,...s->...", one, other).sum(dtype=np.float64))


def noise_by_pixel(views: np.ndarray, seen: np.ndarray, known: np.ndarray | bool) -> np.ndarray:
    """Variance of each pixel's noise relative to that of known rays, float32, shape (v, u, t, s).

    The variance of a sensor's pixel increases in proportion to its light (the photon transfer
    curve; EMVA standard 1288). Other effects, such as a division by a white image, vary slowly over
    the field. `seen` is the light field of the unpenalised fit. Rays that are not known have light
    of a fit, which shows no noise: they get that of as much light, scaled as in known rays nearby.
    """
    power = np.where(known, np.square(views - seen, dtype=np.float32), np.float32(0))
    if not power.any():
        return np.ones_like(power)
    light = np.clip(seen, 0, None)
    by_light = _photon_transfer(power, light, known)
    power = np.where(known, power, by_light)
    place, wanted = (
        ndimage.uniform_filter(one.mean(axis=(0, 1), dtype=np.float64), NOISE_BLOCK, mode="nearest")
        for one in (power, by_light)
    )
    # A running sum may end slightly below 0 where there is no noise.
    least = 1e-6 * float(wanted.max())
    by_light *= (np.clip(place, 0, None) / np.maximum(wanted, least)).astype(np.float32)
    return by_light / float(by_light.mean(dtype=np.float64, where=known))


def _photon_transfer(power: np.ndarray, light: np.ndarray, known: np.ndarray | bool) -> np.ndarray:
    """Fit squared noise with a constant plus a multiple of the light, both 0 or above; float32."""
    mean_power = float(power.mean(dtype=np.float64, where=known))
    mean_light = float(light.mean(dtype=np.float64, where=known))
    bright = light - np.float32(mean_light)
    spread = inner(np.where(known, bright, np.float32(0)), bright)
    slope = inner(bright, power) / spread if spread else 0.0  # power is 0 in unknown rays
    steepest = mean_power / mean_light if mean_light else 0.0
    slope = min(max(slope, 0.0), steepest)
    line = np.float32(mean_power) + np.float32(slope) * bright
    return np.maximum(line, np.float32(1e-6 * mean_power))


def correlation_factor(
    views: np.ndarray,
    used_views: np.ndarray,
    variance: float = 0.0,
    residuals: Residuals | None = None,
) -> float:
    """Factor by which correlation raises the standard deviation of sums of a light field's noise.

    It is measured where the field is dark, in second differences of neighbouring pixels, so that
    faint light has no effect, and as the product of a factor of the views and one of the pixels.
    Where dark pixels have little of the noise, as in photon noise, it is measured in the part that
    no emission explains, relative to white noise of which a fit explains as much (`residuals`). It
    is 1 where there are too few pixels with noise. `used_views` marks the views that are fitted.
    """
    photograph = np.einsum("vu,vuts->ts", used_views / np.count_nonzero(used_views), views)
    smooth = ndimage.uniform_filter(photograph, 3)
    dark = smooth <= DARK * float(smooth.max())
    known = used_views[:, :, None, None] & dark
    found = None
    if np.count_nonzero(dark) * np.count_nonzero(used_views) >= FEWEST:
        found = _of_differences(views, known, LEAST_DARK * variance)
    noisy = np.sqrt(variance) > LEAST_NOISE * float(views.max())
    if found is None and residuals and noisy and used_views.sum() * smooth.size >= FEWEST:
        known = np.broadcast_to(used_views[:, :, None, None], views.shape)
        rest, white = residuals()
        found = _of_differences(rest, known, 0.0)
        of_white = None if white is None else _of_differences(white, known, 0.0)
        found = found / of_white if found and of_white and of_white > 0 else found
    return float(np.sqrt(found)) if found is not None and found > LEAST else 1.0


def _of_differences(values: np.ndarray, known: np.ndarray, least: float) -> float | None:
    """Factor of the variance of sums; None if the values vary by less, or contain light."""
    across = _Differences(values, known, 3)
    # The variance of second differences of white noise is that of the noise times 1 + 4 + 1.
    if across.variance <= 6 * least:
        return None
    # Differences of noise change sign from one to the next; those of light do not.
    if across.share((2, 3), (0, 1)) + across.share((2, 3), (0, 2)) > 0:
        return None
    used_views = np.asarray(known.any(axis=(2, 3)))
    of_views = 1.0 + 2 * sum(
        across.share((0, 1), lag) * _neighboured(used_views, lag) for lag in NEIGHBOURS
    )
    along = _Differences(values, known, 0)
    of_pixels = 1.0
    if along.variance:
        of_pixels += 2 * sum(along.share((2, 3), lag) for lag in NEIGHBOURS)
    return of_views * of_pixels


def _neighboured(used_views: np.ndarray, lag: tuple[int, int]) -> float:
    """Share of the views in use with a neighbour in use a step apart; the rim has fewer."""
    both = np.pad(used_views, 1) & np.roll(np.pad(used_views, 1), lag, (0, 1))
    return float(both.sum()) / max(float(used_views.sum()), 1.0)


class _Differences:
    """Second differences along an axis, where all three are known, and their correlation."""

    def __init__(self, views: np.ndarray, known: np.ndarray, axis: int):
        every, of_views = np.moveaxis(known, axis, 0), np.moveaxis(views, axis, 0)
        known = every[:-2] & every[1:-1] & every[2:]
        values = (of_views[2:] - 2 * of_views[1:-1] + of_views[:-2]) * known
        self._known, self._values = (np.moveaxis(one, 0, axis) for one in (known, values))
        count = max(int(np.count_nonzero(known)), 1)
        self.variance = inner(self._values, self._values) / count

    def share(self, axes: tuple[int, int], lag: tuple[int, int]) -> float:
        """Correlation with the neighbour that is a step apart along two axes."""
        here, there = [slice(None)] * 4, [slice(None)] * 4
        for axis, step in zip(axes, lag, strict=True):
            size = self._values.shape[axis]
            here[axis] = slice(max(step, 0), size + min(step, 0))
            there[axis] = slice(max(-step, 0), size + min(-step, 0))
        one, other = tuple(here), tuple(there)
        pairs = int(np.count_nonzero(self._known[one] & self._known[other]))
        total = inner(self._values[one], self._values[other])
        return total / pairs / self.variance if pairs else 0.0


LEAST_EMPTY = 0.02
"""Smallest fraction of empty pixels with which a background is measured."""

FITS, BRIGHT = 4, 3.0
"""Largest number of measurements, and standard errors by which a cell that may emit is brighter
than the background of the measurement before."""

WIDENED = np.ones((1, 5, 5))
"""Cells around a bright cell that may emit, too: their light is fainter than the noise."""


@dataclass(frozen=True)
class Edge:
    """Level of the outermost pixels of all views.

    level : median over the pixels of their mean over the views
    error : standard error of the level, from the scatter of those means
    adds : light that this level adds to the field, relative to the rest of its light
    brightest : largest of those means
    """

    level: float
    error: float
    adds: float
    brightest: float


def measure_edge(views: np.ndarray) -> Edge:
    """Measure the level at the edge of the field, from all of its pixels together, (v, u, t, s).

    Medians exclude light that reaches only a part of the edge.
    """
    frame = np.ones(views.shape[2:], bool)
    frame[1:-1, 1:-1] = False
    pixels = views[..., frame]
    means = pixels.mean(axis=(0, 1), dtype=np.float64)
    level = float(np.median(means))
    # The standard error of a median is 1.2533 times that of a mean; 1.4826 scales the deviations.
    scatter = 1.4826 * float(np.median(np.abs(means - level)))
    error = 1.2533 * scatter / np.sqrt(means.size)
    light = float(views.mean(dtype=np.float64)) - level
    adds = level / light if light > 0 else (np.inf if level else 0.0)
    return Edge(level, error, float(adds), float(means.max()))


class Level(NamedTuple):
    """Level of a background, and its standard error."""

    mean: float = 0.0
    error: float = 0.0


def fit_background(
    views: np.ndarray, geometry: Geometry, valid: np.ndarray | None = None
) -> Level | None:
    """Measure a uniform background in the pixels that no emission reaches; None without any.

    Cells that may emit are those whose rays are brighter, in the mean, than the background: first
    that at the field's edge, then that of the measurement before. They are found in one half of the
    views, and the background is measured in the other: pixels that are picked because their noise
    is dark would all be too dark. A half section may emit anywhere within its radius.
    """
    operator, grid = geometry.operator, geometry.grid
    edge = measure_edge(views)
    level, before = Level(edge.level, edge.error), np.inf
    measured = np.ones(views.shape[:2], bool)
    on_planes = isinstance(grid, FrustumGrid)
    if on_planes:
        even = np.indices(measured.shape).sum(axis=0) % 2 == 0
        picking, measured = (measured, measured) if even.all() else (~even, even)
        half = np.broadcast_to(picking[:, :, None, None].astype(np.float32), views.shape)
        rays = np.maximum(backproject(operator, half), 1.0)
        means = ndimage.uniform_filter(backproject(operator, half * views) / rays, (1, 3, 3))
        seen = rays > np.count_nonzero(picking) / 2
    views = views[measured]
    for _ in range(FITS):
        lit = np.ones(operator.dims, bool)
        if on_planes:
            dark = means[seen & (means < level.mean)] - level.mean
            noise = np.sqrt(np.mean(np.square(dark))) if dark.size else 0.0
            lit = seen & (means > level.mean + BRIGHT * noise)
            lit = ndimage.binary_dilation(lit, WIDENED)
        glow = project(operator, lit.astype(operator.dtype))
        if not on_planes:  # columns beyond the radius, also below a burner
            glow = np.broadcast_to(glow.max(axis=2, keepdims=True), glow.shape)
        empty = (glow <= 0)[measured]
        if valid is not None:
            empty &= valid[measured]
        if np.mean(empty) < LEAST_EMPTY:
            return None
        level = _level(views[empty])
        if abs(level.mean - before) <= level.error / 2:
            break
        before = level.mean
    return level


def _level(pixels: np.ndarray) -> Level:
    """Mean of empty pixels, without the tails beyond three standard deviations, and its error."""
    some = pixels[:: max(1, pixels.size // 100_000)].astype(np.float64)  # enough to find the tails
    for _ in range(3):
        middle, reach = float(np.mean(some)), 3 * float(np.std(some))
        some = some[np.abs(some - middle) <= reach]
    kept = pixels[np.abs(pixels - np.float32(middle)) <= np.float32(reach)]
    mean = float(np.mean(kept, dtype=np.float64))
    scatter = float(np.sqrt(np.mean(np.square(kept - np.float32(mean)), dtype=np.float64)))
    return Level(mean, scatter / np.sqrt(kept.size))
