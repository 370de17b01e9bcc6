"""The slope at which a region of a light field is sharpest.

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
from collections.abc import Sequence
from dataclasses import dataclass
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
    as_grey,
    as_region,
    as_steps,
    as_weights,
    farthest_slope,
)

DEFAULT_RANGES = (3.0, 6.0, 12.0)
"""Largest slopes searched by default, in both directions: each if the last had no clear peak."""

RIVAL_REACH, RIVAL_REACH_OF_TILES = 6.0, 3.0
"""Largest difference of slope at which a second peak rivals the first. It is fixed, so that
the confidence does not depend on the range of the search."""

WIDEST_STEP, STEP_BY_VIEWS = 0.1, 0.7
"""Largest step of a search, and largest step times (views - 1): 0.05 for 15 views. Over such a step
two views that far apart move by half a period or less at all frequencies that pass the low-pass."""

SMOOTH = 1.06
"""Standard deviation, in lenslets, of the Gaussian low-pass before the gradient."""

REACH, SOFTNESS = 8, 1.5
"""Lenslets over which a view's taper falls to 0 at its edges; standard deviation of the edges of a
region, where hard ones would let bright light beside a dark region ring into it."""

LEAK = 1e-4
"""Smallest energy of a region relative to the mean; interpolation rings with a third of it."""

ROUNDING = 4 * 2.0**-24
"""Largest gradient that may be rounding, relative to the brightness: some half units of float32."""

MIXED = 0.1
"""Part of the semblance that one slope costs parts of a region, or by which all views agree less
than those of a third of the aperture, at which the confidence falls to 0. One layer in noise has up
to 0.02 of either; two that have merged have more."""


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
        semblance at one slope, or all views agree a tenth less than those of a third of the
        aperture: two slopes are sharp there, or the surface is steep.
    region : (int, int, int, int)
        Region ``(t_start, t_stop, s_start, s_stop)`` in lenslets; stops are excluded.
    doubt : str
        Main reason of a confidence below 0.5, else empty: "several slopes are sharp", "the texture
        repeats", "less than one pixel of parallax between the outer views", "too little texture",
        or why there is no peak.
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
        Slopes to search, at least three, increasing in equal steps. If the steps are wide for the
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
        curve has no peak inside the range: it is flat to the rounding of float32 pixels, highest at
        an end, or there is too little texture or light.

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
    views = as_grey(light_field)
    height, width = views.shape[2:]
    region = as_region((0, height, 0, width) if region is None else region, (height, width))
    sides = region[1] - region[0], region[3] - region[2]
    parts = _cut(region, [max(min(4, side // 6), 1) for side in sides])  # 6 lenslets at least
    curves = _Curves(views, slopes, [region, *parts], as_weights(weights, light_field), asked=1)
    found = curves.searches()[0]
    if math.isnan(found.slope):
        raise InputError(f"No slope is sharpest: {found.doubt}.")
    return found


def find_sharpest_slopes(
    views: np.ndarray, tiles: Sequence[int], weights: np.ndarray
) -> list[SlopeSearch]:
    """Find the slope of sharpest focus of each of rows and columns of tiles, in one pass.

    The default range is shared: it widens while any curve rises at an end, or most have no peak. If
    a curve has no peak inside the range, the slope is NaN and the confidence 0.
    """
    regions = _cut((0, views.shape[2], 0, views.shape[3]), tiles)
    return _Curves(as_grey(views), None, regions, weights, asked=len(regions)).searches()


def _cut(region: Region, tiles: Sequence[int]) -> list[Region]:
    """Cut a region into tiles, row by row, with sizes that differ by at most a lenslet."""
    rows, columns = (
        pairwise((first + np.arange(n + 1) * (last - first) // n).tolist())
        for n, first, last in zip(tiles, region[::2], region[1::2], strict=True)
    )
    return [(*row, *column) for row, column in product(rows, columns)]


class _Curves:
    """Semblance and energy of regions at increasing slopes, [slope, region].

    The first `asked` regions are searched; further ones are parts of the first.
    """

    def __init__(self, views, slopes, regions, counts, asked: int):
        self.regions, self.asked = regions, asked
        self._views, self._counts, self._limit = views, counts, farthest_slope(views)
        self._in_parts = len(regions) > asked
        self._reach = RIVAL_REACH if self._in_parts else RIVAL_REACH_OF_TILES
        self._farthest, self._stride = -1.0, 1
        step = self._step = min(WIDEST_STEP, STEP_BY_VIEWS / max(max(views.shape[:2]) - 1, 1))
        if slopes is None:
            count = int(min(DEFAULT_RANGES[0], self._limit) / step + 1e-6)
            self.slopes = step * np.arange(-count, count + 1)
        else:
            given = as_steps(slopes)
            if np.abs(given).max() > self._limit:
                raise InputError(
                    f"slopes to search must lie within -{self._limit:g} to {self._limit:g}, beyond "
                    f"which views are shifted by more than the image, got {given.min():g} to "
                    f"{given.max():g}."
                )
            self._stride = max(int(np.ceil((given[1] - given[0]) / step - 1e-6)), 1)
            self.slopes = np.linspace(given[0], given[-1], (len(given) - 1) * self._stride + 1)
            self.slopes[:: self._stride] = given
        self.semblance, self.energy = self._measure(self.slopes)
        for end in DEFAULT_RANGES[1:] if slopes is None else ():
            if not self._settled():
                self._widen(-end, end)

    def _measure(self, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Semblance and energy at slopes; spectra are padded for the farthest, and kept."""
        farthest = float(np.abs(slopes).max(initial=0.0))
        if farthest > self._farthest:
            self._farthest = min(farthest + self._reach, self._limit)
            self._gradients = _Gradients(self._views, self._counts, self.regions, self._farthest)
        return self._gradients.measure(slopes)

    def _widen(self, low: float, high: float) -> None:
        """Measure at slopes down to `low` and up to `high`, too, as far as the image allows."""
        step = max(self.slopes[1] - self.slopes[0], self._step)
        low, high = max(low, -self._limit), min(high, self._limit)
        before = np.arange(self.slopes[0] - step, low - 1e-6 * step, -step)[::-1]
        after = np.arange(self.slopes[-1] + step, high + 1e-6 * step, step)
        later, earlier = self._measure(after), self._measure(before)
        self.semblance = np.concatenate([earlier[0], self.semblance, later[0]])
        self.energy = np.concatenate([earlier[1], self.energy, later[1]])
        self.slopes = np.concatenate([before, self.slopes, after])

    def _sharpness(self) -> np.ndarray:
        """Mean squared gradient of each region searched, with the energy at its highest sample."""
        semblance = self.semblance[:, : self.asked]
        return semblance * self.energy[semblance.argmax(axis=0), np.arange(self.asked)]

    def _flat(self) -> np.ndarray:
        """Whether each curve may be rounding alone.

        The mean square of ``gradient + error`` is wrong by up to ``2 gradient error + error^2``; a
        curve that varies by no more than that has no peak.
        """
        sharpness, error = self._sharpness(), self._gradients.rounding
        return np.ptp(sharpness, axis=0) <= error * (2 * np.sqrt(sharpness.max(axis=0)) + error)

    def _settled(self) -> bool:
        """Whether no curve rises at an end, and half of those that are not flat have a peak."""
        some = self.semblance[:, : self.asked][:, ~self._flat()]
        # Less than three times the value for unrelated views may be a ripple.
        high = some.max(axis=0) > min(3 / _effective(self._counts), 0.5)
        at_ends = np.isin(some.argmax(axis=0), (0, len(some) - 1))
        return not at_ends.any() and 2 * np.count_nonzero(high) >= high.size

    def searches(self) -> list[SlopeSearch]:
        """Find the peaks of all curves, and how far they can be trusted."""
        slopes, sharpness = self.slopes[:: self._stride], self._sharpness()[:: self._stride]
        doubts = [self._no_peak(k, flat) for k, flat in enumerate(self._flat())]
        peaks = [math.nan if doubt else self._peak(k) for k, doubt in enumerate(doubts)]
        if not all(doubts):
            self._widen(np.nanmin(peaks) - self._reach, np.nanmax(peaks) + self._reach)
        trusts = [self._trust(k, peak) for k, peak in enumerate(peaks)]
        return [
            SlopeSearch(peaks[k], slopes, sharpness[:, k], trust, self.regions[k], doubts[k] or why)
            for k, (trust, why) in enumerate(trusts)
        ]

    def _no_peak(self, k: int, flat: bool) -> str:
        """Why a curve has no peak; empty if it has one."""
        share = float(self.energy[:, k].max()) / max(self._gradients.mean_energy, 1e-300)
        if share <= LEAK:
            return (
                f"too little texture or light, a squared gradient {share:.1g} of the image's mean"
            )
        if flat:
            return "all are equally sharp, to the rounding of float32 pixels"
        curve, noise = self.semblance[:, k], 1 / _effective(self._counts)
        top = int(curve.argmax())
        if 0 < top < len(self.slopes) - 1:
            return ""
        return (
            f"too little texture or light, or a slope beyond {self.slopes[top]:g}, the end at "
            f"which the views agree best, by {curve[top]:.1%} (noise by {noise:.1%})"
        )

    def _peak(self, k: int) -> float:
        """Slope of a curve's peak, interpolated with a spline.

        The part that the views do not share at the peak is taken as noise of equal strength
        everywhere, and subtracted, up to half of the energy. Where fewer views see the edges it
        counts less, and would shift a flat peak.
        """
        slopes, semblance, alone = self.slopes, self.semblance[:, k], 1 / _effective(self._counts)
        top = int(semblance.argmax())
        near = slice(max(top - 5, 0), top + 6)
        energy = np.maximum(self.energy[near, k] / self.energy[top, k], 1e-6)
        noise = min(1 - _shared(semblance[top], self._counts), energy.min() / 2)
        curve = (semblance[near] * energy - noise * alone) / (energy - noise)
        spline = make_interp_spline(slopes[near], curve, k=min(5, len(curve) - 1))
        bounds = slopes[max(top - 2, 0)], slopes[min(top + 2, len(slopes) - 1)]
        return float(minimize_scalar(lambda slope: -spline(slope), bounds=bounds).x)

    def _trust(self, k: int, peak: float) -> tuple[float, str]:
        """Confidence of a peak, and why it is below 0.5; 0 without a peak."""
        if math.isnan(peak):
            return 0.0, ""
        near = np.abs(self.slopes - peak) <= self._reach + 1e-9
        curve, at = self.semblance[near, k], int(np.abs(self.slopes[near] - peak).argmin())
        top = curve[max(at - 1, 0) : at + 2].max()
        tops, _ = find_peaks(np.pad(curve, 1), prominence=0.02 * top)
        second = curve[[n for n in tops - 1 if abs(n - at) > 1]].max(initial=0.0)
        mixed = self._mixed(near, at, peak, top) if self._in_parts else 0.0
        rivals = {
            "several slopes are sharp": second / top,
            "too little texture": 1 / (_effective(self._counts) * top),
            "less than one pixel of parallax between the outer views": curve.min() / top,
        }
        if second > 0.8 * top > 0.64:  # two layers share the energy; a repeated texture has it all
            rivals = {"the texture repeats": second / top}
        doubt, rival = max(rivals.items(), key=lambda item: item[1])
        confidence = max(1 - float(rival), 0.0) * (1 - mixed)
        doubt = "several slopes are sharp" if mixed > rival else doubt
        return confidence, doubt if confidence < 0.5 else ""

    def _mixed(self, near: np.ndarray, at: int, peak: float, top: float) -> float:
        """How far one slope does not fit all of the first region, from 0 to 1.

        Layers whose peaks have merged: views of a third of the aperture agree better at the slope
        than all views do, where noise would lower both. Layers side by side: parts of the region,
        weighted by amplitude so that faint texture matters too, have a higher semblance elsewhere.
        """
        parts, here = self.semblance[near, 1:], np.argmin(np.abs(self.slopes - peak))
        amplitude = np.sqrt(np.maximum(self.energy[here, 1:], 0))
        own = max(float(amplitude @ parts.max(axis=0)), 1e-300)
        lost = 1 - float(amplitude @ parts[max(at - 1, 0) : at + 2].max(axis=0)) / own
        sizes = [(n, min(n, max(n // 3, 2))) for n in self._counts.shape]
        rows, columns = (slice((n - size) // 2, (n + size) // 2) for n, size in sizes)
        agreeing = self._gradients.measure(np.array([peak]), (rows, columns))[0][0, 0]
        inner = self._counts[rows, columns]
        whole, few = _shared(top, self._counts), _shared(agreeing, inner)
        spread = 1 - whole / few if few > 0 and _effective(inner) > 1 else 0.0
        return min(max(lost, spread, 0.0) / MIXED, 1.0)


class _Gradients:
    """Spectra of the gradients of the low-passed views near regions; sums over the regions."""

    def __init__(self, views, counts: np.ndarray, regions: list[Region], farthest: float):
        reach, ends = int(farthest * (max(counts.shape) - 1) / 2) + REACH, np.array(regions)
        cuts = [
            slice(max(ends[:, 2 * k].min() - reach, 0), ends[:, 2 * k + 1].max() + reach)
            for k in (0, 1)
        ]
        seen = views[:, :, cuts[0], cuts[1]]
        self._size = seen.shape[2:4]
        # Divided by a power of two, float32 sums do not overflow, and no digit changes.
        brightest = max(float(seen.max()), -float(seen.min()))
        self._exponent, self.rounding = int(np.frexp(brightest)[1]), ROUNDING * brightest
        # Long enough that nothing that leaves at one end wraps around into a region.
        self._periods = [fft.next_fast_len(n + min(reach, n), real=True) for n in self._size]
        self._counts, mean_energy = counts / counts.sum(), 0.0
        taper = np.multiply.outer(*map(_taper, self._size))
        waves = self._periods[0], 2, self._periods[1] // 2 + 1
        self._spectra = np.zeros((3, *counts.shape, *waves), np.float32)
        for v, u in np.argwhere(counts > 0):
            grey, count = np.ldexp(seen[v, u].astype(float), -self._exponent), self._counts[v, u]
            fields = [
                gaussian_filter(grey, SMOOTH, order=order, mode="nearest", truncate=6.0)
                for order in ((1, 0), (0, 1))
            ]
            fields.append(fields[0] ** 2 + fields[1] ** 2)
            mean_energy += float(count * fields[2].mean())
            for spectra, field in zip(self._spectra[:, v, u], fields, strict=True):
                spectrum = fft.rfft2(count * taper * field, self._periods)
                spectra[:, 0], spectra[:, 1] = spectrum.real, spectrum.imag
        self._least_energy = LEAK * mean_energy
        self.mean_energy = float(np.ldexp(mean_energy, 2 * self._exponent))
        self._down, self._across = (
            _cover(ends[:, 2 * k : 2 * k + 2] - cuts[k].start, n) for k, n in enumerate(self._size)
        )

    def measure(
        self, slopes: np.ndarray, block: tuple[slice, slice] = (slice(None), slice(None))
    ) -> tuple[np.ndarray, np.ndarray]:
        """Semblance and mean squared gradient of a block of the views: float64, [slope, region]."""
        counts, spectra = self._counts[block], np.ascontiguousarray(self._spectra[:, *block])
        steps = [centred(n)[some] for n, some in zip(self._counts.shape, block, strict=True)]
        frequencies = fft.fftfreq(self._periods[0]), fft.rfftfreq(self._periods[1])
        semblance, energy = np.zeros((2, len(slopes), len(self._down[1])))
        for first in range(0, len(slopes), 8):  # slopes for each reading of the spectra
            some = slopes[first : first + 8]
            phases = [
                np.exp(2j * np.pi * some[:, None, None] * step[:, None] * waves)
                for step, waves in zip(steps, frequencies, strict=True)
            ]
            split = [np.stack([x.real, x.imag]).astype(np.float32) for x in phases]
            mean = np.empty((3, len(some), *spectra.shape[3:]), np.float32)
            _kernels.sum_spectra(spectra, *split, mean)
            for n, slope in enumerate(some, first):
                shifted = mean[:, n - first, :, 0] + 1j * mean[:, n - first, :, 1]
                images = fft.irfft2(shifted, self._periods)[:, : self._size[0], : self._size[1]]
                down, across, alike = images.astype(float)
                by_row, by_column = self._tapers(slope, steps)  # not with BLAS, as in `_sum`
                tapers = np.einsum("vt,vs->ts", by_row, np.einsum("vu,us->vs", counts, by_column))
                parts = down**2 + across**2, tapers * alike, tapers**2
                agreeing, alike, seen = (self._sum(part) for part in parts)
                energy[n] = alike / np.maximum(seen, 1e-300)
                some_light = energy[n] > self._least_energy
                np.divide(agreeing, alike, out=semblance[n], where=some_light)
        return semblance, np.ldexp(energy, 2 * self._exponent)

    def _tapers(self, slope: float, steps: list[np.ndarray]) -> list[np.ndarray]:
        """Taper of each view along both axes, shifted with it as the spectra are."""
        lines = []
        for n, period, step in zip(self._size, self._periods, steps, strict=True):
            turns = np.exp(2j * np.pi * slope * step[:, None] * fft.rfftfreq(period))
            lines.append(fft.irfft(fft.rfft(_taper(n), period) * turns, period)[:, :n])
        return lines

    def _sum(self, image: np.ndarray) -> np.ndarray:
        """Sum over each region; not with BLAS, where sums depend on the number of threads."""
        (down, row), (across, column) = self._down, self._across
        lines = np.einsum("it,ts->is", down, image)
        return np.einsum("is,js->ij", lines, across)[row, column]


def _effective(counts: np.ndarray) -> float:
    """Effective number of views with these weights; n unrelated views have a semblance of 1/n."""
    return max(float(counts.sum() ** 2 / max(np.square(counts).sum(), 1e-300)), 1.0)


def _shared(semblance: float, counts: np.ndarray) -> float:
    """Part of the energy that views with these weights share; 1 for a single view."""
    alone = 1 / _effective(counts)
    return (semblance - alone) / (1 - alone) if alone < 1 else 1.0


def _cover(bounds: np.ndarray, length: int) -> tuple[np.ndarray, np.ndarray]:
    """Coverage of lenslets by different intervals, soft at the ends, and the interval of each."""
    intervals, which = np.unique(bounds, axis=0, return_inverse=True)
    lenslets = np.arange(length)
    covered = (intervals[:, :1] <= lenslets) & (lenslets < intervals[:, 1:])
    return gaussian_filter1d(covered.astype(float), SOFTNESS, mode="constant"), which.ravel()


def _taper(n: int) -> np.ndarray:
    """Taper of a view along an axis: 1, falling to 0 at its edges."""
    inward = (np.minimum(np.arange(n), np.arange(n)[::-1]) + 0.5) / min(REACH, n / 4)
    return np.sin(np.pi / 2 * np.minimum(inward, 1)) ** 2
