"""Refocusing by any method; in the Fourier domain by exact phases for each view, or Ng's slice."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial

import numpy as np
from numba import get_num_threads
from numpy.typing import ArrayLike
from scipy.fft import ifft2, irfft2, next_fast_len, rfft2
from scipy.special import i0

from lf_flame._common.arrays import centred
from lf_flame.errors import InputError
from lf_flame.refocus import _kernels
from lf_flame.refocus._arguments import (
    Views,
    as_slopes,
    as_views,
    as_weights,
    by_channel,
    for_slopes,
    refuse_infinite,
)
from lf_flame.refocus.shift import INTERPOLATIONS, check_interpolation, shift_and_sum, shift_taps
from lf_flame.refocus.unknown_pixels import ignoring_unknown

SLOPES_AT_ONCE = 4
"""Number of slopes with row sums that are held in memory together."""

SLICE_WIDTHS = (2, 4, 6, 8)
"""Numbers of samples along an angular axis from which a slice may be interpolated."""

OVERSAMPLING = 2
"""Number of samples of the angular spectrum per view, for slices."""


def refocus(
    light_field: Views,
    slopes: ArrayLike,
    *,
    interpolation: str = "linear",
    method: str = "auto",
    weights: ArrayLike | None = None,
) -> np.ndarray:
    """Refocus a light field by any method; coordinates are clamped at the edges.

    The method affects the time, not the image: where two methods offer an interpolation, their
    results agree to 1e-6 of the brightest pixel.

    Parameters
    ----------
    light_field : LightField or array_like, shape (v, u, t, s) or (v, u, t, s, channels)
    slopes : float or sequence of float
        Slopes in lenslets per view step.
    interpolation : {"linear", "nearest", "cubic", "sinc"}, optional
        Interpolation between lenslets. "sinc" shifts band-limited views exactly.
    method : {"auto", "space", "fourier", "slice"}, optional
        `shift_and_sum`, `fourier_refocus`, `fourier_slice` (for "sinc" only), or chosen.
        "auto" is "fourier" for "sinc", and "space" otherwise, the fastest for some images. A slice
        is read from all over a spectrum far larger than the cache, and takes less time than phases
        only for many tens of images.
    weights : array_like, shape (v, u), optional
        Weight of each view, 0 or above; divided by their sum. The light field's own weights
        multiply them. Default: all equal.

    Returns
    -------
    ndarray of float32, shape (n, t, s) or (n, t, s, channels)
        One image for each slope; for a single number the image itself, without the first axis.

    Raises
    ------
    InputError
        If an argument cannot be used, or the method does not offer the interpolation.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import refocus
    >>> views = np.random.default_rng(1).uniform(size=(5, 5, 24, 30))

    >>> refocus.refocus(views, 0.5, interpolation="sinc").shape
    (24, 30)
    """
    methods = ("auto", "space", "fourier", "slice")
    if method not in methods:
        raise InputError(f"method must be one of {', '.join(methods)}, got {method!r}.")
    check_interpolation(interpolation, (*INTERPOLATIONS, "sinc"))
    if method == "auto":
        method = "fourier" if interpolation == "sinc" else "space"
    if (method == "space") == (interpolation == "sinc") and method != "fourier":
        raise InputError(f"The method {method!r} does not offer {interpolation!r} interpolation.")
    if method == "space":
        return shift_and_sum(light_field, slopes, interpolation=interpolation, weights=weights)
    if method == "fourier":
        return fourier_refocus(
            light_field, slopes, interpolation=interpolation, edges="clamp", weights=weights
        )
    # A slice of width 8 equals exact phases, up to the rounding of float32.
    return fourier_slice(light_field, slopes, width=8, edges="clamp", weights=weights)


@ignoring_unknown(shift_and_sum)
def fourier_refocus(
    light_field: Views,
    slopes: ArrayLike,
    *,
    interpolation: str = "sinc",
    edges: str = "wrap",
    weights: ArrayLike | None = None,
) -> np.ndarray:
    """Refocus by the shift theorem: each view's spectrum times the phase factor of its shift.

    All images come from one transform of the views. With the defaults "sinc" and "wrap", shifts of
    band-limited, periodic views are exact: nothing is interpolated or softened; light that leaves
    at one edge enters at the opposite one. With another interpolation and "clamp" the result is
    that of `shift_and_sum`, up to rounding.

    Parameters
    ----------
    light_field : LightField or array_like, shape (v, u, t, s) or (v, u, t, s, channels)
    slopes : float or sequence of float
        Slopes in lenslets per view step.
    interpolation : {"sinc", "linear", "nearest", "cubic"}, optional
        Interpolation between lenslets; "sinc" is exact for band-limited views.
    edges : {"wrap", "clamp"}, optional
        Continuation at the edges. "clamp" pads every view with its edge as far as its shift
        reaches; "sinc" then does not wrap around, but rings where the pads meet.
    weights : array_like, shape (v, u), optional
        Weight of each view, 0 or above; divided by their sum. The light field's own weights
        multiply them. Default: all equal.

    Returns
    -------
    ndarray of float32, shape (n, t, s) or (n, t, s, channels)
        One image for each slope; for a single number the image itself, without the first axis.
        Computed in float64.

    Raises
    ------
    InputError
        If an argument cannot be used.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import refocus
    >>> views = np.random.default_rng(1).uniform(size=(5, 5, 24, 30))

    >>> exact = refocus.fourier_refocus(views, 1.0)
    >>> middle = np.s_[4:-4, 4:-4]  # whole shifts need no interpolation
    >>> np.allclose(exact[middle], refocus.shift_and_sum(views, 1.0)[middle], atol=1e-6)
    True
    """
    weights = as_weights(weights, light_field)
    views, steps = as_views(light_field), as_slopes(slopes)
    check_interpolation(interpolation, ("sinc", *INTERPOLATIONS))
    _check_edges(edges)
    of_channel = partial(_by_phases, interpolation=interpolation, edges=edges)
    return for_slopes(by_channel(of_channel, views, steps, weights), slopes)


def _check_edges(edges: str) -> None:
    if edges not in ("wrap", "clamp"):
        raise InputError(f"edges must be one of wrap, clamp, got {edges!r}.")


def _by_phases(views, slopes, weights, interpolation: str, edges: str) -> np.ndarray:
    height, width = views.shape[2:]
    shifts = [centred(count) * slopes[:, None] for count in views.shape[:2]]
    pads = [(0, 0), (0, 0)]
    if edges == "clamp":
        shifts = [np.clip(x, -n, n) for x, n in zip(shifts, (height, width), strict=True)]
        pads = _pads(views.shape[2:], shifts)
    padded = [n + sum(pad) for n, pad in zip((height, width), pads, strict=True)]
    down, right = (
        _phase_factors(waves, shift, interpolation)
        for waves, shift in zip((np.fft.fftfreq(padded[0]), np.fft.rfftfreq(padded[1])), shifts,
                                strict=True)
    )  # fmt: skip
    with np.errstate(invalid="ignore"):  # infinite pixels are refused below
        means = _mean_by_factors(_spectra(views, weights / weights.mean(), pads), down, right)
    (t, _), (s, _) = pads
    images = np.empty((len(slopes), height, width), np.float32)
    for image, mean in zip(images, means, strict=True):
        whole = irfft2(mean, padded)
        image[...] = whole[t : t + height, s : s + width]
    refuse_infinite(images, views)
    return images


def _spectra(views: np.ndarray, weights: np.ndarray, pads: list) -> Iterator[np.ndarray]:
    """Weighted spectra [u, t, s], one row of views at a time, to save memory."""
    size = [n + sum(pad) for n, pad in zip(views.shape[2:], pads, strict=True)]
    for row, row_weights in zip(views, weights, strict=True):
        # In the memory order in which the sums over u read them.
        spectra = np.empty((size[1] // 2 + 1, size[0], len(row)), np.complex128).transpose(2, 1, 0)
        for view, weight, spectrum in zip(row, row_weights, spectra, strict=True):
            view = view if weight else np.zeros_like(view)  # not read
            view = np.pad(view.astype(np.float64, copy=False), pads, mode="edge")
            np.multiply(rfft2(view), weight, out=spectrum)  # threads gain nothing on one view
        yield spectra


def _pads(size: tuple[int, int], shifts: list[np.ndarray]) -> list[tuple[int, int]]:
    """Find the number of edge pixels to repeat before and after each axis: as shifts reach."""
    pads = []
    for length, some in zip(size, shifts, strict=True):
        reach = int(np.abs(some).max()) + 2  # and as far as cubic interpolation does
        pads.append((reach, next_fast_len(length + 2 * reach, real=True) - length - reach))
    return pads


def _phase_factors(frequencies: np.ndarray, shifts: np.ndarray, interpolation: str = "sinc"):
    """Frequency response of shifts [n, view]: complex128 [frequency, view, n].

    For "sinc" it is the phase factor itself; for another interpolation, the weighted sum of phase
    factors over its taps.
    """
    if interpolation != "sinc":
        first, weights = shift_taps(shifts.T, interpolation)
        offsets = first + np.arange(len(weights))[:, None, None]
        waves = np.exp(2j * np.pi * frequencies[:, None, None, None] * offsets)
        return np.einsum("fjvn,jvn->fvn", waves, weights)
    phases = np.exp(2j * np.pi * frequencies[:, None, None] * shifts.T)
    # A fractional shift leaves only the real part of the Nyquist frequency.
    nyquist = np.abs(frequencies) == 0.5
    phases[nyquist] = phases[nyquist].real
    return phases


def _mean_by_factors(spectra: Iterable[np.ndarray], down, right) -> np.ndarray:
    """Mean over rows v of spectra [u, t, s] times down[t, v, n] and right[s, u, n]: [n, t, s]."""
    height, rows, slopes = down.shape
    waves, columns = right.shape[:2]
    total = np.zeros((waves, height, slopes), np.complex128)
    for v, row in enumerate(spectra):
        by_wave = np.ascontiguousarray(row.transpose(2, 1, 0))  # [s, t, u]: one product per wave
        for first in range(0, slopes, SLOPES_AT_ONCE):
            some = np.s_[..., first : first + SLOPES_AT_ONCE]
            row_sums = by_wave @ right[some].astype(by_wave.dtype)
            row_sums *= down[:, v][some]
            total[some] += row_sums
    total /= rows * columns
    return total.transpose(2, 1, 0)


@ignoring_unknown(shift_and_sum)
def fourier_slice(
    light_field: Views,
    slopes: ArrayLike,
    *,
    width: int = 6,
    edges: str = "wrap",
    weights: ArrayLike | None = None,
) -> np.ndarray:
    """Refocus with Ng's Fourier slice: photographs are slices of the light field's spectrum.

    R. Ng, "Fourier slice photography", ACM Trans. Graph. 24 (2005). The slice at a slope runs
    through the angular frequencies ``slope * (k_t, k_s)``, k being the spatial ones. There the
    spectrum, of the views padded to twice their number, is interpolated from `width` x `width`
    samples with a Kaiser-Bessel window, whose roll-off is divided out beforehand (J. Jackson et
    al., IEEE Trans. Med. Imag. 10, 1991). The error from this resampling, for random views with
    values from 0 to 1, is at most 3e-1, 1e-3, 2e-5 and 1e-6 for a width of 2, 4, 6 and 8.

    Parameters
    ----------
    light_field : LightField or array_like, shape (v, u, t, s) or (v, u, t, s, channels)
    slopes : float or sequence of float
        Slopes in lenslets per view step.
    width : {2, 4, 6, 8}, optional
        Number of samples along each angular axis from which the slice is interpolated.
    edges : {"wrap", "clamp"}, optional
        Beyond the edges: the image again ("wrap"), or its edge pixels ("clamp"); for "clamp" no
        slope may shift a view by more than the image's size.
    weights : array_like, shape (v, u), optional
        Weight of each view, 0 or above; divided by their sum. The light field's own weights
        multiply them. Default: all equal.

    Returns
    -------
    ndarray of float32, shape (n, t, s) or (n, t, s, channels)
        One image for each slope; for a single number the image itself, without the first axis.
        Computed in float32.

    Raises
    ------
    InputError
        If an argument cannot be used.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import refocus
    >>> views = np.random.default_rng(1).uniform(size=(5, 5, 24, 30))

    >>> sliced = refocus.fourier_slice(views, 0.5, width=8)
    >>> np.allclose(sliced, refocus.fourier_refocus(views, 0.5), atol=1e-5)
    True
    """
    weights = as_weights(weights, light_field)
    views, steps = as_views(light_field), as_slopes(slopes)
    if width not in SLICE_WIDTHS:
        raise InputError(f"width must be one of {SLICE_WIDTHS} samples, got {width!r}.")
    _check_edges(edges)
    of_channel = partial(_by_slices, width=width, edges=edges)
    return for_slopes(by_channel(of_channel, views, steps, weights), slopes)


def _by_slices(views, slopes, weights, width: int, edges: str) -> np.ndarray:
    shape, t, s = views.shape[2:], 0, 0
    if edges == "clamp":
        shifts = [centred(count) * slopes[:, None] for count in views.shape[:2]]
        if any(np.abs(x).max() > n for x, n in zip(shifts, shape, strict=True)):
            raise InputError(
                f"With clamped edges, slopes may shift a view by one image size at most, got "
                f"slopes up to {np.abs(slopes).max():g} for {shape[0]} x {shape[1]} lenslets."
            )
        pads = _pads(shape, shifts)
        (t, _), (s, _) = pads
        views = np.pad(views, [(0, 0), (0, 0), *pads], mode="edge")
    rows, columns, height, breadth = views.shape
    spectra = rfft2(views.astype(np.float32, copy=False), workers=get_num_threads())
    spectra *= (weights / weights.mean()).astype(np.float32)[..., None, None]
    spectra[weights == 0] = 0  # not read
    out = np.empty((len(slopes), *spectra.shape[2:]), np.complex64)
    down = _slice_taps(np.fft.fftfreq(height), rows, slopes, width)
    right = _slice_taps(np.fft.rfftfreq(breadth), columns, slopes, width)
    _kernels.slice_spectrum(_angular_spectrum(spectra, width), *down, *right, out)
    _mend_nyquist(spectra, slopes, breadth, out)
    images = irfft2(out, views.shape[2:], workers=get_num_threads())
    images = images[:, t : t + shape[0], s : s + shape[1]]
    refuse_infinite(images, views)
    return np.ascontiguousarray(images)


def _angular_spectrum(spectra: np.ndarray, width: int) -> np.ndarray:
    """Mean over the views, transformed along both angular axes: frequencies [t, s, v, u]."""
    counts = spectra.shape[:2]
    samples = [OVERSAMPLING * n for n in counts]
    roll_off = [
        _window_transform((np.arange(n) - n // 2) / m, width)
        for n, m in zip(counts, samples, strict=True)
    ]
    divisor = (np.outer(*roll_off) * counts[0] * counts[1]).astype(np.float32)
    by_frequency = np.ascontiguousarray((spectra / divisor[..., None, None]).transpose(2, 3, 0, 1))
    return ifft2(by_frequency, samples, norm="forward", overwrite_x=True, workers=get_num_threads())


def _slice_taps(frequencies, views: int, slopes: np.ndarray, width: int):
    """Find the samples around a slice, and their weights: [n, frequency, tap].

    The transform counts views from 0, the window's roll-off from the central view, and the slope
    from the centre, which is half a view off for an even number of views.
    """
    samples, middle = OVERSAMPLING * views, views // 2
    angular = slopes[:, None, None] * frequencies[:, None]  # in cycles per view: [n, frequency, 1]
    sample = np.ceil(angular * samples - width / 2) + np.arange(width)
    phase = angular * (middle - (views - 1) / 2) - sample * (middle / samples)
    weights = _window(angular * samples - sample, width) * np.exp(2j * np.pi * phase)
    return (sample % samples).astype(np.int64), weights.astype(np.complex64)


def _mend_nyquist(spectra, slopes, width: int, out: np.ndarray) -> None:
    """Replace the Nyquist frequencies, of which only the real part is used, by the exact ones."""
    rows, columns, height = spectra.shape[:3]
    down = _phase_factors(np.fft.fftfreq(height), centred(rows) * slopes[:, None])
    right = _phase_factors(np.fft.rfftfreq(width), centred(columns) * slopes[:, None])
    if height % 2 == 0:
        row = slice(height // 2, height // 2 + 1)
        out[:, row] = _mean_by_factors(spectra[:, :, row], down[row], right)
    if width % 2 == 0:
        out[..., -1:] = _mean_by_factors(spectra[..., -1:], down, right[-1:])


def _window(x: np.ndarray, width: int) -> np.ndarray:
    """Kaiser-Bessel window, 0 beyond half its width."""
    return i0(_beta(width) * np.sqrt(np.maximum(1 - (2 * x / width) ** 2, 0)))


def _window_transform(x: np.ndarray, width: int) -> np.ndarray:
    """Fourier transform of the window, inside its main lobe."""
    root = np.sqrt(_beta(width) ** 2 - (np.pi * width * x) ** 2)
    return width * np.sinh(root) / root


def _beta(width: int) -> float:
    """Shape of the window of least error (P. Beatty et al., IEEE Trans. Med. Imag. 24, 2005)."""
    return np.pi * np.sqrt((width / OVERSAMPLING * (OVERSAMPLING - 0.5)) ** 2 - 0.8)
