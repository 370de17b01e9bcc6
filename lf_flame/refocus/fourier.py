"""Refocusing by the shift theorem."""

import numpy as np

from lf_flame.footprint import centred
from lf_flame.refocus._arguments import as_slopes, as_views

SLOPES_AT_ONCE = 16
"""Slopes whose row sums are held in memory together."""


def fourier_refocus(views, slopes) -> np.ndarray:
    """Refocus by the shift theorem: exact shifts of band-limited, periodic views.

    Each view's spectrum is multiplied by the phase of its shift, the sum is transformed back.
    Nothing is interpolated, so nothing is softened; light that leaves at one edge comes back at
    the other.

    Parameters
    ----------
    views : LightField or array_like, shape (v, u, t, s) or (v, u, t, s, channels)
    slopes : float or sequence of float

    Returns
    -------
    ndarray of float32, shape (n, t, s) or (n, t, s, channels)

    Raises
    ------
    InputError
        If views or slopes cannot be used.
    """
    views, slopes = as_views(views), as_slopes(slopes)
    if views.ndim == 5:
        channels = [fourier_refocus(views[..., c], slopes) for c in range(views.shape[4])]
        return np.stack(channels, axis=-1)
    spectra = np.fft.rfft2(views.astype(np.float64))
    stacks = refocused_spectra(spectra, slopes, views.shape[3])
    return np.fft.irfft2(stacks, views.shape[2:]).astype(np.float32)


def refocused_spectra(spectra: np.ndarray, slopes: np.ndarray, width: int) -> np.ndarray:
    """Mean of the views' spectra, each turned by the phase of its shift, for several slopes.

    Parameters
    ----------
    spectra : ndarray of complex, shape (v, u, t, s // 2 + 1)
        ``rfft2`` of the views.
    slopes : ndarray of float, shape (n,)
    width : int
        Columns of the views, which `spectra` alone does not tell.

    Returns
    -------
    ndarray of complex, shape (n, t, s // 2 + 1), of the type of `spectra`
    """
    rows, columns, height, waves = spectra.shape
    # The sum over u is one matrix product per spatial frequency: [v t, u] @ [u, n].
    by_wave = np.ascontiguousarray(spectra.transpose(3, 0, 2, 1)).reshape(waves, -1, columns)
    out = np.empty((len(slopes), height, waves), spectra.dtype)
    for first in range(0, len(slopes), SLOPES_AT_ONCE):
        some = slopes[first : first + SLOPES_AT_ONCE]
        right = _phases(np.fft.rfftfreq(width), columns, some, width).astype(spectra.dtype)
        down = _phases(np.fft.fftfreq(height), rows, some, height).astype(spectra.dtype)
        row_sums = (by_wave @ right).reshape(waves, rows, height, len(some))
        total = np.einsum("svtn,tvn->nts", row_sums, down)
        out[first : first + len(some)] = total / (rows * columns)
    return out


def _phases(frequencies, views: int, slopes: np.ndarray, length: int) -> np.ndarray:
    """Phase of each view's shift at each slope, shape (frequencies, views, slopes)."""
    shifts = centred(views)[:, None] * slopes
    phases = np.exp(2j * np.pi * frequencies[:, None, None] * shifts)
    if length % 2 == 0:
        # A shift by a fraction leaves the Nyquist frequency only its real part.
        phases[length // 2] = phases[length // 2].real
    return phases
