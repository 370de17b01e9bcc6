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

from collections.abc import Iterator
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


def semblance(views: np.ndarray, slopes: np.ndarray, regions: list, progress=None):
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
    axes, places = [], []
    for k in (0, 1):
        bounds = np.array([region[2 * k : 2 * k + 2] for region in regions]) - corner[k]
        stretches, place = np.unique(bounds, axis=0, return_inverse=True)
        axes.append(_Axis.of(patch.shape[k], patch.shape[k + 2], stretches, farthest))
        places.append(place)
    batches = [slopes[i : i + SLOPES_AT_ONCE] for i in range(0, len(slopes), SLOPES_AT_ONCE)]
    gradients = _gradients(patch)
    sums = _energies(gradients, axes, batches)
    if progress is not None:
        sums = progress(sums, 0, len(batches))
    refocused, alike, seen = (np.concatenate(s)[:, *places] for s in zip(*sums, strict=True))
    energy = alike / seen
    bright = energy > LEAK * np.linalg.norm(gradients) ** 2 / gradients.size
    share = np.divide(refocused, alike, out=np.zeros_like(refocused), where=bright)
    return share, np.ldexp(energy, 2 * exponent), np.ldexp(rounding, exponent)


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
    """Yield numerator and denominator of the semblance, and sums of ``(sum_a h_a)^2``.

    For each batch of slopes, each of shape (slopes, stretches down, stretches across).
    """
    rows, columns, height, width = gradients.shape
    down, across = axes
    weights = np.outer(_taper(height), _taper(width)).astype(np.float32)
    energy = weights * (gradients.real**2 + gradients.imag**2)
    energy = energy.transpose(0, 2, 1, 3).reshape(rows * height, columns * width)
    spectra = fft.fft2(weights * gradients, (down.period, across.period))
    spectra = np.ascontiguousarray(spectra.transpose(3, 0, 1, 2))
    for slopes in batches:
        turns = down.turns(slopes), across.turns(slopes)
        image = _refocused(spectra, *turns)[:, :height, :width].astype(np.complex128)
        light = image.real**2 + image.imag**2
        # Not by BLAS, whose sums depend on the number of its threads.
        refocused = np.einsum("it,nts->nis", down.covered, light)
        refocused = np.einsum("nis,js->nij", refocused, across.covered)
        (by_row, seen_down), (by_column, seen_across) = (
            axis.weights(turn) for axis, turn in zip(axes, turns, strict=True)
        )
        row_sums = np.empty((by_row.shape[0] * by_row.shape[1], columns * width))
        by_row = np.ascontiguousarray(by_row.reshape(len(row_sums), rows * height))
        _semblance_kernels.multiply(by_row, energy, row_sums)
        row_sums = row_sums.reshape(len(slopes), -1, columns * width)
        by_column = by_column.reshape(len(slopes), -1, columns * width)
        alike = np.einsum("nix,njx->nij", row_sums, by_column)
        yield refocused, alike, seen_down[:, :, None] * seen_across[:, None, :]


def _refocused(spectra: np.ndarray, down: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Sum of views [s, v, u, t] in shifts given by their phases: images, shape (slopes, t, s)."""
    # Small matrix products, [n, u] @ [u, t]; for larger ones BLAS starts threads, and waits.
    row_sums = across.astype(np.complex64).transpose(0, 2, 1)[:, None] @ spectra
    down = down.astype(np.complex64).transpose(1, 2, 0)
    return fft.ifft2(np.einsum("svnt,vnt->nts", row_sums, down))


def _taper(n: int) -> np.ndarray:
    """Weight of a view along an axis: 1, and falling to 0 at its edges."""
    inward = (np.minimum(np.arange(n), np.arange(n)[::-1]) + 0.5) / min(REACH, n / 4)
    return np.sin(np.pi / 2 * np.minimum(inward, 1)) ** 2


@dataclass(frozen=True, eq=False)
class _Axis:
    """How views are shifted along one axis, and the stretches of it that regions cover."""

    views: int
    length: int
    period: int
    covered: np.ndarray  # shape (stretches, length), from 0 to 1

    @classmethod
    def of(cls, views: int, length: int, stretches: np.ndarray, farthest: float) -> "_Axis":
        # So long that nothing that leaves at one end can come around into a region.
        span = max(length - stretches.min(), stretches.max()) + farthest * (views - 1) / 2
        period = fft.next_fast_len(max(length, int(np.ceil(span))))
        places = np.arange(length)
        covered = (stretches[:, :1] <= places) & (places < stretches[:, 1:])
        # With hard edges, interpolation would ring into the dark from bright light beyond them.
        covered = gaussian_filter1d(covered.astype(np.float64), SOFTNESS, mode="constant")
        return cls(views, length, period, covered)

    def turns(self, slopes: np.ndarray) -> np.ndarray:
        """Phases that shift the views, shape (period, views, slopes)."""
        shifts = centred(self.views)[:, None] * slopes
        return np.exp(2j * np.pi * fft.fftfreq(self.period)[:, None, None] * shifts)

    def weights(self, turns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Weights by which the views' energy counts in each stretch, and the sums of their squares.

        Shapes (slopes, stretches, views, length) and (slopes, stretches). To sum up energy that is
        shifted is to sum it up unshifted, by weights that are shifted back.
        """
        taper = fft.fft(_taper(self.length), self.period)
        seen = fft.ifft(taper[:, None] * turns.sum(axis=1), axis=0).real[: self.length]
        back = fft.fft(self.covered[:, :, None] * seen, self.period, axis=1)[:, :, None]
        weights = fft.ifft(back * turns.conj(), axis=1).real[:, : self.length]
        return weights.transpose(3, 0, 2, 1), np.einsum("it,tn->ni", self.covered, seen**2)
