"""Flicker of a flame: the frequency of a series of heights, with its significance.

At each frequency a sine is fitted together with a drift, a cubic in time: times may be uneven and
frames missing, and drift is not mistaken for slow flicker. This is the generalised Lomb-Scargle
periodogram (Zechmeister and Kuerster 2009) with more than a mean, weighted by the covariance of
the noise. Heights of flames wander: the noise is white noise plus an Ornstein-Uhlenbeck process,
which at even times is the AR(1) "red" noise of climate series, fitted to the heights themselves.
The significance of a peak is the bound of Baluev (2008) on its false-alarm probability.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import exp, lgamma, pi, sqrt

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cholesky_banded, solve_banded
from scipy.optimize import brentq, minimize, minimize_scalar
from scipy.special import expit

from lf_flame.errors import InputError

LEAST_FRAMES = 16
"""Smallest number of heights for a frequency; drift and sine alone have seven parameters."""

LEAST_PERIODS = 3.0
"""Smallest number of periods of a rhythm; a drift that is not cubic has its peaks below."""

FALSE_ALARM = 0.01
"""Probability below which a peak is more than noise."""


@dataclass(frozen=True, eq=False)
class Flicker:
    """Frequency of a series of heights, with its significance.

    Attributes
    ----------
    peak_hz : float
        Frequency of the highest peak relative to the noise, significant or not; a significant one
        of fewer than three periods is taken only where there is no other. NaN if the heights are
        constant or only drift.
    amplitude : float
        Amplitude of the sine at the peak, in the unit of the heights.
    false_alarm : float
        Probability that noise alone has such a peak somewhere in the spectrum.
    resolution_hz : float
        Resolution, 1 / duration: closer peaks merge, and no better accuracy is guaranteed.
    resolvable : float
        Smallest amplitude of a flicker, in the unit of the heights.
    frequencies_hz : ndarray of float64, shape (frequencies,)
        Frequencies of the spectrum: from one and a half periods in the duration to one period in
        two frames.
    power : ndarray of float64, shape (frequencies,)
        Fraction of the heights' scatter about drift and slow fluctuations that a sine explains, 0
        to 1, both weighted by the noise.
    level : float
        Power with a false-alarm probability of 1 %.
    noise : Noise
        Noise by which the power is weighted.
    """

    peak_hz: float
    amplitude: float
    false_alarm: float
    resolution_hz: float
    resolvable: float
    frequencies_hz: np.ndarray = field(repr=False)
    power: np.ndarray = field(repr=False)
    level: float
    noise: Noise

    @property
    def frequency_hz(self) -> float:
        """Frequency in Hz; NaN if the peak may be noise, is too small, or has too few periods."""
        periods, is_large = self.peak_hz / self.resolution_hz, self.amplitude >= self.resolvable
        is_found = self.false_alarm < FALSE_ALARM and periods >= LEAST_PERIODS and is_large
        return self.peak_hz if is_found else float("nan")

    def describe(self, *, unit: str = "") -> str:
        """Describe the result in a sentence, amplitudes with the unit of the heights."""
        hz, periods = f"{self.peak_hz:.4g} Hz", self.peak_hz / self.resolution_hz
        alarm = f"false-alarm probability {self.false_alarm:.2g}"
        amplitude, least = (f"{x:.2g} {unit}".rstrip() for x in (self.amplitude, self.resolvable))
        if not np.isfinite(self.peak_hz):
            return "There is no flicker: the heights are constant, or only drift."
        if self.false_alarm >= FALSE_ALARM:
            return f"No frequency is above the noise: the highest peak, at {hz}, has a {alarm}."
        if periods < LEAST_PERIODS:
            return (
                f"No frequency is found: the highest peak, at {hz}, has {periods:.2g} periods in "
                f"these frames; at least {LEAST_PERIODS:g} ({LEAST_PERIODS / self.peak_hz:.2g} s) "
                f"are needed."
            )
        if self.amplitude < self.resolvable:
            return (
                f"No flicker is found: the highest peak, at {hz} ({amplitude}), is below the "
                f"accuracy of the tip's row ({least}), as when a steady flame moves."
            )
        return (
            f"The flame flickers at {hz}, resolution {self.resolution_hz:.2g} Hz, amplitude "
            f"{amplitude}, {alarm}."
        )


def find_flicker(times_s: ArrayLike, heights: ArrayLike, *, resolvable: float = 0.0) -> Flicker:
    """Find the frequency of a series of heights.

    Parameters
    ----------
    times_s : array_like, shape (frames,)
        Times in s, increasing, not necessarily evenly spaced.
    heights : array_like, shape (frames,)
        Heights in any unit; frames with NaN are left out.
    resolvable : float, optional
        Smallest amplitude of a flicker, in the unit of the heights. `row_error` gives the value for
        heights of `measure_flame`. Default: any amplitude.

    Returns
    -------
    Flicker
        Frequency, up to half the frame rate by the median distance in time; a faster flicker
        appears at a lower frequency (aliasing).

    Raises
    ------
    InputError
        If times and heights do not match, times do not increase, fewer than `LEAST_FRAMES` heights
        are known, or `resolvable` is negative.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.flame_video import find_flicker
    >>> times_s = np.arange(400) / 100
    >>> found = find_flicker(times_s, 20 + np.sin(2 * np.pi * 12.3 * times_s))
    >>> round(found.frequency_hz, 1)
    12.3
    """
    times, values = _checked_series(times_s, heights)
    if not 0 <= resolvable < np.inf:
        raise InputError(f"resolvable must be an amplitude, 0 or more, got {resolvable}.")
    frequencies = _frequencies(times)
    times = times - times.mean()
    (peak, amplitude, alarm), fit = _find_peak(times, values, frequencies)
    level = brentq(lambda power: fit.false_alarm(power) - FALSE_ALARM, 1e-9, 1 - 1e-9)
    resolution = 1 / np.ptp(times)
    return Flicker(
        peak, amplitude, alarm, resolution, resolvable, frequencies, fit.power, level, fit.noise
    )


def _find_peak(times: np.ndarray, values: np.ndarray, frequencies: np.ndarray):
    """Find frequency, amplitude and false alarm of the highest peak, and the fit that shows it.

    A drift that is not cubic, and slow fluctuations, are added to the drift: they hide no flicker.
    """
    base = np.polynomial.legendre.legvander(times / np.abs(times).max(), 3)
    # A drift that is not cubic, or a slightly uneven rhythm, leaves 2 % of the scatter.
    negligible = 0.02**2 * float(np.sum((values - values.mean()) ** 2))
    found, shown = (np.nan, np.nan, 1.0), None
    for _ in range(3):
        fit = _SineFit(times, values, base, WHITE, frequencies)
        if fit.scatter <= negligible:
            break
        fit = _SineFit(times, values, base, _fit_noise(times, values, base), frequencies)
        # A strong sine must not be mistaken for noise.
        beside = np.column_stack([base, *_sines(times, fit.highest()[0])])
        fit = _SineFit(times, values, base, _fit_noise(times, values, beside), frequencies)
        peak, power = fit.highest()
        beside = np.column_stack([base, *_sines(times, peak)])
        amplitude = float(np.hypot(*np.linalg.lstsq(beside, values, rcond=None)[0][-2:]))
        alarm = fit.false_alarm(power)
        is_swing = peak * np.ptp(times) < LEAST_PERIODS
        if shown is None or (alarm < FALSE_ALARM and not is_swing):
            found, shown = (peak, amplitude, alarm), fit
        if alarm >= FALSE_ALARM or not is_swing:
            break
        base = beside
    return found, shown or fit


def _checked_series(times_s: ArrayLike, heights: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    times, values = (np.asarray(one, np.float64) for one in (times_s, heights))
    if times.ndim != 1 or times.shape != values.shape:
        raise InputError(
            f"Times and heights must be two equal series, got {times.shape} and {values.shape}."
        )
    known = np.isfinite(values)
    if np.count_nonzero(known) < LEAST_FRAMES:
        raise InputError(
            f"A frequency needs at least {LEAST_FRAMES} frames with a height, got "
            f"{np.count_nonzero(known)}."
        )
    if not (np.all(np.abs(times) <= 1e12) and np.all(np.diff(times) >= 1e-15)):
        raise InputError(
            "The times of frames must increase, by 1e-15 s or more, and be at most 1e+12 s."
        )
    return times[known], values[known]


def _frequencies(times: np.ndarray) -> np.ndarray:
    """Frequencies of the spectrum, five for each 1 / duration: fewer would miss tops of peaks."""
    resolution = 1 / (times[-1] - times[0])
    lowest = 1.5 * resolution  # below, a cubic resembles a sine
    # At exactly half the sampling rate, cosine and sine cannot be separated.
    highest = 0.5 / np.median(np.diff(times)) - resolution / 2
    count = max(2, 1 + int(np.ceil((highest - lowest) / resolution * 5)))
    if count > 1e7:
        raise InputError(f"The times have gaps too long for a spectrum of {count:,} frequencies.")
    return np.linspace(lowest, max(highest, lowest + resolution), count)


@dataclass(frozen=True)
class Noise:
    """Covariance of the noise, in units of its variance.

    `white_share` of it, above 0 and up to 1, is white noise. The correlation of the rest, red
    noise, falls to 1 / e in `memory_s`.
    """

    memory_s: float
    white_share: float

    def whiten(self, times: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, float]:
        """Make the noise in columns white, of variance 1; give log(det(covariance)) / 2, too.

        The innovations R x of red noise are white, and R is bidiagonal; the covariance of the whole
        is C = inv(R) D inv(R)^T with D = (1 - w) + w R R^T, which is tridiagonal, so that
        inv(cholesky(D)) R whitens in a time in proportion to the number of frames.
        """
        steps, white = np.diff(times) / self.memory_s, self.white_share
        if white == 1:
            return columns, 0.0
        gain = 1 / np.sqrt(-np.expm1(-2 * steps))
        diagonal, beside = np.append(1.0, gain), -np.exp(-steps) * gain
        bands = np.zeros((2, len(times)))
        bands[0] = 1 - white + white * (diagonal**2 + np.append(0.0, beside**2))
        bands[1, :-1] = white * beside * diagonal[:-1]
        factor = cholesky_banded(bands, lower=True)
        innovations = diagonal[:, None] * columns
        innovations[1:] += beside[:, None] * columns[:-1]
        whitened = solve_banded((1, 0), factor, innovations)
        return whitened, float(np.log(factor[0]).sum() - np.log(gain).sum())


WHITE = Noise(1.0, 1.0)


def _fit_noise(times: np.ndarray, values: np.ndarray, base: np.ndarray) -> Noise:
    """Find the noise with the highest likelihood for values about the columns of a base model.

    The likelihood is restricted (REML): fitting the base model does not make noise look whiter.
    """
    columns, free = np.column_stack([base, values]), len(times) - base.shape[1]
    frame = float(np.median(np.diff(times)))
    # With a memory of 0.3 frames, the shortest, neighbours correlate by 0.04.
    bounds = ((np.log(0.3), np.log(np.ptp(times) / frame)), (-9.0, 9.0))

    def noise(point) -> Noise:
        return Noise(frame * float(np.exp(point[0])), float(expit(point[1])))

    def unlikely(point) -> float:
        whitened, log_root = noise(point).whiten(times, columns)
        sides = np.abs(np.diag(np.linalg.qr(whitened, mode="r")))
        return float(log_root + np.log(sides[:-1]).sum() + free * np.log(max(sides[-1], 1e-300)))

    memories = np.linspace(*bounds[0], 8)[1:-1]
    best = min(((x, y) for x in memories for y in (-6.0, -2.0, 0.0, 2.0)), key=unlikely)
    options = {"maxfev": 80, "xatol": 0.02, "fatol": 0.005}
    return noise(minimize(unlikely, best, method="Nelder-Mead", bounds=bounds, options=options).x)


def _sines(times: np.ndarray, frequencies: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    angles = 2 * pi * np.outer(times, frequencies)
    return np.cos(angles), np.sin(angles)


class _SineFit:
    """Series relative to the columns of a base model, both whitened.

    `scatter` is the sum of the squares about the base model; 0 if it is only rounding.
    """

    def __init__(self, times, values, base, noise: Noise, frequencies: np.ndarray):
        self.times, self.noise, self.frequencies = times, noise, frequencies
        self._base = np.linalg.qr(noise.whiten(times, base)[0])[0]
        self._rest = self._without_base(noise.whiten(times, values[:, None])[0])[:, 0]
        scatter = float(self._rest @ self._rest)
        rounding = len(values) * (1e-9 * np.abs(values).max()) ** 2
        self.scatter = 0.0 if scatter <= rounding else scatter

    def _without_base(self, columns: np.ndarray) -> np.ndarray:
        return columns - self._base @ (self._base.T @ columns)

    @cached_property
    def power(self) -> np.ndarray:
        """Fraction of the scatter about the base model that a sine of each frequency explains."""
        count = 1 + len(self.times) * len(self.frequencies) // 2**18  # bounds the memory
        return np.concatenate([self._explained(x) for x in np.array_split(self.frequencies, count)])

    def _explained(self, frequencies: np.ndarray) -> np.ndarray:
        if self.scatter == 0:
            return np.zeros(len(frequencies))
        whole = [self.noise.whiten(self.times, x)[0] for x in _sines(self.times, frequencies)]
        cosine, sine = (self._without_base(one) for one in whole)
        pairs = (cosine, cosine), (sine, sine), (cosine, sine)
        cc, ss, cs = ((a * b).sum(axis=0) for a, b in pairs)
        cy, sy = self._rest @ cosine, self._rest @ sine
        determinant = cc * ss - cs**2
        # A frequency cannot be determined where cosine and sine are equal at all times, or where
        # the base model contains nine tenths of both.
        known = determinant > 1e-9 * (cc + ss) ** 2
        known &= cc + ss > 0.1 * sum((one**2).sum(axis=0) for one in whole)
        determinant = np.where(known, determinant, np.inf)
        explained = (ss * cy**2 - 2 * cs * cy * sy + cc * sy**2) / determinant
        return np.clip(explained / self.scatter, 0, 1)

    def highest(self) -> tuple[float, float]:
        """Frequency of highest power, refined between its neighbours, and the power."""
        top = int(self.power.argmax())
        ends = self.frequencies[max(top - 1, 0)], self.frequencies[top : top + 2][-1]
        found = minimize_scalar(
            lambda frequency: -self._explained(np.array([frequency]))[0],
            bounds=ends, method="bounded", options={"xatol": 1e-4 * (ends[1] - ends[0])},
        )  # fmt: skip
        return float(found.x), float(-found.fun)

    def false_alarm(self, power: float) -> float:
        """Bound the probability that noise has a peak of a power anywhere in the spectrum.

        Baluev, MNRAS 385, 1279 (2008), for a power relative to the scatter about a base model.
        """
        left, free = 1 - power, len(self.times) - self._base.shape[1]
        single = left ** ((free - 2) / 2)
        width = np.ptp(self.frequencies) * sqrt(4 * pi * float(np.mean(self.times**2)))
        gamma = sqrt(2 / free) * exp(lgamma(free / 2) - lgamma((free - 1) / 2))
        crossings = gamma * width * left ** ((free - 3) / 2) * sqrt(free * power / 2)
        # Written so that tiny probabilities are not lost in rounding.
        return float(single - (1 - single) * np.expm1(-crossings))
