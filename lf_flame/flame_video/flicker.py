"""Flicker of a flame: frequencies in a series of heights, with their significance.

At each frequency a sine is fitted together with a drift, a cubic in time. Times may therefore be
uneven and frames missing, a drift is not taken for a slow flicker, and its removal does not remove
part of a sine of few periods. Heights of flames wander: the noise is white noise plus correlated
noise, estimated from the heights themselves (`fit_wander`), and frequencies are weighted
accordingly. The significance of a peak is the bound of Baluev (2008) on the false-alarm
probability. Each sine found joins the drift, the noise is fitted again, and the search continues:
neither a slow swing nor a strong line hides another one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lf_flame.errors import InputError
from lf_flame.flame_video.sine_fit import SineFit, sines
from lf_flame.flame_video.wander import Wander, fit_wander

LEAST_FRAMES = 16
"""Smallest number of heights for a frequency; drift and sine alone have seven parameters."""

DRIFT = 4
"""Number of parameters of the drift, a cubic."""

FIRST_PERIODS = 1.5
"""Number of periods in the duration at the lowest frequency; a cubic resembles fewer periods."""

LEAST_PERIODS = 3
"""Smallest number of periods in the duration of a rhythm; a drift that is no cubic peaks below."""

OVERSAMPLING = 5
"""Number of frequencies of the spectrum per 1 / duration; fewer would miss the tops of peaks."""

FALSE_ALARM = 0.01
"""Probability below which a peak is more than noise."""

SHORTEST_STEP_S, LONGEST_TIME_S = 1e-15, 1e12
"""Range of times of frames, in s: from the fastest cameras to more than any clock counts."""

NEGLIGIBLE = 5e-3
"""Residual scatter, relative to that of the heights, that is neglected: a drift that is no cubic,
or a slightly uneven rhythm, leaves as much."""

MOST_SINES = 8
"""Largest number of sines that are fitted, including slow swings."""

SAME_LINE = 2.0
"""Distance in 1 / duration within which a peak belongs to a known line: a flame's rhythm is
slightly uneven, so that its line is wider than that of a sine."""


NEAR = 0.25
"""Distance relative to the first line within which others may belong to the same uneven rhythm."""


@dataclass(frozen=True)
class Line:
    """A significant frequency.

    Attributes
    ----------
    frequency_hz : float
        Frequency in Hz.
    amplitude : float
        Amplitude of its sine, in the unit of the heights.
    false_alarm : float
        Probability that noise alone has such a peak somewhere in the spectrum.
    """

    frequency_hz: float
    amplitude: float
    false_alarm: float


@dataclass(frozen=True, eq=False)
class Flicker:
    """Frequencies of a series of heights, with their significance.

    Attributes
    ----------
    frequency_hz : float
        Frequency of the most significant peak; NaN if there is none.
    resolution_hz : float
        Resolution, 1 / duration: closer peaks merge, and no frequency is known better for certain.
    false_alarm : float
        Probability that noise alone has such a peak somewhere in the spectrum.
    peak_hz : float
        Frequency of the highest peak relative to the noise, significant or not; NaN if heights are
        constant or only drift.
    amplitude : float
        Amplitude of the sine at the peak, in the unit of the heights; NaN as `peak_hz`.
    frequencies_hz : ndarray of float64, shape (frequencies,)
        Frequencies of the spectrum: from one and a half periods in the duration to one period in
        two frames.
    power : ndarray of float64, shape (frequencies,)
        Fraction of the heights' variance about their drift that a sine explains, 0 to 1.
    lines : tuple of Line
        All significant frequencies; the first is `frequency_hz`.
    swings_hz : tuple of float
        Frequencies of slow swings, which are significant but have fewer than three periods: no
        rhythm.
    noise : Wander
        Noise with which the significance was computed.
    unresolved : tuple of Line
        Significant sines with an amplitude below `resolvable`: the measurement itself may make
        them.
    resolvable : float
        Smallest amplitude of a line, in the unit of the heights.
    """

    frequency_hz: float
    resolution_hz: float
    false_alarm: float
    peak_hz: float
    amplitude: float
    frequencies_hz: np.ndarray
    power: np.ndarray
    lines: tuple[Line, ...]
    swings_hz: tuple[float, ...]
    noise: Wander
    unresolved: tuple[Line, ...] = ()
    resolvable: float = 0.0

    def describe(self, *, unit: str = "") -> str:
        """Describe the result in some sentences.

        Parameters
        ----------
        unit : str, optional
            Unit of the heights, written after amplitudes.
        """
        alarm = f"false-alarm probability {self.false_alarm:.2g}"
        if self.lines:
            told = (
                f"The flame flickers at {self.frequency_hz:.4g} Hz, resolution "
                f"{self.resolution_hz:.2g} Hz, amplitude {_size(self.amplitude, unit)}, {alarm}."
            )
        elif np.isfinite(self.peak_hz):
            told = (
                f"No frequency is above the noise: the highest peak, at {self.peak_hz:.4g} "
                f"Hz, has a {alarm}."
            )
        elif self.unresolved:
            told = "No flicker is found."
        else:
            told = "There is no flicker: the heights are constant, or only drift."
        near, far = self._other_lines(unit)
        if near:
            told += f" Peaks near it ({near}) come from an uneven rhythm, or are separate lines."
        if far:
            told += f" Further lines: {far}."
        if self.swings_hz:
            slow = ", ".join(f"{swing:.3g} Hz" for swing in self.swings_hz)
            told += f" A slow swing ({slow}) has fewer than three periods and is no line."
        return told + self._too_small(unit)

    def _too_small(self, unit: str) -> str:
        """Describe the sines that the measurement itself may make."""
        if not self.unresolved:
            return ""
        swings = ", ".join(
            f"{_size(line.amplitude, unit)} at {line.frequency_hz:.4g} Hz"
            for line in self.unresolved
        )
        limit = _size(self.resolvable, unit)
        if len(self.unresolved) == 1:
            return (
                f" A swing of {swings} is smaller than the tip's row can be told ({limit}); a "
                f"flame that moves shows it, too."
            )
        return (
            f" Swings of {swings} are smaller than the tip's row can be told ({limit}); a flame "
            f"that moves shows them, too."
        )

    def _other_lines(self, unit: str) -> tuple[str, str]:
        """Name the lines near the first one, and the others."""
        near: list[str] = []
        far: list[str] = []
        for line in self.lines[1:]:
            is_near = abs(line.frequency_hz - self.frequency_hz) < NEAR * self.frequency_hz
            words = f"{line.frequency_hz:.4g} Hz with amplitude {_size(line.amplitude, unit)}"
            (near if is_near else far).append(words)
        return ", ".join(near), ", ".join(far)


def _size(amplitude: float, unit: str) -> str:
    return f"{amplitude:.2g} {unit}".rstrip()


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
    frequencies = _frequencies(times)
    search = _Search(times - times.mean(), values, frequencies, resolvable)
    power = SineFit(search.times, values, search.drift).power(frequencies)
    while search.goes_on():
        pass
    lines, (peak, alarm, amplitude) = search.lines(), search.highest
    if lines:
        peak, amplitude, alarm = lines[0].frequency_hz, lines[0].amplitude, lines[0].false_alarm
    return Flicker(
        lines[0].frequency_hz if lines else np.nan, search.resolution, alarm, peak, amplitude,
        frequencies, power, lines, tuple(search.swings), search.noise, tuple(search.unresolved),
        resolvable,
    )  # fmt: skip


def check_times(times_s: np.ndarray, source: str = "of frames") -> None:
    """Refuse times that cannot be those of frames.

    Parameters
    ----------
    times_s : ndarray of float64, shape (frames,)
    source : str, optional
        Words for these times in the message.

    Raises
    ------
    InputError
        If times do not rise by `SHORTEST_STEP_S` or more, or one is beyond `LONGEST_TIME_S`.
    """
    if not (
        np.all(np.abs(times_s) <= LONGEST_TIME_S) and np.all(np.diff(times_s) >= SHORTEST_STEP_S)
    ):
        raise InputError(
            f"The times {source} must rise from frame to frame, by {SHORTEST_STEP_S:g} s or more, "
            f"and be at most {LONGEST_TIME_S:g} s."
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
    resolution = 1 / (times[-1] - times[0])
    lowest = FIRST_PERIODS * resolution
    # At exactly half the sampling rate, cosine and sine cannot be separated.
    highest = 0.5 / np.median(np.diff(times)) - resolution / 2
    count = max(2, 1 + int(np.ceil((highest - lowest) / resolution * OVERSAMPLING)))
    return np.linspace(lowest, max(highest, lowest + resolution), count)


class _Search:
    """Search for one sine after the other; each sine found joins the drift."""

    def __init__(
        self, times: np.ndarray, values: np.ndarray, frequencies: np.ndarray, resolvable: float
    ):
        self.times, self.values, self.frequencies = times, values, frequencies
        self.resolvable = resolvable
        self.resolution = 1 / (times[-1] - times[0])
        scaled = times / np.abs(times).max()
        self.drift = np.polynomial.legendre.legvander(scaled, DRIFT - 1)
        self.noise = Wander(1.0, 1.0)
        self.highest = (np.nan, 1.0, np.nan)
        self.swings: list[float] = []
        self.unresolved: list[Line] = []
        self._found: list[float] = []
        self._alarms: dict[float, float] = {}
        self._slow = np.empty((len(times), 0))

    def goes_on(self) -> bool:
        """Look for one more sine; returns whether to continue."""
        base = self._columns(self._found)
        if base.shape[1] + 2 > len(self.times) / 2 or self._is_explained(base):
            return False
        self.noise = fit_wander(self.times, self.values, base)
        fit = SineFit(self.times, self.values, base, self.noise)
        power = fit.power(self.frequencies)
        is_slow = self.frequencies < LEAST_PERIODS * self.resolution
        if self._slow.size:  # they also resemble sines of slightly more periods
            power[self.frequencies < 2 * LEAST_PERIODS * self.resolution] = 0
        top = int(power.argmax())
        peak = fit.refined(self.frequencies, top)
        alarm = fit.false_alarm(peak, float(np.ptp(self.frequencies)))
        if alarm >= FALSE_ALARM:
            if not is_slow[top] and not self._alarms:
                self.highest = (peak, alarm, self._amplitudes([*self._found, peak])[-1])
            return False
        if is_slow[top] and self.swings:
            self._slow = self._slow_curves()
            return True
        if is_slow[top]:
            self.swings.append(peak)
        elif not self._is_known(peak):
            self._record(peak, alarm)
        self._found.append(peak)
        return len(self._found) < MOST_SINES

    def _is_known(self, peak: float) -> bool:
        """Whether a peak belongs to a line that was found before."""
        known = [*self._alarms, *(line.frequency_hz for line in self.unresolved)]
        return any(abs(peak - one) < SAME_LINE * self.resolution for one in known)

    def _record(self, peak: float, alarm: float) -> None:
        """Record a line, or a sine that is too small for one.

        The amplitude decides before sines near it are found, which share its amplitude.
        """
        amplitude = self._amplitudes([*self._found, peak])[-1]
        if amplitude < self.resolvable:
            self.unresolved.append(Line(peak, amplitude, alarm))
        else:
            self._alarms[peak] = alarm

    def _is_explained(self, base: np.ndarray) -> bool:
        """Whether the rest is no more than rounding, or negligible."""
        left = SineFit(self.times, self.values, base).scatter
        return left <= NEGLIGIBLE**2 * np.sum((self.values - self.values.mean()) ** 2)

    def _slow_curves(self) -> np.ndarray:
        """Cosines of up to `LEAST_PERIODS`, for a drift that is neither a cubic nor a swing."""
        half_periods = np.arange(1, 2 * LEAST_PERIODS + 1)
        return np.cos(np.pi * self.resolution * np.outer(self.times - self.times[0], half_periods))

    def lines(self) -> tuple[Line, ...]:
        """List the significant lines in the order in which they were found."""
        amplitudes = dict(zip(self._found, self._amplitudes(self._found), strict=True))
        return tuple(Line(one, amplitudes[one], alarm) for one, alarm in self._alarms.items())

    def _columns(self, frequencies: list[float]) -> np.ndarray:
        found = (sines(self.times, one) for one in frequencies)
        return np.column_stack([self.drift, self._slow, *found])

    def _amplitudes(self, frequencies: list[float]) -> list[float]:
        """Fit sines to the heights together."""
        fitted = np.linalg.lstsq(self._columns(frequencies), self.values, rcond=None)[0]
        pairs = fitted[len(fitted) - 2 * len(frequencies) :].reshape(-1, 2)
        return [float(np.hypot(*pair)) for pair in pairs]
