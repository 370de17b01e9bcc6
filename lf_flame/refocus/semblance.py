"""Semblance: how well the gradients of the views agree when refocused on a region.

    semblance = sum |sum_a h_a g_a|^2 / sum (sum_a h_a) (sum_a h_a |g_a|^2)

over the lenslets of the region. g_a is the gradient that view a shows there at a slope; h_a is the
view's taper, which falls to 0 at its edges, times its weight. By the Cauchy-Schwarz inequality the
semblance is 1 where the views agree and less elsewhere, whatever the region contains (Neidell and
Taner, Geophysics 36, 482, 1971, for seismic traces). This excludes three sources of bias. Bilinear
shifts soften an image unless they are whole; here all shifts are exact, by the spectrum. Above the
frequencies that the views resolve there is aliasing; the gradients are therefore low-passed. As the
slope changes, light enters and leaves the region, and fewer views see lenslets near the edges of
the image; numerator and denominator share this.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy import fft

from lf_flame.refocus._arguments import refuse_not_finite
from lf_flame.refocus.semblance_sums import (
    REACH,
    SemblanceSums,
    ShiftAxis,
    separable_terms,
    slopes_in_memory,
)

PASS_BAND = 0.15
"""Width of the Gaussian low-pass in cycles per lenslet."""

LEAK = 1e-4
"""Smallest energy of a region relative to the mean; interpolation rings with a third of it."""

ROUNDING = 4 * 2.0**-24
"""Largest gradient that may be rounding, relative to the brightness: some half units of float32."""


def region_semblance(
    views: np.ndarray,
    slopes: np.ndarray,
    regions: list,
    counts: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Measure the semblance of each region at each slope.

    Parameters
    ----------
    views : ndarray, shape (v, u, t, s) or (v, u, t, s, channels)
        Views; colours are averaged to grey.
    slopes : ndarray of float64
        Slopes in lenslets per view step.
    regions : list of (t_start, t_stop, s_start, s_stop)
        Regions in lenslets, inside the image. They cost least if many share rows or columns.
    counts : ndarray of float64, shape (v, u)
        Weight of each view, 1 in the mean. Views of weight 0 are not transformed.

    Returns
    -------
    semblance : ndarray of float64, shape (slopes, regions)
        Semblance from 0 to 1; 0 where the region has no significant energy.
    energy : ndarray of float64, shape (slopes, regions)
        Mean squared gradient of the views over the region, per lenslet squared.
    rounding : float
        Largest root-mean-square gradient that may be rounding.

    Raises
    ------
    InputError
        If pixels of the views near the regions are not finite.
    """
    patch = _Patch.of(views, slopes, regions)
    farthest = np.abs(slopes).max()
    terms = separable_terms(counts)
    axes, interval_of_region = [], []
    for k in (0, 1):
        bounds = np.array([region[2 * k : 2 * k + 2] for region in regions])
        intervals, which = np.unique(bounds - patch.corner[k], axis=0, return_inverse=True)
        axes.append(ShiftAxis.of(patch.size[k], intervals, farthest, terms[k]))
        interval_of_region.append(which)
    down, across = interval_of_region
    some = slopes_in_memory(*axes)
    passes = [
        SemblanceSums(slopes[k : k + some], axes[0], axes[1], counts)
        for k in range(0, len(slopes), some)
    ]
    for sums, v in product(passes, range(len(views))):
        used = zip(counts[v], enumerate(patch.row(v)), strict=True)
        sums.add(v, ((u, gradient_of(view)) for count, (u, view) in used if count))
    refocused, alike, seen = (
        np.concatenate(found)[:, down, across]
        for found in zip(*(sums.found for sums in passes), strict=True)
    )
    energy = alike / seen
    bright = energy > LEAK * passes[0].mean_energy
    agreement = np.divide(refocused, alike, out=np.zeros_like(refocused), where=bright)
    rounding = math.ldexp(patch.rounding, patch.exponent)
    return agreement, np.ldexp(energy, 2 * patch.exponent), rounding


@dataclass(frozen=True, eq=False)
class _Patch:
    """Part of the views that regions use at some slopes: grey, minus its mean, of size about 1.

    Attributes
    ----------
    views : ndarray, shape (v, u, t, s) or (v, u, t, s, channels)
        The part used, as given; views are made grey one at a time.
    corner : (int, int)
        First row and column of the part.
    exponent : int
        Power of two by which pixels are divided, so that float32 sums do not overflow; a power of
        two changes no digits.
    mean, rounding : float
        Mean of the divided pixels, and the largest gradient that may be rounding.
    """

    views: np.ndarray
    corner: tuple[int, int]
    exponent: int
    mean: float
    rounding: float

    @classmethod
    def of(cls, views: np.ndarray, slopes: np.ndarray, regions: list) -> "_Patch":
        """Cut out the part that the regions use, and measure it."""
        cuts = []
        for k in (0, 1):
            reach = int(np.abs(slopes).max() * (views.shape[k] - 1) / 2) + REACH
            low = min(region[2 * k] for region in regions) - reach
            high = max(region[2 * k + 1] for region in regions) + reach
            cuts.append(slice(max(low, 0), min(high, views.shape[k + 2])))
        seen = views[:, :, cuts[0], cuts[1]]
        brightest = max(np.abs(view).max() for view in grey_views(seen))
        if not np.isfinite(brightest):
            refuse_not_finite(views)
        exponent = int(np.frexp(brightest)[1])
        pixels = math.prod(seen.shape[:4])
        scaled = (np.ldexp(view, -exponent, out=view) for view in grey_views(seen))
        total, square = np.sum([(x.sum(), np.square(x).sum()) for x in scaled], axis=0)
        rounding = ROUNDING * math.sqrt(square / pixels)
        return cls(seen, (cuts[0].start, cuts[1].start), exponent, total / pixels, rounding)

    @property
    def size(self) -> tuple[int, int]:
        """Number of lenslets, (t, s)."""
        return self.views.shape[2], self.views.shape[3]

    def row(self, v: int) -> Iterator[np.ndarray]:
        """Give the views of row v one after the other, [t, s] in float32."""
        for view in grey_views(self.views[v : v + 1]):
            np.ldexp(view, -self.exponent, out=view)
            view -= self.mean
            yield view.astype(np.float32)


def grey_views(views: np.ndarray) -> Iterator[np.ndarray]:
    """Give the views one after the other in grey, [t, s] in float64."""
    for view in (view for row in views for view in row):
        with np.errstate(invalid="ignore"):  # for infinities of both signs
            yield view.astype(np.float64) if view.ndim == 2 else view.mean(axis=2, dtype=np.float64)


def gradient_of(view: np.ndarray) -> np.ndarray:
    """Gradient ``d/dt + i d/ds`` of a low-passed view [t, s], with edges repeated: complex64."""
    padded = [fft.next_fast_len(n + 2 * REACH, real=True) for n in view.shape]
    pads = [(REACH, m - n - REACH) for n, m in zip(view.shape, padded, strict=True)]
    spectrum = fft.rfft2(np.pad(view, pads, mode="edge"))
    down, right = fft.fftfreq(padded[0])[:, None], fft.rfftfreq(padded[1])[None, :]
    low_pass = 2j * np.pi * np.exp(-(down**2 + right**2) / (2 * PASS_BAND**2))
    inside = tuple(slice(REACH, REACH + n) for n in view.shape)
    out = np.empty(view.shape, np.complex64)
    for part, frequencies in ((out.real, down), (out.imag, right)):
        derivative = (low_pass * frequencies).astype(np.complex64)
        part[...] = fft.irfft2(spectrum * derivative, padded)[inside]
    return out
