"""Flicker of a flame: the frequency of a series of heights, and whether there is one.

At each frequency a sine is fitted together with a drift, a cubic in time, by least squares: the
generalised Lomb-Scargle periodogram (Zechmeister and Kuerster 2009) with more than a mean. So times
may be uneven and frames missing, a drift is not taken for a slow flicker, and taking it out does
not take out part of a sine of few periods. Whether a peak is more than the highest of noise is told
by the bound of Baluev (2008) on the false-alarm probability. It takes the noise of frames for
independent; of heights that wander at random more is claimed than is true.
"""

from dataclasses import dataclass
from math import exp, lgamma, pi, sqrt

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize_scalar

from lf_flame.errors import InputError

LEAST_FRAMES = 16
"""Heights that a frequency is sought in: drift and sine alone take up seven numbers."""

DRIFT = 4
"""Numbers of the drift, a cubic."""

FIRST_PERIODS = 1.5
"""Within the duration, where the spectrum begins: a cubic looks like fewer."""

LEAST_PERIODS = 3
"""Within the duration: fewer are no rhythm. What a cubic leaves of a drift has its peak there."""

OVERSAMPLING = 5
"""Frequencies of the spectrum for each 1 / duration; fewer would miss the top of peaks."""

FALSE_ALARM = 0.01
"""Probability below which a peak is more than noise."""

CONSTANT = 1e-9
"""Scatter of heights relative to the largest which is that of rounding alone."""

AT_ONCE = 1 << 18
"""Heights times frequencies that are worked on together, so that memory is bounded."""


@dataclass(frozen=True, eq=False)
class Flicker:
    """Frequency of a series of heights, and how far to trust it.

    Attributes
    ----------
    frequency_hz : float
        Of the highest peak; NaN if it does not stand out of noise, or there is none.
    resolution_hz : float
        1 / duration: what lies closer is one peak, and none is known better for certain.
    false_alarm : float
        Probability that noise alone has such a peak somewhere in the spectrum.
    peak_hz : float
        Where the highest peak is, standing out or not; NaN if it is that of a drift, of fewer than
        three periods, or heights are constant.
    amplitude : float
        Of the sine at the peak, in the unit of the heights; NaN as `peak_hz`.
    frequencies_hz : ndarray of float64, shape (frequencies,)
        Of the spectrum: a period and a half in the duration at least, two frames a
        period.
    power : ndarray of float64, shape (frequencies,)
        Share of the heights' variance about their drift that a sine explains, 0 to 1.
    """

    frequency_hz: float
    resolution_hz: float
    false_alarm: float
    peak_hz: float
    amplitude: float
    frequencies_hz: np.ndarray
    power: np.ndarray

    def describe(self) -> str:
        """Tell in a sentence what was found."""
        alarm = f"false-alarm probability {self.false_alarm:.2g}"
        if np.isfinite(self.frequency_hz):
            return (
                f"The flame flickers at {self.frequency_hz:.4g} Hz, resolution "
                f"{self.resolution_hz:.2g} Hz, {alarm}."
            )
        if np.isfinite(self.peak_hz):
            return (
                f"No frequency stands out of the noise: the highest peak, at {self.peak_hz:.4g} "
                f"Hz, has a {alarm}."
            )
        return "There is no flicker: the heights are constant, or only drift."


def find_flicker(times_s: ArrayLike, heights: ArrayLike) -> Flicker:
    """Find the frequency of a series of heights.

    Parameters
    ----------
    times_s : array_like, shape (frames,)
        In s, rising; not evenly spaced by need.
    heights : array_like, shape (frames,)
        In any unit; frames of NaN are left out.

    Returns
    -------
    Flicker
        Frequencies up to half the number of frames a second, by the median distance in time; a
        faster flicker appears at a lower frequency.

    Raises
    ------
    InputError
        If times and heights do not match, times do not rise, or fewer than `LEAST_FRAMES` heights
        are known.
    """
    times, values = _checked_series(times_s, heights)
    resolution = 1 / (times[-1] - times[0])
    lowest = FIRST_PERIODS * resolution
    # Right at half the sampling rate, cosine and sine cannot be told apart.
    highest = 0.5 / np.median(np.diff(times)) - resolution / 2
    count = max(2, 1 + int(np.ceil((highest - lowest) / resolution * OVERSAMPLING)))
    frequencies = np.linspace(lowest, max(highest, lowest + resolution), count)
    series = _Series(times - times.mean(), values)
    power = series.power(frequencies)
    top = int(power.argmax())
    if power[top] == 0 or frequencies[top] < LEAST_PERIODS * resolution:
        return Flicker(np.nan, resolution, 1.0, np.nan, np.nan, frequencies, power)
    peak = _refined(series, frequencies, top)
    explained, amplitude = (float(one[0]) for one in series.fit(np.array([peak])))
    alarm = _false_alarm(explained, series.times, frequencies[-1] - frequencies[0])
    known = peak if alarm < FALSE_ALARM else np.nan
    return Flicker(known, resolution, alarm, peak, amplitude, frequencies, power)


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
    if not (np.all(np.isfinite(times)) and np.all(np.diff(times) > 0)):
        raise InputError("The times of frames must be finite and rise from frame to frame.")
    return times[known], values[known]


class _Series:
    """Heights over time, without their drift.

    Parameters
    ----------
    times : ndarray, shape (n,)
        About their mean.
    values : ndarray, shape (n,)
    """

    def __init__(self, times: np.ndarray, values: np.ndarray):
        self.times = times
        scaled = times / np.abs(times).max()
        self._drift = np.linalg.qr(np.polynomial.legendre.legvander(scaled, DRIFT - 1))[0]
        self._rest = self._without_drift(values)
        self._scatter = float(self._rest @ self._rest)
        if self._scatter <= len(values) * (CONSTANT * np.abs(values).max()) ** 2:
            self._scatter = 0.0

    def _without_drift(self, columns: np.ndarray) -> np.ndarray:
        return columns - self._drift @ (self._drift.T @ columns)

    def power(self, frequencies: np.ndarray) -> np.ndarray:
        """Share of the variance that a sine of each frequency explains."""
        some = max(1, AT_ONCE // len(self.times))
        parts = [
            self.fit(frequencies[first : first + some])[0]
            for first in range(0, len(frequencies), some)
        ]
        return np.concatenate(parts)

    def fit(self, frequencies: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Fit a sine of each frequency with a drift: explained share, and amplitude."""
        if self._scatter == 0:
            return np.zeros(len(frequencies)), np.zeros(len(frequencies))
        angles = 2 * pi * np.outer(self.times, frequencies)
        cosine, sine = self._without_drift(np.cos(angles)), self._without_drift(np.sin(angles))
        cc, ss, cs = ((a * b).sum(axis=0) for a, b in ((cosine,) * 2, (sine,) * 2, (cosine, sine)))
        cy, sy = cosine.T @ self._rest, sine.T @ self._rest
        determinant = cc * ss - cs**2
        # Where times make cosine and sine the same, a frequency cannot be told from another.
        told = determinant > 1e-9 * len(self.times) ** 2
        determinant = np.where(told, determinant, np.inf)
        a, b = (ss * cy - cs * sy) / determinant, (cc * sy - cs * cy) / determinant
        return np.clip((a * cy + b * sy) / self._scatter, 0, 1), np.hypot(a, b)


def _refined(series: _Series, frequencies: np.ndarray, top: int) -> float:
    """Find where the power is highest, between the neighbours of the spectrum's highest value."""
    ends = frequencies[top - 1], frequencies[min(top + 1, len(frequencies) - 1)]
    step = frequencies[1] - frequencies[0]
    found = minimize_scalar(
        lambda frequency: -series.fit(np.array([frequency]))[0][0],
        bounds=ends, method="bounded", options={"xatol": 1e-4 * step},
    )  # fmt: skip
    return float(found.x)


def _false_alarm(explained: float, times: np.ndarray, band_hz: float) -> float:
    """Bound the probability that noise has such a peak anywhere in a band.

    Baluev, MNRAS 385, 1279 (2008), for a power relative to the scatter about a base model.
    """
    left, free = 1 - explained, len(times) - DRIFT
    single = left ** ((free - 2) / 2)
    width = band_hz * sqrt(4 * pi * float(np.mean(times**2)))
    gamma = sqrt(2 / free) * exp(lgamma(free / 2) - lgamma((free - 1) / 2))
    crossings = gamma * width * left ** ((free - 3) / 2) * sqrt(free * explained / 2)
    # Written so that tiny probabilities do not vanish in rounding.
    return float(single - (1 - single) * np.expm1(-crossings))
