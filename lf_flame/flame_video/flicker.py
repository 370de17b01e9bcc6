"""Flicker of a flame: frequencies in a series of heights, with their significance.

At each frequency a sine is fitted together with a drift, a cubic in time: times may be uneven and
frames missing, and a drift is not taken for a slow flicker. This is the generalised Lomb-Scargle
periodogram (Zechmeister and Kuerster 2009) with more than a mean, weighted by the covariance of
the noise. Heights of flames wander: the noise is white noise plus an Ornstein-Uhlenbeck process,
which at even times is the AR(1) "red" noise of climate series, fitted to the heights themselves.
The significance of a peak is the bound of Baluev (2008) on its false-alarm probability. Each sine
found joins the drift, and the search goes on: no strong line or slow swing hides another line.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import exp, lgamma, pi, sqrt

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded
from scipy.optimize import minimize, minimize_scalar
from scipy.special import expit

from lf_flame.errors import InputError

LEAST_FRAMES = 16
"""Smallest number of heights for a frequency; drift and sine alone have seven parameters."""

FIRST_PERIODS, LEAST_PERIODS = 1.5, 3.0
"""Number of periods at the lowest frequency of the spectrum, below which a cubic resembles a sine;
and the smallest number of a rhythm, below which a drift that is no cubic has its peaks."""

FALSE_ALARM = 0.01
"""Probability below which a peak is more than noise."""

MOST_SINES = 8
"""Largest number of sines that are fitted, including slow swings."""

SAME_LINE = 2.0
"""Distance in 1 / duration within which a peak belongs to a known line: a flame's rhythm is
slightly uneven, so that its line is wider than that of a sine."""


@dataclass(frozen=True)
class Line:
    """Sine in the heights: frequency in Hz, amplitude in the unit of the heights, and false alarm.

    The false alarm is the probability that noise alone has such a peak somewhere in the spectrum.
    """

    frequency_hz: float
    amplitude: float
    false_alarm: float


NO_LINE = Line(float("nan"), float("nan"), 1.0)


@dataclass(frozen=True)
class Wander:
    """Covariance of the noise, in units of its variance.

    `white_share` of it, above 0 and up to 1, is white noise. The correlation of the rest, red
    noise, falls to 1 / e in `memory_s`.
    """

    memory_s: float
    white_share: float

    def weigher(self, times: np.ndarray) -> tuple[Callable[[np.ndarray], np.ndarray], float]:
        """Give the product with the covariance's inverse, and the logarithm of its determinant.

        The inverse of the red noise's covariance is tridiagonal (Rybicki and Press, Physical
        Review Letters 74, 1060, 1995): all takes time in proportion to the number of frames.
        """
        steps, white = np.diff(times) / self.memory_s, self.white_share
        kept, gain = np.exp(-steps), -1 / np.expm1(-2 * steps)
        diagonal, beside = np.concatenate([[1.0], gain]), -kept * gain
        diagonal[:-1] += kept**2 * gain
        bands = np.zeros((2, len(times)))
        bands[0], bands[1, :-1] = 1 - white + white * diagonal, white * beside
        factor = cholesky_banded(bands, lower=True)

        def weigh(columns: np.ndarray) -> np.ndarray:
            solved = cho_solve_banded((factor, True), columns)
            weighed = diagonal[:, None] * solved
            weighed[1:] += beside[:, None] * solved[:-1]
            weighed[:-1] += beside[:, None] * solved[1:]
            return weighed

        return weigh, float(2 * np.log(factor[0]).sum() - np.log(gain).sum())


@dataclass(frozen=True, eq=False)
class Flicker:
    """Frequencies of a series of heights, with their significance.

    Attributes
    ----------
    lines : tuple of Line
        Significant sines, in the order in which they were found.
    swings : tuple of Line
        Significant sines of fewer than three periods in the duration: no rhythm.
    unresolved : tuple of Line
        Significant sines with an amplitude below `resolvable`: the measurement itself may make
        them.
    peak : Line
        First line; without one, the highest peak relative to the noise, whatever it is. NaN if the
        heights are constant or only drift.
    resolution_hz : float
        Resolution, 1 / duration: closer peaks merge, and no frequency is known better for certain.
    resolvable : float
        Smallest amplitude of a line, in the unit of the heights.
    frequencies_hz : ndarray of float64, shape (frequencies,)
        Frequencies of the spectrum: from one and a half periods in the duration to one period in
        two frames.
    power : ndarray of float64, shape (frequencies,)
        Fraction of the heights' variance about their drift that a sine explains, 0 to 1.
    noise : Wander
        Noise with which the significance was computed.
    """

    lines: tuple[Line, ...]
    swings: tuple[Line, ...]
    unresolved: tuple[Line, ...]
    peak: Line
    resolution_hz: float
    resolvable: float
    frequencies_hz: np.ndarray
    power: np.ndarray
    noise: Wander

    @property
    def frequency_hz(self) -> float:
        """Frequency of the first line in Hz; NaN if there is none."""
        return self.lines[0].frequency_hz if self.lines else float("nan")

    @property
    def amplitude(self) -> float:
        """Amplitude of the sine at the peak, in the unit of the heights."""
        return self.peak.amplitude

    @property
    def false_alarm(self) -> float:
        """Probability that noise alone has such a peak somewhere in the spectrum."""
        return self.peak.false_alarm

    @property
    def peak_hz(self) -> float:
        """Frequency of the peak in Hz."""
        return self.peak.frequency_hz

    def describe(self, *, unit: str = "") -> str:
        """Describe the result in some sentences, amplitudes with the unit of the heights."""
        alarm = f"false-alarm probability {self.false_alarm:.2g}"
        slow = [f"{one.frequency_hz:.3g} Hz" for one in self.swings]
        if self.lines:
            said = (
                f"The flame flickers at {self.frequency_hz:.4g} Hz, resolution "
                f"{self.resolution_hz:.2g} Hz, amplitude {_size(self.amplitude, unit)}, {alarm}."
            )
        elif self.swings:
            hz = self.swings[0].frequency_hz
            said = (
                f"No frequency is found: the highest peak, at {hz:.4g} Hz, has "
                f"{hz / self.resolution_hz:.2g} periods in these frames; at least "
                f"{LEAST_PERIODS:g} ({LEAST_PERIODS / hz:.2g} s) are needed."
            )
            slow = slow[1:]
        elif self.unresolved:
            said = "No flicker is found."
        elif np.isfinite(self.peak_hz):
            said = (
                f"No frequency is above the noise: the highest peak, at {self.peak_hz:.4g} Hz, "
                f"has a {alarm}."
            )
        else:
            said = "There is no flicker: the heights are constant, or only drift."
        if self.lines[1:]:
            said += f" Further lines, or parts of an uneven rhythm: {_named(self.lines[1:], unit)}."
        if slow:
            said += f" Slow swings of fewer than three periods, no lines: {', '.join(slow)}."
        if self.unresolved:
            said += (
                f" Below the accuracy of the tip's row ({_size(self.resolvable, unit)}), and also "
                f"seen when a steady flame moves: {_named(self.unresolved, unit)}."
            )
        return said


def _size(amplitude: float, unit: str) -> str:
    return f"{amplitude:.2g} {unit}".rstrip()


def _named(lines: tuple[Line, ...], unit: str) -> str:
    return ", ".join(f"{x.frequency_hz:.4g} Hz ({_size(x.amplitude, unit)})" for x in lines)


def find_flicker(times_s: ArrayLike, heights: ArrayLike, *, resolvable: float = 0.0) -> Flicker:
    """Find the frequencies of a series of heights.

    Parameters
    ----------
    times_s : array_like, shape (frames,)
        Times in s, rising, not necessarily evenly spaced.
    heights : array_like, shape (frames,)
        Heights in any unit; frames with NaN are left out.
    resolvable : float, optional
        Smallest amplitude of a line, in the unit of the heights. A smaller sine is removed like a
        line, so that the search continues, and listed in `unresolved`. `row_error` gives the value
        for heights of `measure_flame`. Default: any amplitude is a line.

    Returns
    -------
    Flicker
        Frequencies up to half the frame rate, from the median distance in time; a faster flicker
        appears at a lower frequency (aliasing).

    Raises
    ------
    InputError
        If times and heights do not match, times cannot be those of frames (`check_times`), fewer
        than `LEAST_FRAMES` heights are known, or `resolvable` is no length.

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
        raise InputError(
            f"resolvable must be the smallest amplitude of a line, 0 or more, got {resolvable}."
        )
    resolution, frequencies = 1 / (times[-1] - times[0]), _frequencies(times)
    times = times - times.mean()
    base = drift = np.polynomial.legendre.legvander(times / np.abs(times).max(), 3)
    white = noise = Wander(1.0, 1.0)
    spectrum = fit = _SineFit(times, values, drift, white)
    # A drift that is no cubic, or a slightly uneven rhythm, leaves 2 % of the scatter.
    negligible = 0.02**2 * float(np.sum((values - values.mean()) ** 2))
    found: list[Line] = []
    highest = NO_LINE
    while base.shape[1] + 2 <= len(times) / 2 and base.shape[1] < drift.shape[1] + 2 * MOST_SINES:
        if _SineFit(times, values, base, white).scatter <= negligible:
            break
        noise = _fit_noise(times, values, base)
        fit = _SineFit(times, values, base, noise)
        peak = fit.highest(frequencies)
        base = np.column_stack([base, _sines(times, peak)])
        amplitude = float(np.hypot(*np.linalg.lstsq(base, values, rcond=None)[0][-2:]))
        line = Line(peak, amplitude, fit.false_alarm(peak, float(np.ptp(frequencies))))
        highest = highest if found else line
        if line.false_alarm >= FALSE_ALARM:
            break
        near = [one for one in found if abs(peak - one.frequency_hz) < SAME_LINE * resolution]
        # A drift that is no cubic has its highest peak as a swing, and more up to six periods.
        swings = any(one.frequency_hz < LEAST_PERIODS * resolution for one in found)
        if not near and not (swings and peak < 2 * LEAST_PERIODS * resolution):
            found.append(line)
    slow = [one for one in found if one.frequency_hz < LEAST_PERIODS * resolution]
    small = [one for one in found if one not in slow and one.amplitude < resolvable]
    lines = [one for one in found if one not in slow and one not in small]
    return Flicker(
        tuple(lines), tuple(slow), tuple(small), lines[0] if lines else highest, resolution,
        resolvable, frequencies, spectrum.power(frequencies), noise,
    )  # fmt: skip


def check_times(times_s: np.ndarray, source: str = "of frames") -> None:
    """Refuse times that do not rise by 1e-15 s or more, or are beyond 1e12 s."""
    if not (np.all(np.abs(times_s) <= 1e12) and np.all(np.diff(times_s) >= 1e-15)):
        raise InputError(
            f"The times {source} must rise from frame to frame, by 1e-15 s or more, and be at most "
            f"1e+12 s."
        )


def _checked_series(times_s: ArrayLike, heights: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    times, values = (np.asarray(one, np.float64) for one in (times_s, heights))
    if times.ndim != 1 or times.shape != values.shape:
        raise InputError(
            f"Times and heights must be two series of one length, got arrays of shape "
            f"{times.shape} and {values.shape}."
        )
    known = np.isfinite(values)
    if np.count_nonzero(known) < LEAST_FRAMES:
        raise InputError(
            f"A frequency needs {LEAST_FRAMES} frames with a height at least, got "
            f"{np.count_nonzero(known)}."
        )
    check_times(times)
    return times[known], values[known]


def _frequencies(times: np.ndarray) -> np.ndarray:
    """Frequencies of the spectrum, five for each 1 / duration: fewer would miss tops of peaks."""
    resolution = 1 / (times[-1] - times[0])
    lowest = FIRST_PERIODS * resolution
    # At exactly half the sampling rate, cosine and sine cannot be separated.
    highest = 0.5 / np.median(np.diff(times)) - resolution / 2
    count = max(2, 1 + int(np.ceil((highest - lowest) / resolution * 5)))
    return np.linspace(lowest, max(highest, lowest + resolution), count)


def _sines(times: np.ndarray, frequency_hz: float) -> np.ndarray:
    angle = 2 * pi * frequency_hz * times
    return np.column_stack([np.cos(angle), np.sin(angle)])


def _fit_noise(times: np.ndarray, values: np.ndarray, base: np.ndarray) -> Wander:
    """Find the noise with the highest likelihood for values about the columns of a base model.

    The likelihood is restricted (REML): fitting the base model does not make noise look whiter.
    """
    columns, known = np.column_stack([base, values]), base.shape[1]
    frame, duration = float(np.median(np.diff(times))), float(times[-1] - times[0])
    # With a memory of 0.3 frames, the shortest, neighbours correlate by 0.04.
    bounds = ((np.log(0.3), np.log(duration / frame)), (-9.0, 9.0))

    def noise(point) -> Wander:
        return Wander(frame * float(np.exp(point[0])), float(expit(point[1])))

    def unlikely(point) -> float:
        weigh, log_determinant = noise(point).weigher(times)
        try:
            root = np.diag(np.linalg.cholesky(columns.T @ weigh(columns)))
        except LinAlgError:  # values without any noise
            return 1e300
        fitted = np.log(root[:known]).sum() + (len(times) - known) * np.log(root[known])
        return float(log_determinant / 2 + fitted)

    memories = np.linspace(*bounds[0], 8)[1:-1]
    best = min(((x, y) for x in memories for y in (-6.0, -2.0, 0.0, 2.0)), key=unlikely)
    options = {"maxfev": 80, "xatol": 0.02, "fatol": 0.005}
    return noise(minimize(unlikely, best, method="Nelder-Mead", bounds=bounds, options=options).x)


class _SineFit:
    """Series relative to the columns of a base model, weighted by the covariance of the noise.

    `scatter` is the weighted sum of the squares about the base model; 0 if it is only rounding.
    """

    def __init__(self, times: np.ndarray, values: np.ndarray, base: np.ndarray, noise: Wander):
        self.times, (self._weigh, _) = times, noise.weigher(times)
        self._base = np.linalg.qr(base)[0]
        self._weighed_base = self._weigh(self._base)
        self._gram = self._base.T @ self._weighed_base
        rest = self._without_base(values[:, None])
        self._weighed_rest = self._weigh(rest)
        rounding = np.sum(rest**2) <= len(values) * (1e-9 * np.abs(values).max()) ** 2
        self.scatter = 0.0 if rounding else float((rest * self._weighed_rest).sum())

    def _without_base(self, columns: np.ndarray) -> np.ndarray:
        return columns - self._base @ np.linalg.solve(self._gram, self._weighed_base.T @ columns)

    def power(self, frequencies: np.ndarray) -> np.ndarray:
        """Fraction of the scatter about the base model that a sine of each frequency explains."""
        some = max(1, (1 << 18) // len(self.times))  # bounds the memory
        parts = [frequencies[k : k + some] for k in range(0, len(frequencies), some)]
        return np.concatenate([self._explained(part) for part in parts])

    def _explained(self, frequencies: np.ndarray) -> np.ndarray:
        if self.scatter == 0:
            return np.zeros(len(frequencies))
        angles = 2 * pi * np.outer(self.times, frequencies)
        cosine, sine = self._without_base(np.cos(angles)), self._without_base(np.sin(angles))
        weighed = self._weigh(cosine)
        cc, cs = (cosine * weighed).sum(axis=0), (sine * weighed).sum(axis=0)
        ss = (sine * self._weigh(sine)).sum(axis=0)
        cy, sy = ((one.T @ self._weighed_rest)[:, 0] for one in (cosine, sine))
        determinant = cc * ss - cs**2
        # A frequency cannot be determined where cosine and sine are equal at all times, or where
        # the base model contains nine tenths of both.
        known = determinant > 1e-9 * (cc + ss) ** 2
        known &= (cosine**2 + sine**2).sum(axis=0) > 0.1 * len(self.times)
        determinant = np.where(known, determinant, np.inf)
        a, b = (ss * cy - cs * sy) / determinant, (cc * sy - cs * cy) / determinant
        return np.clip((a * cy + b * sy) / self.scatter, 0, 1)

    def highest(self, frequencies: np.ndarray) -> float:
        """Frequency of highest power, refined between its neighbours."""
        top = int(self.power(frequencies).argmax())
        ends = frequencies[max(top - 1, 0)], frequencies[min(top + 1, len(frequencies) - 1)]
        found = minimize_scalar(
            lambda frequency: -self._explained(np.array([frequency]))[0],
            bounds=ends, method="bounded", options={"xatol": 1e-4 * (ends[1] - ends[0])},
        )  # fmt: skip
        return float(found.x)

    def false_alarm(self, frequency_hz: float, band_hz: float) -> float:
        """Bound the probability that noise has a peak as high as this one anywhere in a band.

        Baluev, MNRAS 385, 1279 (2008), for a power relative to the scatter about a base model.
        """
        explained = float(self._explained(np.array([frequency_hz]))[0])
        left, free = 1 - explained, len(self.times) - self._base.shape[1]
        single = left ** ((free - 2) / 2)
        width = band_hz * sqrt(4 * pi * float(np.mean(self.times**2)))
        gamma = sqrt(2 / free) * exp(lgamma(free / 2) - lgamma((free - 1) / 2))
        crossings = gamma * width * left ** ((free - 3) / 2) * sqrt(free * explained / 2)
        # Written so that tiny probabilities are not lost in rounding.
        return float(single - (1 - single) * np.expm1(-crossings))


def find_outliers(heights: ArrayLike, *, least: float = 0.0) -> np.ndarray:
    """Find heights far from those of their neighbours in time, as sparks give.

    A height is far if its distance from the median of seven neighbours exceeds six standard
    deviations (estimated from the median of all distances) and six typical steps between these
    neighbours: the first frame of a rising flame has only higher ones.

    Parameters
    ----------
    heights : array_like, shape (frames,)
        Heights; NaN where there is none.
    least : float, optional
        Smallest distance of an outlier, in the unit of the heights.

    Returns
    -------
    ndarray of bool, shape (frames,)
        Whether each height is an outlier; all False if more than 5 % would be.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.flame_video import find_outliers
    >>> heights = 20 + np.random.default_rng(1).normal(0, 0.1, 100)
    >>> heights[40] = 3.0
    >>> np.flatnonzero(find_outliers(heights)).tolist()
    [40]
    """
    heights = np.asarray(heights, np.float64)
    known = np.flatnonzero(np.isfinite(heights))
    found = np.zeros(len(heights), bool)
    if len(known) < 7:
        return found
    around = np.lib.stride_tricks.sliding_window_view(np.pad(heights[known], 3, "reflect"), 7)
    distances = np.abs(heights[known] - np.median(around, axis=1))
    steps = np.median(np.abs(np.diff(around, axis=1)), axis=1)
    usual = np.maximum(1.4826 * float(np.median(distances)), steps)
    far = distances > np.maximum(least, 6 * usual)
    if np.count_nonzero(far) <= 0.05 * len(known):
        found[known[far]] = True
    return found
