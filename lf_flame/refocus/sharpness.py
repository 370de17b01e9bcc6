"""The slope at which a region of a light field is sharpest.

Bilinear shifts by a fraction of a lenslet soften an image, so a search over them is drawn to
whole slopes. This one works on exact spectra (`lf_flame.refocus.fourier`): the
sharpness is the gradient energy of the refocused region, below a frequency at which the views are
still free of aliasing.
"""

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft2, next_fast_len, rfft2

from lf_flame.errors import InputError
from lf_flame.refocus._arguments import as_slopes, as_views
from lf_flame.refocus.fourier import refocused_spectra

PASS_BAND = 0.15
"""Width of the Gaussian low-pass in cycles per lenslet."""

FILTER_REACH = 8
"""Lenslets around a region that the low-pass can still bring into it."""

DEFAULT_SLOPES = (-3.0, 3.0, 0.05)
"""First and last slope and step of the search; the paper's slopes are multiples of 0.05."""

ROUNDING = 4 * 2.0**-24
"""Part of the brightness below which a gradient may be rounding: a few half units of float32."""


@dataclass(frozen=True, eq=False)
class SlopeSearch:
    """Result of `find_sharpest_slope`.

    Attributes
    ----------
    slope : float
        Slope of the highest sharpness, between the samples by a parabola.
    slopes, sharpness : ndarray of float64, shape (n,)
        The curve: mean squared gradient over the region, per lenslet squared.
    """

    slope: float
    slopes: np.ndarray
    sharpness: np.ndarray


def find_sharpest_slope(views, slopes=None, region=None) -> SlopeSearch:
    """Search the slope that makes a region sharpest.

    Parameters
    ----------
    views : LightField or array_like, shape (v, u, t, s) or (v, u, t, s, channels)
    slopes : sequence of float, optional
        At least three, rising in equal steps. Default: -3 to 3 in steps of 0.05.
    region : (int, int, int, int), optional
        ``(t_start, t_stop, s_start, s_stop)`` in lenslets; it should hold one object, whole.
        Default: the whole image.

    Returns
    -------
    SlopeSearch

    Raises
    ------
    InputError
        If the arguments cannot be used, or the curve has no peak inside the range: it is flat
        to the rounding of float32 pixels, or still rises at an end.
    """
    views = as_views(views)
    slopes = _default_slopes() if slopes is None else as_slopes(slopes)
    steps = np.diff(slopes)
    if len(slopes) < 3 or steps[0] <= 0 or not np.allclose(steps, steps[0], atol=0):
        raise InputError(f"slopes to search must be three or more in equal steps, got {slopes}.")
    grey = views if views.ndim == 4 else views.mean(axis=4, dtype=np.float64).astype(np.float32)
    patch, inside = _cut(grey, slopes, region)
    # To about 1, by a power of two, so that no sum of float32 overflows and no digit changes.
    exponent = int(np.frexp(np.abs(patch).max())[1])
    np.ldexp(patch, -exponent, out=patch)
    sharpness = _sharpness(patch, slopes)[:, inside[0], inside[1]].mean(axis=(1, 2))
    rounding = ROUNDING * np.linalg.norm(patch) / np.sqrt(patch.size)
    slope = _peak(slopes, sharpness, rounding)
    return SlopeSearch(slope, slopes, np.ldexp(sharpness, 2 * exponent))


def _default_slopes() -> np.ndarray:
    first, last, step = DEFAULT_SLOPES
    return np.linspace(first, last, round((last - first) / step) + 1)


def _cut(views: np.ndarray, slopes: np.ndarray, region):
    """Cut out a region and the surroundings that shifts bring into it.

    Returns the patch, as periodic shifts need it, and the slices of the region in it. Beyond the
    image its edge is repeated.
    """
    size = views.shape[2:]
    t0, t1, s0, s1 = (0, size[0], 0, size[1]) if region is None else region
    if not (0 <= t0 < t1 <= size[0] and 0 <= s0 < s1 <= size[1]):
        raise InputError(
            f"region must be (t_start, t_stop, s_start, s_stop) inside the {size[0]} x {size[1]} "
            f"lenslets, got {tuple(region)}."
        )
    cuts, pads, inside = [], [], []
    for axis, (start, stop) in enumerate(((t0, t1), (s0, s1))):
        reach = int(np.abs(slopes).max() * (views.shape[axis] - 1) / 2) + FILTER_REACH
        low, high = start - reach, stop + reach
        cuts.append(slice(max(low, 0), min(high, size[axis])))
        length = next_fast_len(high - low, real=True)
        pads.append((max(-low, 0), length - (cuts[-1].stop - cuts[-1].start) - max(-low, 0)))
        inside.append(slice(reach, reach + stop - start))
    patch = np.pad(views[:, :, cuts[0], cuts[1]], [(0, 0), (0, 0), *pads], mode="edge")
    return patch, inside


def _sharpness(patch: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Squared gradient of the low-passed, refocused patch: shape (slopes, t, s)."""
    height, width = patch.shape[2:]
    spectra = refocused_spectra(rfft2(patch), slopes, width)
    down, right = np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None, :]
    low_pass = 2j * np.pi * np.exp(-(down**2 + right**2) / (2 * PASS_BAND**2))
    gradients = (irfft2(spectra * low_pass * k, (height, width)) for k in (down, right))
    return sum(gradient**2 for gradient in gradients)


def _peak(slopes: np.ndarray, sharpness: np.ndarray, rounding: float) -> float:
    """Slope of the peak; `rounding` is the part of a root-mean-square gradient that may be error.

    The mean square of ``gradient + error`` is off by up to ``2 gradient error + error^2``: a curve
    that varies by no more than that has no peak.
    """
    k = int(sharpness.argmax())
    if np.ptp(sharpness) <= rounding * (2 * np.sqrt(sharpness[k]) + rounding):
        raise InputError(
            "No slope is sharpest: the sharpness is the same at all of them, "
            "to the rounding of float32 pixels."
        )
    if k in (0, len(slopes) - 1):
        raise InputError(
            f"The sharpness still rises at the end of the slopes searched, "
            f"{slopes[0]:g} to {slopes[-1]:g}; search a wider range."
        )
    before, top, after = sharpness[k - 1 : k + 2]
    offset = (before - after) / (2 * (before - 2 * top + after))  # in steps, of the parabola
    return float(slopes[k] + (slopes[1] - slopes[0]) * offset)
