"""Refocusing by the shift theorem."""

import numpy as np

from lf_flame.footprint import centred
from lf_flame.refocus._arguments import as_slopes, as_views


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
    spectra = np.fft.rfft2(views)
    images = [
        np.fft.irfft2(refocused_spectrum(spectra, s, views.shape[3]), views.shape[2:])
        for s in slopes
    ]
    return np.stack(images).astype(np.float32)


def refocused_spectrum(spectra: np.ndarray, slope: float, width: int) -> np.ndarray:
    """Mean of the views' spectra, each turned by the phase of its shift.

    Parameters
    ----------
    spectra : ndarray of complex, shape (v, u, t, s // 2 + 1)
        ``rfft2`` of the views.
    slope : float
    width : int
        Columns of the views, which `spectra` alone does not tell.

    Returns
    -------
    ndarray of complex, shape (t, s // 2 + 1)
    """
    rows, columns, height = spectra.shape[:3]
    down = np.exp(2j * np.pi * slope * np.outer(centred(rows), np.fft.fftfreq(height)))
    right = np.exp(2j * np.pi * slope * np.outer(centred(columns), np.fft.rfftfreq(width)))
    # A shift by a fraction leaves the Nyquist frequency only its real part, in either axis.
    if height % 2 == 0:
        down[:, height // 2] = down[:, height // 2].real
    if width % 2 == 0:
        right[:, -1] = right[:, -1].real
    row_sums = np.einsum("vuts,us->vts", spectra, right)
    return np.einsum("vts,vt->ts", row_sums, down) / (rows * columns)
