"""How much of the views' gradient energy is left when they are refocused on a region.

    semblance = sum |sum_a h_a g_a|^2 / sum (sum_a h_a) (sum_a h_a |g_a|^2)

over the lenslets of the region, with g_a the gradient that view a shows there at a slope, and h_a
its weight, which falls to 0 at the edges of the view. By the Cauchy-Schwarz inequality it is 1
where the views agree and less elsewhere, whatever the region holds (Neidell and Taner, Geophysics
36, 482, 1971; theirs is of seismic traces). Three things that would draw the slope of sharpest
focus away from the truth are so kept out: bilinear shifts soften an image unless they are whole,
here all are exact, by the spectrum; above the frequencies that the views resolve there is aliasing,
so the gradients are low-passed; and as the slope changes light enters and leaves the region, and
fewer views see the lenslets near the edges of the image, which numerator and denominator share.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy import fft
from scipy.ndimage import gaussian_filter1d

from lf_flame._common.arrays import centred
from lf_flame.refocus import _semblance_kernels
from lf_flame.refocus._arguments import refuse_not_finite

PASS_BAND = 0.15
"""Width of the Gaussian low-pass in cycles per lenslet."""

REACH = 8
"""Lenslets that the low-pass reaches, and over which a view's weight falls to 0 at its edges."""

SOFTNESS = 1.5
"""Standard deviation of a region's edges in lenslets."""

LEAK = 1e-4
"""Part of the mean energy that a region must hold: interpolation rings with a third of it."""

ROUNDING = 4 * 2.0**-24
"""Part of the brightness below which a gradient may be rounding: a few half units of float32."""

SLOPES_AT_ONCE = 8
"""Slopes that are refocused together: more would take more memory and hardly less time."""


def semblance(
    views: np.ndarray,
    slopes: np.ndarray,
    regions: list,
    progress: Callable[[Iterable, int, int], Iterable] | None = None,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Measure the semblance of each region at each slope.

    Parameters
    ----------
    views : ndarray, shape (v, u, t, s) or (v, u, t, s, channels)
        Of colours the mean is taken.
    slopes : ndarray of float64
    regions : list of (t_start, t_stop, s_start, s_stop)
        In lenslets, inside the image. They cost least where many share their rows or columns.
    progress : callable, optional
        ``progress(finished, done, total)`` wraps the iterable of batches of slopes.

    Returns
    -------
    semblance : ndarray of float64, shape (slopes, regions)
        0 where the region holds no energy to speak of.
    energy : ndarray of float64, shape (slopes, regions)
        Mean squared gradient of the views over the region, per lenslet squared.
    rounding : float
        Root-mean-square gradient that may be rounding.

    Raises
    ------
    InputError
        If what the regions can see of the views is not finite.
    """
    patch, corner, exponent, rounding = _cut(views, slopes, regions)
    farthest = np.abs(slopes).max()
    axes, interval_of_region = [], []
    for k in (0, 1):
        bounds = np.array([region[2 * k : 2 * k + 2] for region in regions]) - corner[k]
        intervals, which = np.unique(bounds, axis=0, return_inverse=True)
        axes.append(_Axis.of(patch.shape[k], patch.shape[k + 2], intervals, farthest))
        interval_of_region.append(which)
    batches = [slopes[i : i + SLOPES_AT_ONCE] for i in range(0, len(slopes), SLOPES_AT_ONCE)]
    gradients = _gradients(patch)
    sums: Iterable[tuple] = _energies(gradients, axes, batches)
    if progress is not None:
        sums = progress(sums, 0, len(batches))
    down, across = interval_of_region
    refocused, alike, seen = (
        np.concatenate(batch)[:, down, across] for batch in zip(*sums, strict=True)
    )
    energy = alike / seen
    bright = energy > LEAK * np.linalg.norm(gradients) ** 2 / gradients.size
    agreement = np.divide(refocused, alike, out=np.zeros_like(refocused), where=bright)
    return agreement, np.ldexp(energy, 2 * exponent), np.ldexp(rounding, exponent)


def _cut(views: np.ndarray, slopes: np.ndarray, regions: list):
    """Cut out what the regions can see at the slopes, grey, less its mean, up to about 1.

    Returns the patch, its corner, the power of two that it was divided by (so that no sum of
    float32 overflows and no digit changes), and how much of a gradient may be rounding.
    """
    cuts = []
    for k in (0, 1):
        reach = int(np.abs(slopes).max() * (views.shape[k] - 1) / 2) + REACH
        low = min(region[2 * k] for region in regions) - reach
        high = max(region[2 * k + 1] for region in regions) + reach
        cuts.append(slice(max(low, 0), min(high, views.shape[k + 2])))
    patch = views[:, :, cuts[0], cuts[1]]
    with np.errstate(invalid="ignore"):  # infinities of both signs
        grey = patch.ndim == 4
        patch = patch.astype(np.float64) if grey else patch.mean(axis=4, dtype=np.float64)
    brightest = np.abs(patch).max()
    if not np.isfinite(brightest):
        refuse_not_finite(views)
    exponent = int(np.frexp(brightest)[1])
    np.ldexp(patch, -exponent, out=patch)
    rounding = ROUNDING * np.linalg.norm(patch) / np.sqrt(patch.size)
    patch -= patch.mean()
    return patch.astype(np.float32), (cuts[0].start, cuts[1].start), exponent, rounding


def _gradients(patch: np.ndarray) -> np.ndarray:
    """Gradient ``d/dt + i d/ds`` of the low-passed views, their edges repeated: complex64."""
    size = patch.shape[2:]
    padded = [fft.next_fast_len(n + 2 * REACH, real=True) for n in size]
    pads = [(REACH, m - n - REACH) for n, m in zip(size, padded, strict=True)]
    spectra = fft.rfft2(np.pad(patch, [(0, 0), (0, 0), *pads], mode="edge"))
    down, right = fft.fftfreq(padded[0])[:, None], fft.rfftfreq(padded[1])[None, :]
    low_pass = 2j * np.pi * np.exp(-(down**2 + right**2) / (2 * PASS_BAND**2))
    inside = np.s_[:, :, REACH : REACH + size[0], REACH : REACH + size[1]]
    out = np.empty(patch.shape, np.complex64)
    for part, frequencies in ((out.real, down), (out.imag, right)):
        derivative = (low_pass * frequencies).astype(np.complex64)
        part[...] = fft.irfft2(spectra * derivative, padded)[inside]
    return out


def _energies(gradients: np.ndarray, axes: list["_Axis"], batches: list) -> Iterator[tuple]:
    """Sum up numerator and denominator of the semblance over the regions.

    With x a lenslet, w the region, g_a the gradient of view a, h its weight before it is shifted
    (the same for all views), and d_a its shift at a slope:

        numerator     sum_x w(x) |sum_a (h g_a)(x + d_a)|^2
        denominator   sum_x w(x) S(x) sum_a (h |g_a|^2)(x + d_a),  S(x) = sum_a h(x + d_a)

    By the shift theorem ``f(x + d) = F^-1[exp(2 pi i k d) F[f](k)]`` the sum over the views in the
    numerator takes one inverse transform for each slope, of spectra that are computed once. In the
    denominator the shifts are moved to the other factor, ``sum_a sum_y (h |g_a|^2)(y) (w S)(y -
    d_a)``, where y - d_a is the conjugate phase: the views' energy stays as it is, and is summed by
    weights that are shifted back. As w, h and the shifts are separable along the two axes, so are
    those weights, and the sums are two matrix products.

    Parameters
    ----------
    gradients : ndarray of complex64, shape (v, u, t, s)
    axes : (_Axis, _Axis)
        Along (v, t) and along (u, s).
    batches : list of ndarray of float64, shape (n,)
        Slopes that are worked on together.

    Yields
    ------
    numerator, denominator, seen : ndarray of float64, shape (n, i, j)
        For slope n, interval i down and interval j across; the last is ``sum_x w(x) S(x)^2``.
    """
    rows, columns, height, width = gradients.shape
    down, across = axes
    taper = np.outer(_taper(height), _taper(width)).astype(np.float32)  # [t, s]
    energy = taper * (gradients.real**2 + gradients.imag**2)  # [v, u, t, s]
    energy = energy.transpose(0, 2, 1, 3).reshape(rows * height, columns * width)  # [v t, u s]
    spectra = fft.fft2(taper * gradients, (down.period, across.period))  # [v, u, k_t, k_s]
    spectra = np.ascontiguousarray(spectra.transpose(3, 0, 1, 2))  # [k_s, v, u, k_t]
    for slopes in batches:
        phases = down.phases(slopes), across.phases(slopes)  # [k_t, v, n], [k_s, u, n]
        image = _refocused(spectra, *phases)[:, :height, :width].astype(np.complex128)  # [n, t, s]
        light = image.real**2 + image.imag**2  # [n, t, s]
        # Not by BLAS, whose sums depend on the number of its threads.
        refocused = np.einsum("it,nts->nis", down.covered, light)
        refocused = np.einsum("nis,js->nij", refocused, across.covered)
        by_row, seen_down = down.weights(phases[0])  # [n, i, v, t], [n, i]
        by_column, seen_across = across.weights(phases[1])  # [n, j, u, s], [n, j]
        alike = _sum_energy(energy, by_row, by_column)  # [n, i, j]
        yield refocused, alike, seen_down[:, :, None] * seen_across[:, None, :]


def _sum_energy(energy: np.ndarray, by_row: np.ndarray, by_column: np.ndarray) -> np.ndarray:
    """Sum energy[v t, u s] by weights by_row[n, i, v, t] and by_column[n, j, u, s]: [n, i, j]."""
    slopes, intervals = by_row.shape[:2]
    by_row = np.ascontiguousarray(by_row.reshape(slopes * intervals, -1))  # [n i, v t]
    row_sums = np.empty((len(by_row), energy.shape[1]))  # [n i, u s]
    _semblance_kernels.multiply(by_row, energy, row_sums)
    by_column = by_column.reshape(slopes, -1, energy.shape[1])  # [n, j, u s]
    by_interval = row_sums.reshape(slopes, intervals, -1)  # [n, i, u s]
    return np.einsum("nix,njx->nij", by_interval, by_column)


def _refocused(spectra: np.ndarray, down: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Sum views, shifted by their phase factors.

    Parameters
    ----------
    spectra : ndarray of complex64, shape (k_s, v, u, k_t)
    down, across : ndarray of complex128, shapes (k_t, v, n) and (k_s, u, n)

    Returns
    -------
    ndarray of complex64, shape (n, t, s)
        As long as the periods; cut off what is beyond the views.
    """
    # Small matrix products, [n, u] @ [u, k_t]; for larger ones BLAS starts threads, and waits.
    row_sums = across.astype(np.complex64).transpose(0, 2, 1)[:, None] @ spectra  # [k_s, v, n, k_t]
    down = down.astype(np.complex64).transpose(1, 2, 0)  # [v, n, k_t]
    return fft.ifft2(np.einsum("svnt,vnt->nts", row_sums, down))  # of [n, k_t, k_s]


def _taper(n: int) -> np.ndarray:
    """Weight of a view along an axis: 1, and falling to 0 at its edges."""
    inward = (np.minimum(np.arange(n), np.arange(n)[::-1]) + 0.5) / min(REACH, n / 4)
    return np.sin(np.pi / 2 * np.minimum(inward, 1)) ** 2


@dataclass(frozen=True, eq=False)
class _Axis:
    """How views are shifted along one axis, and the intervals of it that regions cover.

    Attributes
    ----------
    views, length : int
        Views along the angular axis, and lenslets along the spatial one.
    period : int
        Lenslets after which a transform repeats itself, `length` or more.
    covered : ndarray of float64, shape (intervals, length), from 0 to 1
    """

    views: int
    length: int
    period: int
    covered: np.ndarray

    @classmethod
    def of(cls, views: int, length: int, intervals: np.ndarray, farthest: float) -> "_Axis":
        """Lay out an axis for intervals (start, stop), one a row, and slopes up to `farthest`."""
        # So long that nothing that leaves at one end can come around into a region.
        span = max(length - intervals.min(), intervals.max()) + farthest * (views - 1) / 2
        period = fft.next_fast_len(max(length, int(np.ceil(span))))
        lenslets = np.arange(length)
        covered = (intervals[:, :1] <= lenslets) & (lenslets < intervals[:, 1:])
        # With hard edges, interpolation would ring into the dark from bright light beyond them.
        covered = gaussian_filter1d(covered.astype(np.float64), SOFTNESS, mode="constant")
        return cls(views, length, period, covered)

    def phases(self, slopes: np.ndarray) -> np.ndarray:
        """Phase factors that shift the views: complex128, shape (period, views, slopes)."""
        shifts = centred(self.views)[:, None] * slopes
        return np.exp(2j * np.pi * fft.fftfreq(self.period)[:, None, None] * shifts)

    def weights(self, phases: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Weights by which the views' energy counts in each interval, and sums of their squares.

        Parameters
        ----------
        phases : ndarray of complex128, shape (period, views, slopes)

        Returns
        -------
        ndarray of float64, shape (slopes, intervals, views, length)
            ``(w S)(y - d_a)``, see `_energies`.
        ndarray of float64, shape (slopes, intervals)
            ``sum_x w(x) S(x)^2``.
        """
        taper = fft.fft(_taper(self.length), self.period)  # [k]
        seen = fft.ifft(taper[:, None] * phases.sum(axis=1), axis=0).real[: self.length]  # [x, n]
        within = self.covered[:, :, None] * seen  # [i, x, n]
        spectra = fft.fft(within, self.period, axis=1)[:, :, None]  # [i, k, 1, n]
        weights = fft.ifft(spectra * phases.conj(), axis=1).real[:, : self.length]  # [i, x, a, n]
        return weights.transpose(3, 0, 2, 1), np.einsum("it,tn->ni", self.covered, seen**2)
