"""The slope at which a region of a light field is sharpest, and the range of slopes of a scene.

Sharpness is measured by the semblance of the views' gradients g_a, refocused on the region:

    semblance = sum |sum_a h_a g_a|^2 / sum (sum_a h_a) (sum_a h_a |g_a|^2)

over the lenslets of the region. h_a is the weight of a view times a taper, which falls to 0 at the
edges of the view and moves with it. By the Cauchy-Schwarz inequality the semblance is 1 where the
views agree and less elsewhere, whatever the region contains (Neidell and Taner, Geophysics 36, 482,
1971, for seismic traces). Light that enters and leaves the region as the slope changes, and
lenslets at the edges that fewer views see, are in numerator and denominator alike. Gradients are
low-passed first, because of aliasing above the frequencies that the views resolve. All shifts are
exact, by the spectrum: an interpolation softens all but whole ones, and would draw the peak there.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise, product

import numpy as np
from numpy.typing import ArrayLike
from scipy import fft
from scipy.interpolate import make_interp_spline
from scipy.ndimage import gaussian_filter, gaussian_filter1d
from scipy.optimize import minimize_scalar
from scipy.signal import find_peaks

from lf_flame._common.arrays import centred
from lf_flame.errors import InputError
from lf_flame.refocus import _kernels
from lf_flame.refocus._arguments import (
    Region,
    Views,
    as_region,
    as_steps,
    as_views,
    as_weights,
    farthest_slope,
    refuse_not_finite,
)

DEFAULT_RANGES = (3.0, 12.0)
"""Largest slope searched by default, in both directions: at first, and if the peak is outside."""

RIVAL_REACH, RIVAL_REACH_OF_TILES = 6.0, 3.0
"""Largest difference of slope at which a second peak counts against the first. It is fixed, so that
the confidence does not depend on the range of the search."""

WIDEST_STEP, STEP_BY_VIEWS = 0.1, 0.7
"""Largest step of a search, and largest step times (views - 1): 0.05 for 15 views. Over such a step
two views that far apart move by half a period or less at all frequencies that pass the low-pass."""

SMOOTH = 1.06
"""Standard deviation, in lenslets, of the Gaussian low-pass before the gradient."""

REACH, SOFTNESS = 8, 1.5
"""Lenslets over which a view's taper falls to 0 at its edges; standard deviation of the edges of a
region, where hard ones would let bright light beside a dark region ring into it."""

SLOPES_AT_ONCE = 8
"""Number of slopes for each reading of the spectra."""

LEAK = 1e-4
"""Smallest energy of a region relative to the mean; interpolation rings with a third of it."""

ROUNDING = 4 * 2.0**-24
"""Largest gradient that may be rounding, relative to the brightness: some half units of float32."""

CLEAR = 3.0
"""Smallest height of a peak that is no ripple, relative to the value for unrelated views."""

MOST_NOISE = 0.5
"""Largest fraction of the energy that is subtracted as noise, so that enough remains as divisor."""

PARTS, SMALLEST_PART = 4, 6
"""Largest number of parts of a region along each axis, and their smallest side in lenslets."""

WORST_LOSS, WORST_SPREAD = 0.1, 0.15
"""Part of the semblance that one slope for a whole region may cost, where its parts would be
sharper at slopes of their own; and by which all views may agree less than neighbouring ones. The
confidence falls to 0 there. One layer in noise has up to 0.02 of either; two that have merged have
0.15 and more."""


@dataclass(frozen=True, eq=False, repr=False)
class SlopeSearch:
    """Slope of sharpest focus of one region, and its sharpness curve.

    Attributes
    ----------
    slope : float
        Slope of the highest sharpness, interpolated with a spline; NaN without a peak.
    slopes, sharpness : ndarray of float64, shape (n,)
        Sharpness curve: mean squared gradient over the region, per lenslet squared, as if the
        views had the same gradients at every slope as at the peak.
    confidence : float
        Confidence in [0, 1]: ``1 - rival / peak`` of the semblance within 6 of the slope (3 for
        `find_sharpest_slopes`), whatever range was searched. The rival is the highest of three: the
        other peaks, the lowest point, and 1/n, the value for n unrelated views. The confidence of
        `find_sharpest_slope` also falls to 0 where 4 x 4 parts of the region lose a tenth of their
        semblance at one slope, and where neighbouring views agree much better than all: two slopes
        are sharp there, or the surface is steep.
    region : (int, int, int, int)
        Region ``(t_start, t_stop, s_start, s_stop)`` in lenslets; stops are excluded.
    doubt : str
        Main reason of a confidence below 0.5, else empty: "several slopes are sharp", "the texture
        repeats", "less than one pixel of parallax between the outer views" or "too little texture".
    """

    slope: float
    slopes: np.ndarray
    sharpness: np.ndarray
    confidence: float
    region: Region
    doubt: str = ""

    def __repr__(self) -> str:
        return f"SlopeSearch(slope {self.slope:+.3f}, confidence {self.confidence:.2f})"


def find_sharpest_slope(
    light_field: Views,
    slopes: ArrayLike | None = None,
    *,
    region: Region | None = None,
    weights: ArrayLike | None = None,
) -> SlopeSearch:
    """Find the slope at which a region is sharpest.

    Parameters
    ----------
    light_field : LightField or array_like, shape (v, u, t, s) or (v, u, t, s, channels)
        Views; colours are averaged to grey.
    slopes : sequence of float, optional
        Slopes to search, at least three, rising in equal steps. If the steps are wide for the
        number of views, slopes between them are searched too. Default: -3 to 3, then -6 to 6 and
        -12 to 12 if no clear peak lies inside.
    region : (int, int, int, int), optional
        Region ``(t_start, t_stop, s_start, s_stop)`` in lenslets, stops excluded; it should contain
        one layer. Default: the whole image.
    weights : array_like, shape (v, u), optional
        Weight of each view, 0 or above; the light field's own weights multiply them. Default: all
        equal.

    Returns
    -------
    SlopeSearch
        Slope, confidence and sharpness curve. A texture that repeats (a sinusoid) fits several
        slopes equally well: the confidence is near 0, and `doubt` says so.

    Raises
    ------
    InputError
        If an argument cannot be used, if a slope shifts views by more than the image, or if the
        curve has no peak inside the range: it is flat to the rounding of float32 pixels, or still
        rises at an end.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.refocus import find_sharpest_slope
    >>> texture = np.random.default_rng(1).uniform(size=(48, 64))
    >>> views = [[np.roll(texture, (2 - v, 2 - u), (0, 1)) for u in range(5)] for v in range(5)]
    >>> found = find_sharpest_slope(np.array(views))
    >>> round(found.slope, 2)  # each view has moved by a lenslet more
    -1.0
    """
    height, width = as_views(light_field).shape[2:4]
    whole = (0, height, 0, width)
    region = as_region(whole if region is None else region, (height, width))
    curves = _Curves(light_field, slopes, [region, *_parts(region)], weights, asked=1)
    top = int(curves.semblance[:, 0].argmax())
    if curves.flat(0):
        raise InputError(
            "No slope is sharpest: the sharpness is the same at all of them, "
            "to the rounding of float32 pixels."
        )
    if top in (0, len(curves.slopes) - 1):
        raise InputError(
            f"The sharpness still rises at the end of the slopes searched, {curves.slopes[0]:g} to "
            f"{curves.slopes[-1]:g}; search a range that goes beyond {curves.slopes[top]:g}."
        )
    return curves.searches()[0]


def find_sharpest_slopes(
    light_field: Views,
    slopes: ArrayLike | None = None,
    *,
    tiles: tuple[int, int] | None = None,
    regions: Iterable[Region] | None = None,
    weights: ArrayLike | None = None,
) -> list[SlopeSearch]:
    """Find the slope of sharpest focus of each of many regions, in one pass over the views.

    Parameters
    ----------
    light_field, slopes
        As for `find_sharpest_slope`. The default range is shared: it widens while any curve rises
        at an end, or most have no peak.
    tiles : (int, int), optional
        Number of rows and columns of tiles into which the image is cut.
    regions : sequence of (int, int, int, int), optional
        Regions ``(t_start, t_stop, s_start, s_stop)`` in lenslets, instead of tiles.
    weights : array_like, shape (v, u), optional
        As for `find_sharpest_slope`.

    Returns
    -------
    list of SlopeSearch
        Results in the order of the regions, or of the tiles row by row. If a curve has no peak
        inside the range, the slope is NaN and the confidence 0.

    Raises
    ------
    InputError
        If an argument cannot be used, or a slope shifts views by more than the image.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.refocus import find_sharpest_slopes
    >>> texture = np.random.default_rng(1).uniform(size=(48, 64))
    >>> views = [[np.roll(texture, (2 - v, 2 - u), (0, 1)) for u in range(5)] for v in range(5)]
    >>> found = find_sharpest_slopes(np.array(views), tiles=(1, 2))
    >>> [round(one.slope, 1) for one in found]
    [-1.0, -1.0]
    """
    if (tiles is None) == (regions is None):
        raise InputError("Give tiles or regions, and not both.")
    size = as_views(light_field).shape[2:4]
    chosen = list(regions) if regions is not None else _tiles(tiles or (1, 1), size)
    if not chosen:
        raise InputError("regions must hold at least one region, got none.")
    return _Curves(light_field, slopes, chosen, weights, asked=len(chosen)).searches()


def _parts(region: Region) -> list[Region]:
    """Cut a region into parts, unless it is small."""
    top, bottom, left, right = region
    size = (bottom - top, right - left)
    rows, columns = (max(min(PARTS, side // SMALLEST_PART), 1) for side in size)
    return [(top + a, top + b, left + c, left + d) for a, b, c, d in _tiles((rows, columns), size)]


def _tiles(tiles: tuple[int, int], size: tuple[int, ...]) -> list[Region]:
    """Cut the image into tiles, row by row, with sizes that differ by at most a lenslet."""
    if not all(1 <= n <= m for n, m in zip(tiles, size, strict=True)):
        raise InputError(
            f"tiles must be rows and columns, at least 1 and at most the {size[0]} x {size[1]} "
            f"lenslets, got {tuple(tiles)}."
        )
    edges = ((np.arange(n + 1) * m // n).tolist() for n, m in zip(tiles, size, strict=True))
    rows, columns = (pairwise(along) for along in edges)
    return [(*row, *column) for row, column in product(rows, columns)]


class _Curves:
    """Semblance and energy of regions at rising slopes, [slope, region].

    The first `asked` regions are searched; further ones are parts of the first.
    """

    def __init__(self, light_field, slopes, regions, weights, asked: int):
        views = as_views(light_field)
        self.regions = [as_region(region, views.shape[2:4]) for region in regions]
        counts = as_weights(weights, light_field)
        self._limit, self.asked = farthest_slope(light_field), asked
        self._reach = RIVAL_REACH if asked == 1 else RIVAL_REACH_OF_TILES
        self.views = counts.sum() ** 2 / float(np.square(counts).sum())
        self._step = min(WIDEST_STEP, STEP_BY_VIEWS / max(max(views.shape[:2]) - 1, 1))
        self._make = partial(_Gradients, views, counts, self.regions)
        self._farthest, self._stride = -1.0, 1
        self._gradients: _Gradients
        if slopes is not None:
            self._between(as_steps(slopes))
            return
        end, last = (
            int(min(np.ceil(m / self._step - 1e-6), self._limit // self._step))
            for m in DEFAULT_RANGES
        )
        self.slopes = self._step * np.arange(-end, end + 1)
        self.semblance, self.energy = self._measure(self.slopes)
        while not self._settled() and end < last:
            end = min(2 * end, last)
            self._widen(-end * self._step, end * self._step)

    def _between(self, slopes: np.ndarray) -> None:
        """Measure at given slopes and between them, so that steps are small enough."""
        if np.abs(slopes).max() > self._limit:
            raise InputError(
                f"slopes to search must lie within -{self._limit:g} to {self._limit:g}, beyond "
                f"which views are shifted by more than the image, got {slopes.min():g} to "
                f"{slopes.max():g}."
            )
        self._stride = int(np.ceil((slopes[1] - slopes[0]) / self._step - 1e-6))
        self.slopes = np.linspace(slopes[0], slopes[-1], (len(slopes) - 1) * self._stride + 1)
        self.slopes[:: self._stride] = slopes
        self.semblance, self.energy = self._measure(self.slopes)

    def _measure(self, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Semblance and energy at slopes; spectra are padded for the farthest, and kept."""
        farthest = float(np.abs(slopes).max(initial=0.0))
        if farthest > self._farthest:
            self._farthest = min(farthest + self._reach, self._limit)
            self._gradients = self._make(self._farthest)
        return self._gradients.measure(slopes)

    def flat(self, k: int) -> bool:
        """Whether a curve may be rounding alone.

        The mean square of ``gradient + error`` is wrong by up to ``2 gradient error + error^2``; a
        curve that varies by no more than that has no peak.
        """
        sharpness, error = self.sharpness(k), self._gradients.rounding
        return np.ptp(sharpness) <= error * (2 * math.sqrt(sharpness.max()) + error)

    def sharpness(self, k: int) -> np.ndarray:
        """Mean squared gradient of a region, with the energy at its highest sample."""
        return self.semblance[:, k] * self.energy[self.semblance[:, k].argmax(), k]

    def _settled(self) -> bool:
        """Whether no curve rises at an end, and half of those that are not flat have a peak."""
        some = [k for k in range(self.asked) if not self.flat(k)]
        tops = [int(self.semblance[:, k].argmax()) for k in some]
        high = [self.semblance[:, k].max() > min(CLEAR / self.views, 0.5) for k in some]
        return not {0, len(self.slopes) - 1} & {*tops} and 2 * sum(high) >= len(high)

    def searches(self) -> list[SlopeSearch]:
        """Find the peaks of all curves, and how far they can be trusted."""
        shown = [(self.slopes[:: self._stride], self.sharpness(k)[:: self._stride])
                 for k in range(self.asked)]  # fmt: skip
        peaks = [self._peak(k) for k in range(self.asked)]
        found = [peak for peak in peaks if np.isfinite(peak)]
        if found:
            self._widen(min(found) - self._reach, max(found) + self._reach)
        return [
            SlopeSearch(peak, *curve, confidence, self.regions[k], doubt)
            for k, (peak, curve) in enumerate(zip(peaks, shown, strict=True))
            for confidence, doubt in [self._trust(k, peak)]
        ]

    def _widen(self, low: float, high: float) -> None:
        """Measure at slopes down to `low` and up to `high`, too, as far as the image allows."""
        step = self.slopes[1] - self.slopes[0]
        low, high = max(low, -self._limit), min(high, self._limit)
        counts = [max(math.floor(x / step + 1e-6), 0)
                  for x in (self.slopes[0] - low, high - self.slopes[-1])]  # fmt: skip
        before = self.slopes[0] - step * np.arange(counts[0], 0, -1)
        after = self.slopes[-1] + step * np.arange(1, counts[1] + 1)
        later, earlier = self._measure(after), self._measure(before)
        self.semblance = np.concatenate([earlier[0], self.semblance, later[0]])
        self.energy = np.concatenate([earlier[1], self.energy, later[1]])
        self.slopes = np.concatenate([before, self.slopes, after])

    def _peak(self, k: int) -> float:
        """Slope of a curve's peak, interpolated with a spline; NaN without one.

        The part that the views do not share at the peak is taken as noise of equal strength
        everywhere, and subtracted. Where fewer views see the edges it counts less, and would shift
        a flat peak.
        """
        slopes, semblance = self.slopes, self.semblance[:, k]
        top = int(semblance.argmax())
        if self.flat(k) or top in (0, len(slopes) - 1):
            return np.nan
        near = slice(max(top - 5, 0), top + 6)
        energy = np.maximum(self.energy[near, k] / self.energy[top, k], 1e-6)
        noise = min((1 - semblance[top]) / (1 - 1 / self.views), MOST_NOISE * energy.min())
        curve = (semblance[near] * energy - noise / self.views) / (energy - noise)
        spline = make_interp_spline(slopes[near], curve, k=min(5, len(curve) - 1))
        bounds = slopes[max(top - 2, 0)], slopes[min(top + 2, len(slopes) - 1)]
        options = {"xatol": 1e-6 * (bounds[1] - bounds[0])}
        best = minimize_scalar(
            lambda slope: -spline(slope), bounds=bounds, method="bounded", options=options
        )
        return float(best.x)

    def _trust(self, k: int, peak: float) -> tuple[float, str]:
        """Confidence of a peak, and why it is below 0.5."""
        if not np.isfinite(peak):
            return 0.0, "too little texture"
        near = np.abs(self.slopes - peak) <= self._reach + 1e-9
        curve, at = self.semblance[near, k], int(np.abs(self.slopes[near] - peak).argmin())
        top = curve[max(at - 1, 0) : at + 2].max()
        tops, _ = find_peaks(np.pad(curve, 1), prominence=0.02 * top)
        others = curve[[n for n in tops - 1 if abs(n - at) > 1]]
        second = others.max(initial=0.0)
        mixed = self._mixed(near, at, peak, top) if self.asked == 1 else 0.0
        rivals = {
            "several slopes are sharp": max(second / top, mixed),
            "too little texture": 1 / (self.views * top),
            "less than one pixel of parallax between the outer views": curve.min() / top,
        }
        if second > 0.8 * top > 0.64:  # two layers share the energy; a repeated texture has it all
            rivals = {"the texture repeats": second / top}
        doubt = max(rivals, key=lambda name: rivals[name])
        confidence = 1 - max(second, 1 / self.views, curve.min()) / top
        confidence = max(confidence, 0.0) * (1 - mixed)
        return confidence, doubt if confidence < 0.5 else ""

    def _mixed(self, near: np.ndarray, at: int, peak: float, top: float) -> float:
        """How far one slope does not fit all of the first region, from 0 to 1.

        Layers whose peaks have merged: neighbouring views agree better at the slope than all views
        do, where noise would lower both. Layers side by side: parts of the region, weighted by
        amplitude so that faint texture counts too, have a higher semblance at other slopes.
        """
        parts, here = self.semblance[near, 1:], np.argmin(np.abs(self.slopes - peak))
        amplitude = np.sqrt(np.maximum(self.energy[here, 1:], 0))
        own = max(float(amplitude @ parts.max(axis=0)), np.finfo(float).tiny)
        lost = 1 - float(amplitude @ parts[max(at - 1, 0) : at + 2].max(axis=0)) / own
        alike = max(self._gradients.likeness(peak), np.finfo(float).tiny)
        spread = (
            1 - (top - 1 / self.views) / (1 - 1 / self.views) / alike if self.views > 1 else 0.0
        )
        return min(max(lost / WORST_LOSS, spread / WORST_SPREAD, 0.0), 1.0)


class _Gradients:
    """Spectra of the gradients of the low-passed views near some regions; sums over the regions."""

    def __init__(
        self, views: np.ndarray, counts: np.ndarray, regions: list[Region], farthest: float
    ):
        reach = int(farthest * (max(counts.shape) - 1) / 2)
        cuts = []
        for k in (0, 1):
            low = min(region[2 * k] for region in regions) - reach - REACH
            high = max(region[2 * k + 1] for region in regions) + reach + REACH
            cuts.append(slice(max(low, 0), min(high, views.shape[k + 2])))
        seen = views[:, :, cuts[0], cuts[1]]
        self._size = seen.shape[2:4]
        self._exponent, mean, square = _levels(seen, views)
        self.rounding = math.ldexp(ROUNDING * math.sqrt(square), self._exponent)
        # Long enough that nothing that leaves at one end wraps around into a region.
        self._periods = [fft.next_fast_len(n + min(reach, n), real=True) for n in self._size]
        self._counts = counts / counts.sum()
        self._tapers = [_taper(n) for n in self._size]
        taper = np.multiply.outer(*self._tapers)
        waves = self._periods[0], 2, self._periods[1] // 2 + 1
        self._spectra = np.zeros((3, *counts.shape, *waves), np.float32)
        self._mean_energy = 0.0
        for v, u in np.argwhere(counts > 0):
            grey, count = np.ldexp(_grey(seen[v, u]), -self._exponent) - mean, self._counts[v, u]
            fields = [
                gaussian_filter(grey, SMOOTH, order=order, mode="nearest", truncate=6.0)
                for order in ((1, 0), (0, 1))
            ]
            fields.append(fields[0] ** 2 + fields[1] ** 2)
            self._mean_energy += float(count * fields[2].mean())
            for spectra, field in zip(self._spectra[:, v, u], fields, strict=True):
                spectrum = fft.rfft2(count * taper * field, self._periods)
                spectra[:, 0], spectra[:, 1] = spectrum.real, spectrum.imag
        self._down, self._across = (
            _cover([region[2 * k : 2 * k + 2] for region in regions], cuts[k].start, n)
            for k, n in enumerate(self._size)
        )

    def measure(self, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Measure semblance, and mean squared gradient of the views: float64, [slope, region]."""
        semblance = np.zeros((len(slopes), len(self._down[1])))
        energy = np.zeros_like(semblance)
        frequencies = fft.fftfreq(self._periods[0]), fft.rfftfreq(self._periods[1])
        for first in range(0, len(slopes), SLOPES_AT_ONCE):
            some = slopes[first : first + SLOPES_AT_ONCE]
            phases = [self._phases(k, some, frequencies[k]) for k in (0, 1)]
            mean = np.empty((3, len(some), *self._spectra.shape[3:]), np.float32)
            split = [np.stack([x.real, x.imag]).astype(np.float32) for x in phases]
            _kernels.sum_spectra(self._spectra, *split, mean)
            for n, slope in enumerate(some, first):
                spectra = mean[:, n - first, :, 0] + 1j * mean[:, n - first, :, 1]
                images = fft.irfft2(spectra, self._periods)[:, : self._size[0], : self._size[1]]
                down, across, alike = images.astype(float)
                tapers = self._shifted_tapers(slope)
                parts = down**2 + across**2, tapers * alike, tapers**2
                agreeing, alike, seen = (self._sum(part) for part in parts)
                energy[n] = alike / np.maximum(seen, np.finfo(float).tiny)
                bright = energy[n] > LEAK * self._mean_energy
                np.divide(agreeing, alike, out=semblance[n], where=bright)
        return semblance, np.ldexp(energy, 2 * self._exponent)

    def _phases(self, axis: int, slopes: np.ndarray, frequencies: np.ndarray) -> np.ndarray:
        """Phase factors that shift the views along an axis: complex, [slope, view, frequency]."""
        steps = centred(self._counts.shape[axis])[:, None]
        return np.exp(2j * np.pi * slopes[:, None, None] * steps * frequencies)

    def _shifted_tapers(self, slope: float) -> np.ndarray:
        """Mean of the views' tapers, each shifted with its view, (t, s)."""
        lines = []
        for k, (taper, period) in enumerate(zip(self._tapers, self._periods, strict=True)):
            phases = self._phases(k, np.array([slope]), fft.rfftfreq(period))[0]
            shifted = fft.irfft(fft.rfft(taper, period) * phases, period)
            lines.append(shifted[:, : len(taper)])
        return np.einsum("vu,vt,us->ts", self._counts, *lines, optimize=True)

    def likeness(self, slope: float) -> float:
        """Correlation of neighbouring views at a slope over the first region; 0 without any."""
        frequencies = fft.fftfreq(self._periods[0]), fft.rfftfreq(self._periods[1])
        down, across = (self._phases(k, np.array([slope]), x)[0] for k, x in enumerate(frequencies))
        (covers, row), (columns, column) = self._down, self._across
        region = np.outer(covers[row[0]], columns[column[0]])
        before: list[np.ndarray | None] = [None] * len(across)
        alike = apart = 0.0
        for v in range(len(down)):
            beside = None
            for u in range(len(across)):
                spectra = self._spectra[:2, v, u, :, 0] + 1j * self._spectra[:2, v, u, :, 1]
                spectra = spectra * (down[v][:, None] * across[u])
                images = fft.irfft2(spectra, self._periods)[:, : self._size[0], : self._size[1]]
                for other in (beside, before[u]):
                    if other is not None and images.any() and other.any():
                        alike += 2 * float(np.sum(region * images * other))
                        apart += float(np.sum(region * (images**2 + other**2)))
                beside = before[u] = images
        return max(alike / apart, 0.0) if apart > 0 else 0.0

    def _sum(self, image: np.ndarray) -> np.ndarray:
        """Sum over each region; not with BLAS, where sums depend on the number of threads."""
        (down, row), (across, column) = self._down, self._across
        lines = np.einsum("it,ts->is", down, image)
        return np.einsum("is,js->ij", lines, across)[row, column]


def _grey(view: np.ndarray) -> np.ndarray:
    """Mean of a view's channels: float64, (t, s)."""
    with np.errstate(invalid="ignore"):  # for infinities of both signs
        return view.astype(float) if view.ndim == 2 else view.mean(axis=2, dtype=float)


def _levels(seen: np.ndarray, views: np.ndarray) -> tuple[int, float, float]:
    """Power of two just above the brightest pixel; mean, and mean square, divided by it.

    Divided by a power of two, float32 sums do not overflow, and no digit changes.
    """
    brightest = max(float(np.abs(_grey(view)).max()) for row in seen for view in row)
    if not math.isfinite(brightest):
        refuse_not_finite(views)
    exponent = int(np.frexp(brightest)[1])
    scaled = (np.ldexp(_grey(view), -exponent) for row in seen for view in row)
    mean, square = np.mean([(one.mean(), np.square(one).mean()) for one in scaled], axis=0)
    return exponent, float(mean), float(square)


def _cover(bounds: list, start: int, length: int) -> tuple[np.ndarray, np.ndarray]:
    """Coverage of lenslets by different intervals, soft at the ends, and the interval of each."""
    intervals, which = np.unique(np.array(bounds) - start, axis=0, return_inverse=True)
    lenslets = np.arange(length)
    covered = (intervals[:, :1] <= lenslets) & (lenslets < intervals[:, 1:])
    return gaussian_filter1d(covered.astype(float), SOFTNESS, mode="constant"), which.ravel()


def _taper(n: int) -> np.ndarray:
    """Taper of a view along an axis: 1, falling to 0 at its edges."""
    inward = (np.minimum(np.arange(n), np.arange(n)[::-1]) + 0.5) / min(REACH, n / 4)
    return np.sin(np.pi / 2 * np.minimum(inward, 1)) ** 2
