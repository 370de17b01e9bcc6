"""The slope at which a region of a light field is sharpest.

Bilinear shifts by a fraction of a lenslet soften an image, so a search over them is drawn to
whole slopes. This one works on exact spectra (`lf_flame.refocus.fourier`): the
sharpness is the gradient energy of the refocused region (by Parseval a sum over its spectrum),
below a frequency at which the views are still free of aliasing.
"""

from dataclasses import dataclass

import numpy as np

from lf_flame.errors import InputError
from lf_flame.refocus._arguments import as_slopes, as_views
from lf_flame.refocus.fourier import refocused_spectrum

PASS_BAND = 0.15
"""Width of the Gaussian low-pass in cycles per lenslet; at Nyquist it leaves 1.5e-5."""

DEFAULT_SLOPES = (-3.0, 3.0, 0.05)
"""First and last slope and step of the search; the paper's slopes are multiples of 0.05."""


@dataclass(frozen=True, eq=False)
class SlopeSearch:
    """Result of `find_sharpest_slope`.

    Attributes
    ----------
    slope : float
        Slope of the highest sharpness, between the samples by a parabola.
    slopes, sharpness : ndarray of float64, shape (n,)
        The curve; gradient energy per lenslet of the region.
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
        ``(t_start, t_stop, s_start, s_stop)`` in lenslets. It should hold one object with a
        margin of the views' shifts. Default: the whole image.

    Returns
    -------
    SlopeSearch

    Raises
    ------
    InputError
        If the arguments cannot be used, or the curve has no peak inside the range: it is flat,
        or still rises at an end.
    """
    views = as_views(views)
    slopes = _default_slopes() if slopes is None else as_slopes(slopes)
    steps = np.diff(slopes)
    if len(slopes) < 3 or steps[0] <= 0 or not np.allclose(steps, steps[0]):
        raise InputError(f"slopes to search must be three or more in equal steps, got {slopes}.")
    patch = _cut(views, region)
    if patch.ndim == 5:
        patch = patch.mean(axis=4)
    sharpness = _sharpness(patch, slopes)
    return SlopeSearch(_peak(slopes, sharpness), slopes, sharpness)


def _default_slopes() -> np.ndarray:
    first, last, step = DEFAULT_SLOPES
    return np.linspace(first, last, round((last - first) / step) + 1)


def _cut(views: np.ndarray, region) -> np.ndarray:
    if region is None:
        return views
    t0, t1, s0, s1 = region
    if not (0 <= t0 < t1 <= views.shape[2] and 0 <= s0 < s1 <= views.shape[3]):
        raise InputError(
            f"region must be (t_start, t_stop, s_start, s_stop) inside the {views.shape[2]} x "
            f"{views.shape[3]} lenslets, got {tuple(region)}."
        )
    return views[:, :, t0:t1, s0:s1]


def _sharpness(patch: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    height, width = patch.shape[2:]
    # Light of neighbouring objects at the border must not wrap round as an edge.
    taper = np.outer(_taper(height), _taper(width))
    spectra = np.fft.rfft2(patch * taper)
    k2 = np.fft.fftfreq(height)[:, None] ** 2 + np.fft.rfftfreq(width)[None, :] ** 2
    weight = k2 * np.exp(-k2 / PASS_BAND**2)
    weight[:, 1 : (width + 1) // 2] *= 2  # rfft2 leaves out the mirrored half
    energy = [np.sum(weight * np.abs(refocused_spectrum(spectra, s, width)) ** 2) for s in slopes]
    return np.array(energy) * (2 * np.pi / (height * width)) ** 2


def _taper(n: int) -> np.ndarray:
    """Window that is 1 in the middle and falls to 0 as a cosine over the outer tenths."""
    edge = np.minimum(np.arange(n) + 0.5, n - 0.5 - np.arange(n)) / max(0.1 * n, 0.5)
    return 0.5 - 0.5 * np.cos(np.pi * np.minimum(edge, 1))


def _peak(slopes: np.ndarray, sharpness: np.ndarray) -> float:
    k = int(sharpness.argmax())
    if np.ptp(sharpness) <= 1e-9 * sharpness.max():
        raise InputError("No slope is sharpest: the sharpness is the same at all of them.")
    if k in (0, len(slopes) - 1):
        raise InputError(
            f"The sharpness still rises at the end of the slopes searched, "
            f"{slopes[0]:g} to {slopes[-1]:g}; search a wider range."
        )
    before, top, after = sharpness[k - 1 : k + 2]
    return float(slopes[k]) + float(slopes[k] - slopes[k - 1]) * (before - after) / (
        2 * (before - 2 * top + after)
    )
