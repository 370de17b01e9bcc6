"""Semblance of views at positions of their own, as of an array of cameras on no grid.

It is that of `lf_flame.refocus.semblance`. Without a grid the sums over views do not separate by
rows and columns: at each slope every view's spectrum is multiplied by its own phases.
"""

import math

import numpy as np
from scipy import fft
from scipy.ndimage import gaussian_filter1d

from lf_flame.refocus._arguments import refuse_not_finite
from lf_flame.refocus.semblance import LEAK, ROUNDING, gradient_of, grey_views
from lf_flame.refocus.semblance_sums import SOFTNESS, taper_of

Places = tuple[np.ndarray, np.ndarray]
"""Places of views down, shape (v,), and to the right, shape (v, 1), in view steps."""


def placed_semblance(
    views: np.ndarray, places: Places, slopes: np.ndarray, regions: list, counts: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Measure the semblance of each region at each slope.

    Parameters
    ----------
    views : ndarray, shape (v, 1, t, s) or (v, 1, t, s, channels)
    places : (ndarray, ndarray)
        Places of the views.
    slopes : ndarray of float64
        Slopes in lenslets per view step.
    regions : list of (t_start, t_stop, s_start, s_stop)
    counts : ndarray of float64, shape (v, 1)
        Weight of each view, 1 in the mean.

    Returns
    -------
    semblance, energy, rounding
        As of `lf_flame.refocus.semblance.region_semblance`.

    Raises
    ------
    InputError
        If a pixel is not finite.
    """
    used = np.flatnonzero(counts[:, 0])
    counted, at = counts[used, 0], (places[0][used], places[1][used, 0])
    grey = list(grey_views(views[used]))
    brightest = max(float(np.abs(view).max()) for view in grey)
    if not math.isfinite(brightest):
        refuse_not_finite(views)
    exponent = int(np.frexp(brightest)[1])
    grey = [np.ldexp(view, -exponent) for view in grey]
    mean, square = (float(np.mean([np.mean(f(x)) for x in grey])) for f in (np.array, np.square))
    size = views.shape[2:4]
    far = [np.abs(slopes).max() * np.abs(one).max() for one in at]
    periods = [fft.next_fast_len(int(np.ceil(n + m))) for n, m in zip(size, far, strict=True)]
    tapers = [taper_of(n) for n in size]
    light, power, total = [], [], 0.0
    for count, view in zip(counted, grey, strict=True):
        gradient = gradient_of((view - mean).astype(np.float32))
        energy = count * np.abs(gradient) ** 2
        total += float(energy.mean(dtype=np.float64)) / len(counts)
        light.append(fft.fft2(count * np.outer(*tapers) * gradient, periods))
        power.append(fft.fft2(np.outer(*tapers) * energy, periods))
    down, across = (_covered(regions, axis, n) for axis, n in enumerate(size))
    found = np.empty((3, len(slopes), len(regions)))
    for n, slope in enumerate(slopes):
        phases = [
            np.exp(2j * np.pi * slope * np.outer(one, fft.fftfreq(period)))
            for one, period in zip(at, periods, strict=True)
        ]
        image, energy = (
            _summed(spectra, *phases)[: size[0], : size[1]] for spectra in (light, power)
        )
        seen = _seen(tapers, at, counted, slope)
        for k, part in enumerate((np.abs(image) ** 2, energy.real * seen, seen**2)):
            found[k, n] = np.einsum("rt,ts,rs->r", down, part, across)
    refocused, alike, seen = found
    energy = alike / seen
    bright = energy > LEAK * total
    agreement = np.divide(refocused, alike, out=np.zeros_like(refocused), where=bright)
    rounding = math.ldexp(ROUNDING * math.sqrt(square), exponent)
    return agreement, np.ldexp(energy, 2 * exponent), rounding


def _summed(spectra: list[np.ndarray], down: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Sum of views with these spectra, each shifted by its phases."""
    total = np.zeros(spectra[0].shape, complex)
    for spectrum, one, other in zip(spectra, down, across, strict=True):
        total += spectrum * one[:, None] * other
    return fft.ifft2(total)


def _seen(tapers: list, at: tuple[np.ndarray, ...], counts: np.ndarray, slope: float) -> np.ndarray:
    """Sum of the shifted tapers, with the weights of their views."""
    shifted = [
        np.array(
            [np.interp(np.arange(len(h)) + slope * d, np.arange(len(h)), h, 0, 0) for d in one]
        )
        for h, one in zip(tapers, at, strict=True)
    ]
    return np.einsum("v,vt,vs->ts", counts, *shifted)


def _covered(regions: list, axis: int, length: int) -> np.ndarray:
    """Coverage of each lenslet along an axis by each region, with soft edges."""
    bounds = np.array([region[2 * axis : 2 * axis + 2] for region in regions])
    lenslets = np.arange(length)
    covered = (bounds[:, :1] <= lenslets) & (lenslets < bounds[:, 1:])
    return gaussian_filter1d(covered.astype(float), SOFTNESS, mode="constant")
