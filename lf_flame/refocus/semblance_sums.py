"""Sums of shifted views over regions, for the semblance.

With x a lenslet, w the region, g_a the gradient of view a, c_a its weight, h its taper before it is
shifted (the same for all views), and d_a its shift at a slope:

    numerator     sum_x w(x) |sum_a c_a (h g_a)(x + d_a)|^2
    denominator   sum_x w(x) S(x) sum_a c_a (h |g_a|^2)(x + d_a),  S(x) = sum_a c_a h(x + d_a)

By the shift theorem ``f(x + d) = F^-1[exp(2 pi i k d) F[f](k)]`` the sum over the views in the
numerator takes one inverse transform for each slope, of spectra that are computed once. In the
denominator the shifts move to the other factor,
``sum_a c_a sum_y (h |g_a|^2)(y) (w S)(y - d_a)``, where y - d_a is the conjugate phase: the views'
energy is not shifted, and is summed with weights that are shifted back. Since w, h and the shifts
are separable along the two axes, so are those weights if all views have equal weights, and the sums
are two matrix products. Other c_a are a sum of separable terms, and S is a sum of as many.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy import fft
from scipy.ndimage import gaussian_filter1d

from lf_flame._common.arrays import centred
from lf_flame.refocus import _semblance_kernels

REACH = 8
"""Reach of the low-pass in lenslets, over which a view's taper falls to 0 at its edges."""

SOFTNESS = 1.5
"""Standard deviation of a region's edges in lenslets."""

SLOPES_AT_ONCE = 8
"""Number of slopes refocused together; more would take more memory and hardly less time."""

LEAST_TERM, MOST_TERMS = 1e-6, 2
"""Smallest separable term of the weights of views, relative to the largest, and most terms. With
more, no slope of round apertures changed by 1e-4: the first term is exact but for the corners."""

MEMORY, SHARE = 48e6, 0.45
"""Memory in bytes for the sums at some slopes, or, if larger, this fraction of the views in
float32; for more slopes the views are read again."""


@dataclass(frozen=True, eq=False)
class ShiftAxis:
    """Shifts of the views along one axis, and the intervals that regions cover.

    Attributes
    ----------
    views, length : int
        Number of views along the angular axis, and of lenslets along the spatial axis.
    period : int
        Period of the transforms in lenslets, `length` or more.
    covered : ndarray of float64, shape (intervals, length), from 0 to 1
        Coverage of each lenslet by each interval.
    terms : ndarray of float64, shape (terms, views)
        Factors of the separable terms of the weights of views, along this axis.
    """

    views: int
    length: int
    period: int
    covered: np.ndarray
    terms: np.ndarray

    @classmethod
    def of(
        cls, length: int, intervals: np.ndarray, farthest: float, terms: np.ndarray
    ) -> "ShiftAxis":
        """Prepare an axis for intervals (start, stop), one a row, and slopes up to `farthest`."""
        views = terms.shape[1]
        # Long enough that nothing that leaves at one end wraps around into a region.
        span = max(length - intervals.min(), intervals.max()) + farthest * (views - 1) / 2
        period = fft.next_fast_len(max(length, int(np.ceil(span))))
        lenslets = np.arange(length)
        covered = (intervals[:, :1] <= lenslets) & (lenslets < intervals[:, 1:])
        # With hard edges, bright light beyond them would ring into a dark region.
        covered = gaussian_filter1d(covered.astype(np.float64), SOFTNESS, mode="constant")
        return cls(views, length, period, covered, terms)

    def phases(self, slopes: np.ndarray) -> np.ndarray:
        """Phase factors that shift the views: complex64, shape (slopes, period, views)."""
        return np.stack([self._phases(slope) for slope in slopes]).astype(np.complex64)

    def _phases(self, slope: float) -> np.ndarray:
        return np.exp(2j * np.pi * np.outer(fft.fftfreq(self.period), slope * centred(self.views)))

    def weights(self, slope: float) -> tuple[np.ndarray, np.ndarray]:
        """Weights of the views' energy in each interval, and sums of their squares.

        Returns
        -------
        ndarray of float64, shape (terms, intervals, views, length)
            ``(w S)(y - d_a)``.
        ndarray of float64, shape (terms, terms, intervals)
            ``sum_x w(x) S(x)^2``, with S^2 the product of two terms.
        """
        phases = self._phases(slope)  # [k, a]
        taper = fft.fft(taper_of(self.length), self.period)  # [k]
        shifted = np.stack([(phases * term).sum(axis=1) for term in self.terms])  # [m, k]
        seen = fft.ifft(taper * shifted).real[:, : self.length]  # [m, x]
        spectra = fft.fft(self.covered * seen[:, None], self.period)  # [m, i, k]
        weights = fft.ifft(spectra[:, :, None] * phases.conj().T).real  # [m, i, a, k]
        products = seen[:, None] * seen
        return weights[..., : self.length], np.einsum("it,mnt->mni", self.covered, products)


def separable_terms(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Write weights of views as a sum of products of one factor along v and one along u.

    Parameters
    ----------
    counts : ndarray of float64, shape (v, u)

    Returns
    -------
    ndarray of float64, shape (terms, v)
    ndarray of float64, shape (terms, u)
        Factors. The first term has the sums over rows and columns; alone it is exact for equal
        weights.
    """
    down, across = counts.mean(axis=1), counts.mean(axis=0) / counts.mean()
    left, sizes, right = np.linalg.svd(counts - np.outer(down, across))
    some = sizes > LEAST_TERM * counts.max()
    some[MOST_TERMS - 1 :] = False
    more = (left[:, : len(sizes)] * sizes).T[some], right[: len(sizes)][some]
    return np.vstack([down, more[0]]), np.vstack([across, more[1]])


def slopes_in_memory(down: ShiftAxis, across: ShiftAxis) -> int:
    """Find the number of slopes with sums that fit into memory."""
    room = max(MEMORY, SHARE * 4 * down.views * down.length * across.views * across.length)
    energy = len(down.covered) * (across.views * across.length + down.views * down.length)
    energy *= len(down.terms)
    return max(int(room / (8 * (down.period * across.period + energy))), SLOPES_AT_ONCE)


class SemblanceSums:
    """Numerator and denominator of the semblance at some slopes, summed by rows of views.

    Parameters
    ----------
    slopes : ndarray of float64, shape (n,)
        Slopes in lenslets per view step.
    down, across : ShiftAxis
        Axes along (v, t) and along (u, s).
    counts : ndarray of float64, shape (v, u)
        Weight of each view, 1 in the mean.
    """

    def __init__(self, slopes: np.ndarray, down: ShiftAxis, across: ShiftAxis, counts: np.ndarray):
        self.slopes, self.down, self.across, self.counts = slopes, down, across, counts
        self.mean_energy = 0.0
        """Mean squared gradient of the views."""
        self.found: tuple[np.ndarray, np.ndarray, np.ndarray]
        """Numerator, denominator and ``sum_x w(x) S(x)^2``, float64, shape (n, i, j), for interval
        i down and interval j across; set when the last row has been added."""

    def add(self, v: int, gradients: Iterable[tuple[int, np.ndarray]]) -> None:
        """Add row v of the views, as (u, gradient [t, s]) of views above weight 0; in order."""
        if v == 0:
            self._begin()
        down, across = self.down, self.across
        taper = np.outer(taper_of(down.length), taper_of(across.length)).astype(np.float32)
        energies = np.zeros((down.length, across.views, across.length), np.float32)
        spectra = np.zeros((across.period, across.views, down.period), np.complex64)
        for u, gradient in gradients:
            count = np.float32(self.counts[v, u])
            energy = count * (gradient.real**2 + gradient.imag**2)
            self.mean_energy += float(energy.mean(dtype=np.float64)) / (down.views * across.views)
            energies[:, u] = taper * energy
            light = (taper * (count * gradient)).T  # [s, t]
            spectra[:, u] = fft.fft2(light, self._periods)
        self._add_energies(v, energies.reshape(down.length, -1))
        self._add_spectra(v, spectra)
        if v == down.views - 1:
            self._end()

    @property
    def _periods(self) -> tuple[int, int]:
        return self.across.period, self.down.period

    def _begin(self) -> None:
        lines = len(self.down.terms) * len(self.down.covered)
        width = self.across.views * self.across.length
        weights, seen = zip(*(self.down.weights(slope) for slope in self.slopes), strict=True)
        self._by_row, self._seen_down = np.stack(weights), seen  # [n, m, i, v, t], [m, m, i]
        self._row_sums = np.zeros((len(self.slopes) * lines, width))  # [n m i, u s]
        self._phases_down = self.down.phases(self.slopes)  # [n, k_t, v]
        across = self.across.phases(self.slopes)
        self._phases_across = np.ascontiguousarray(across.transpose(1, 0, 2))  # [k_s, n, u]
        self._spectra = np.zeros((len(self.slopes), *self._periods), np.complex64)  # [n, k_s, k_t]

    def _add_energies(self, v: int, energies: np.ndarray) -> None:
        """Add the energies of row v, [t, u s]."""
        by_row = self._by_row[..., v, :].reshape(len(self._row_sums), -1)  # [n m i, t]
        _semblance_kernels.add_product(np.ascontiguousarray(by_row), energies, self._row_sums)

    def _add_spectra(self, v: int, spectra: np.ndarray) -> None:
        """Add the spectra of row v, [k_s, u, k_t]."""
        for first in range(0, len(self.slopes), SLOPES_AT_ONCE):
            some = slice(first, first + SLOPES_AT_ONCE)
            # Small matrix products, [n, u] @ [u, k_t]; for larger ones BLAS starts threads.
            row_sums = self._phases_across[:, some] @ spectra  # [k_s, n, k_t]
            row_sums *= self._phases_down[some, :, v]
            self._spectra[some] += row_sums.transpose(1, 0, 2)

    def _end(self) -> None:
        """Sum over the regions, and free the memory used for it."""
        refocused, alike, seen = [], [], []
        by_interval = self._row_sums.reshape(*self._by_row.shape[:3], -1)  # [n, m, i, u s]
        for n, slope in enumerate(self.slopes):
            image = fft.ifft2(self._spectra[n]).T[: self.down.length, : self.across.length]
            light = image.real.astype(np.float64) ** 2 + image.imag.astype(np.float64) ** 2
            # Not with BLAS, where sums depend on the number of threads.
            lines = np.einsum("it,ts->is", self.down.covered, light)
            refocused.append(np.einsum("is,js->ij", lines, self.across.covered))
            by_column, seen_across = self.across.weights(slope)  # [m, j, u, s], [m, m, j]
            by_column = by_column.reshape(*by_column.shape[:2], -1)
            pairs = zip(by_interval[n], by_column, strict=True)
            alike.append(sum(np.einsum("ix,jx->ij", *pair) for pair in pairs))
            seen.append(np.einsum("mni,mnj->ij", self._seen_down[n], seen_across))
        self.found = np.stack(refocused), np.stack(alike), np.stack(seen)
        del self._by_row, self._row_sums, self._phases_down, self._phases_across, self._spectra


def taper_of(n: int) -> np.ndarray:
    """Taper of a view along an axis: 1, falling to 0 at its edges."""
    inward = (np.minimum(np.arange(n), np.arange(n)[::-1]) + 0.5) / min(REACH, n / 4)
    return np.sin(np.pi / 2 * np.minimum(inward, 1)) ** 2
