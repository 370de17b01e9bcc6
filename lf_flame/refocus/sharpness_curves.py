"""Sharpness of regions of a light field as curves over the slope, and the peaks of these."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy  # its parts load when they are used
from numpy.typing import ArrayLike
from scipy.interpolate import make_interp_spline
from scipy.optimize import minimize_scalar

from lf_flame.errors import InputError
from lf_flame.refocus._arguments import (
    Region,
    Views,
    as_region,
    as_slopes,
    as_views,
    farthest_slope,
    view_places,
)
from lf_flame.refocus.placed_semblance import placed_semblance
from lf_flame.refocus.semblance import region_semblance

DEFAULT_RANGES = (3.0, 12.0)
"""Largest slope searched by default, in both directions: at first, and if the peak is outside."""

WIDEST_STEP, STEP_BY_VIEWS = 0.1, 0.7
"""Largest step of a search, and largest step times (views - 1): 0.05 for 15 views.

Over such a step, the phase of two views that far apart changes by half a cycle or less at all
frequencies that pass the low-pass.
"""

RIPPLE = 0.02
"""Prominence of a rival peak, relative to the highest peak."""

CLEAR = 3.0
"""Smallest height of a peak that is no ripple, relative to the value for unrelated views."""

MOST_NOISE = 0.5
"""Largest fraction of the energy that is subtracted as noise, so that enough remains as divisor."""


@dataclass(frozen=True, eq=False)
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
        Confidence in [0, 1]: ``1 - rival / peak``. The rival is the highest of three: the curve's
        other peaks, its lowest point, and 1/n, the value for n unrelated views. It is near 1 for
        one layer; near 0 for two layers of equal strength, for noise, and if there is too little
        parallax to distinguish slopes. `find_sharpest_slope` also compares 4 x 4 parts of the
        region: the confidence falls to 0 where they lose a tenth of their sharpness at one slope,
        as if the region holds layers whose peaks have merged, or a steep surface.
    region : (int, int, int, int)
        Region ``(t_start, t_stop, s_start, s_stop)`` in lenslets; stops are excluded.
    """

    slope: float
    slopes: np.ndarray
    sharpness: np.ndarray
    confidence: float
    region: Region

    def __repr__(self) -> str:
        return f"SlopeSearch(slope {self.slope:+.3f}, confidence {self.confidence:.2f})"


@dataclass(frozen=True, eq=False)
class Curves:
    """Semblance of regions at rising slopes, and quantities that follow from it."""

    regions: list[Region]
    views: float  # number of views of equal weight with the same value when unrelated
    slopes: np.ndarray
    semblance: np.ndarray
    energy: np.ndarray
    rounding: float
    asked: int  # number of regions that are searched; further ones are parts of the first
    stride: int = 1  # every stride-th slope was requested

    @cached_property
    def top(self) -> np.ndarray:
        """Index of each curve's highest sample."""
        return self.semblance.argmax(axis=0)

    @cached_property
    def sharpness(self) -> np.ndarray:
        """Mean squared gradient of each region, with the energy at its highest sample."""
        return self.semblance * np.take_along_axis(self.energy, self.top[None], axis=0)

    @cached_property
    def flat(self) -> np.ndarray:
        """Whether each curve may be rounding alone.

        The mean square of ``gradient + error`` is wrong by up to ``2 gradient error + error^2``; a
        curve that varies by no more than that has no peak.
        """
        error = self.rounding * (2 * np.sqrt(self.sharpness.max(axis=0)) + self.rounding)
        return np.ptp(self.sharpness, axis=0) <= error

    @cached_property
    def rising(self) -> np.ndarray:
        """Whether each curve is highest at an end."""
        return ~self.flat & ((self.top == 0) | (self.top == len(self.slopes) - 1))

    @property
    def settled(self) -> bool:
        """Whether no curve rises at an end, and half of those that are not flat have a peak."""
        some = slice(0, self.asked)
        high = self.semblance.max(axis=0)[some][~self.flat[some]] > min(CLEAR / self.views, 0.5)
        return not self.rising[some].any() and 2 * int(np.count_nonzero(high)) >= len(high)

    @property
    def loss(self) -> float:
        """Part of the sharpness of the first region's parts that they lose at its slope."""
        parts, at = slice(self.asked, None), self.top[0]
        energy = self.energy[at, parts]
        own = float((self.semblance[:, parts].max(axis=0) * energy).sum())
        return 1 - float((self.semblance[at, parts] * energy).sum()) / own if own > 0 else 0.0

    def amid(self, outer: Curves) -> Curves:
        """Join these curves with those at slopes on both sides."""
        middle = len(outer.slopes) // 2
        joined = {
            name: np.insert(getattr(outer, name), middle, getattr(self, name), axis=0)
            for name in ("slopes", "semblance", "energy")
        }
        return replace(self, **joined)

    def search(self, k: int) -> SlopeSearch:
        """Find the peak of one region's curve."""
        slope, confidence = np.nan, 0.0
        if not (self.flat[k] or self.rising[k]):
            slope = _peak(self.slopes, self.semblance[:, k], self.energy[:, k], self.views)
            confidence = _confidence(self.semblance[:, k], 1 / self.views)
        slopes, sharpness = self.slopes[:: self.stride], self.sharpness[:: self.stride, k]
        return SlopeSearch(slope, slopes, sharpness, confidence, self.regions[k])


def measure_curves(
    light_field: Views, slopes: ArrayLike | None, regions: list[Region], weights: np.ndarray,
    asked: int | None = None,
) -> Curves:  # fmt: skip
    """Measure the regions at the slopes, and between them if the number of views requires it."""
    views, places = as_views(light_field, placed=True), view_places(light_field)
    regions = [as_region(region, views.shape[2:4]) for region in regions]
    widest = max(float(np.ptp(one)) for one in places)
    step = min(WIDEST_STEP, STEP_BY_VIEWS / max(widest, 1))
    limit = farthest_slope(light_field)
    counts = weights / weights.mean()
    effective = counts.size**2 / float(np.square(counts).sum())
    placed = getattr(light_field, "positions", None) is not None

    def curves(slopes, stride=1):
        if placed:
            measured = placed_semblance(views, places, slopes, regions, counts)
        else:
            measured = region_semblance(views, slopes, regions, counts)
        return Curves(regions, effective, slopes, *measured, asked or len(regions), stride)

    if slopes is not None:
        return curves(*_between(as_slopes(slopes), step, limit))
    end, last = (int(min(np.ceil(m / step - 1e-6), limit // step)) for m in DEFAULT_RANGES)
    found = curves(step * np.arange(-end, end + 1))
    while not found.settled and end < last:
        start, end = end + 1, min(2 * end, last)
        found = found.amid(curves(step * np.r_[-end : 1 - start, start : end + 1]))
    return found


def _between(slopes: np.ndarray, step: float, limit: float) -> tuple[np.ndarray, int]:
    """Add slopes so that steps are at most `step`; every stride-th of them was requested."""
    if np.abs(slopes).max() > limit:
        raise InputError(
            f"slopes to search must lie within -{limit:g} to {limit:g}, beyond which views are "
            f"shifted by more than the image, got {slopes.min():g} to {slopes.max():g}."
        )
    steps = np.diff(slopes)
    if len(slopes) < 3 or steps[0] <= 0 or not np.allclose(steps, steps[0], atol=0):
        raise InputError(f"slopes to search must be three or more in equal steps, got {slopes}.")
    stride = int(np.ceil(steps[0] / step - 1e-6))
    filled = np.linspace(slopes[0], slopes[-1], (len(slopes) - 1) * stride + 1)
    filled[::stride] = slopes
    return filled, stride


def _peak(slopes: np.ndarray, semblance: np.ndarray, energy: np.ndarray, views: float) -> float:
    """Slope of the peak, interpolated with a spline.

    The part that the views do not share at the peak is taken as noise of equal strength everywhere,
    and subtracted. Where fewer views see the edges it counts less, and would shift a flat peak.
    """
    k = int(semblance.argmax())
    near = slice(max(k - 5, 0), k + 6)
    energy = np.maximum(energy[near] / energy[k], 1e-6)
    noise = min((1 - semblance[k]) / (1 - 1 / views), MOST_NOISE * energy.min())
    curve = (semblance[near] * energy - noise / views) / (energy - noise)
    spline = make_interp_spline(slopes[near], curve, k=min(5, len(curve) - 1))
    bounds = slopes[max(k - 2, 0)], slopes[min(k + 2, len(slopes) - 1)]
    options = {"xatol": 1e-6 * (bounds[1] - bounds[0])}
    best = minimize_scalar(lambda s: -spline(s), bounds=bounds, method="bounded", options=options)
    return float(best.x)


def _confidence(curve: np.ndarray, unrelated: float) -> float:
    """Height of the peak above its rival; an end that the curve rises to is a peak too."""
    top = curve.max()
    peaks, _ = scipy.signal.find_peaks(np.pad(curve, 1), prominence=RIPPLE * top)
    rivals = np.sort(curve[peaks - 1])[:-1]
    return float(max(1 - max(rivals.max(initial=unrelated), curve.min()) / top, 0))
