"""Diffraction at an aperture: the blur of an incoherent image, as weights on its samples.

The line and point spreads are those of the square and the round pupil in focus (J. W. Goodman,
Introduction to Fourier Optics, 3rd ed., section 6.3). A sample is the mean over a box, and the
image is taken as constant over each box. A weight is therefore the spread averaged over one box and
summed over another, that is, over a triangle (hat) two samples wide. Such weights are never
negative and, untruncated, sum to 1 for any spread, however small compared with a sample.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import scipy  # its parts load when they are used
from numpy.typing import ArrayLike

from lf_flame.errors import InputError

MOST_SAMPLES = 512
"""Largest half-width of the kernel of a square aperture, in samples."""

MOST_ROUND_SAMPLES = 32
"""Largest half-width of the kernel of a round aperture, in samples."""

RINGS = 64
"""Number of rings of the Airy pattern that are resolved. Farther out, the light outside a radius
differs from its trend by less than 1e-5, which changes a weight by less than 1e-8."""

NODES = 12
"""Number of Gauss-Legendre nodes in each panel; no panel holds more than one resolved ring."""

ROWS_AT_ONCE = 256
"""Number of rows held as float64 at a time when a two-dimensional kernel is applied."""


def square_kernel(spread_mm: float, sample_mm: float, tail: float) -> np.ndarray:
    """Weights along one axis for a square aperture: line spread ``sinc^2(x / spread) / spread``.

    Its transfer function is the triangle ``1 - |frequency| * spread``. The weights are second
    differences of the twice integrated line spread, which has a closed form.

    Parameters
    ----------
    spread_mm : float
        Wavelength times distance over the width of the aperture, in mm: the distance from the
        centre to the first dark line. 0 to MOST_SAMPLES samples.
    sample_mm : float
        Width of a sample, above 0.
    tail : float
        Largest fraction of the light that the kernel may leave out, 0 to 1. The kernel is as short
        as that allows, with at most MOST_SAMPLES on each side even if that leaves out more.

    Returns
    -------
    ndarray of float64, shape (odd,)
        Symmetric weights, 0 or above, with sum 1.

    Raises
    ------
    InputError
        If a value is out of range; the message names it.
    """
    ratio = _samples_per_spread(spread_mm, sample_mm, tail, MOST_SAMPLES)
    if ratio == 0:
        return np.ones(1)
    twice = ratio * _sinc2_twice_integrated(np.arange(MOST_SAMPLES + 2) / ratio)
    weights = np.concatenate([[2 * twice[1]], np.diff(twice, 2)]).clip(0)
    left_out = 1 - (2 * np.cumsum(weights) - weights[0])
    half = _shortest(left_out, tail)
    kernel = np.concatenate([weights[half:0:-1], weights[: half + 1]])
    return kernel / kernel.sum()


def round_kernel(spread_mm: float, sample_mm: float, tail: float) -> np.ndarray:
    """Weights on a square grid for a round aperture: the Airy pattern.

    Its transfer function is ``2/pi (arccos q - q sqrt(1 - q^2))`` with ``q = |frequency| *
    spread``; the light outside a radius r is ``J0(v)^2 + J1(v)^2`` with ``v = pi r / spread``
    (Rayleigh; Born & Wolf, Principles of Optics, section 8.5.2).

    Parameters
    ----------
    spread_mm : float
        Wavelength times distance over the diameter of the aperture, in mm; the first dark ring
        has 1.22 times this radius. 0 to MOST_ROUND_SAMPLES samples.
    sample_mm : float
        Side of a sample, above 0.
    tail : float
        Largest fraction of the light that the kernel may leave out, 0 to 1. The kernel is as small
        as that allows, with at most MOST_ROUND_SAMPLES on each side even if that leaves out more.

    Returns
    -------
    ndarray of float64, shape (odd, odd)
        Symmetric weights, 0 or above, with sum 1.

    Raises
    ------
    InputError
        If a value is out of range; the message names it.
    """
    ratio = _samples_per_spread(spread_mm, sample_mm, tail, MOST_ROUND_SAMPLES)
    if ratio == 0:
        return np.ones((1, 1))
    weights = _airy_shares(ratio, MOST_ROUND_SAMPLES).clip(0)
    copies = np.where(np.arange(len(weights)) == 0, 1, 2)
    inside = (weights * copies[:, None] * copies).cumsum(axis=0).cumsum(axis=1).diagonal()
    half = _shortest(1 - inside, tail)
    mirrored = np.abs(np.arange(-half, half + 1))
    kernel = weights[np.ix_(mirrored, mirrored)]
    return kernel / kernel.sum()


def blur_raw(raw: ArrayLike, kernel: np.ndarray) -> np.ndarray:
    """Blur a raw image; its outermost pixels continue beyond the border.

    Parameters
    ----------
    raw : array_like, shape (y, x)
    kernel : ndarray, shape (odd,) or (odd, odd)
        Weights with sum 1. One axis is applied along the columns and along the rows.

    Returns
    -------
    ndarray of float32, shape (y, x)

    Raises
    ------
    InputError
        If the image or the kernel has another shape.
    """
    raw, kernel = np.asarray(raw, np.float32), np.asarray(kernel, np.float64)
    if raw.ndim != 2 or raw.size == 0:
        raise InputError(f"A raw image to blur needs shape (y, x), got {raw.shape}.")
    if kernel.ndim not in (1, 2) or any(n % 2 == 0 for n in kernel.shape):
        raise InputError(f"A kernel needs one or two axes of odd length, got {kernel.shape}.")
    if kernel.ndim == 2:
        return _blur_in_two_dimensions(raw, kernel)
    along = scipy.ndimage.convolve1d(raw, kernel, axis=0, output=np.float32, mode="nearest")
    return scipy.ndimage.convolve1d(along, kernel, axis=1, output=np.float32, mode="nearest")


def blur_views(views: ArrayLike, kernel: np.ndarray) -> np.ndarray:
    """Blur each sub-aperture view like `blur_raw`; its outermost pixels continue outside.

    Parameters
    ----------
    views : array_like, shape (v, u, t, s)
    kernel : ndarray, shape (odd,) or (odd, odd)
        Weights with sum 1; one axis is applied along both.

    Returns
    -------
    ndarray of float32, shape (v, u, t, s)

    Raises
    ------
    InputError
        If the array or the kernel has another shape.
    """
    views = np.asarray(views, np.float32)
    if views.ndim != 4:
        raise InputError(f"Views to blur need shape (v, u, t, s), got {views.shape}.")
    out = np.empty(views.shape, np.float32)
    for view in np.ndindex(views.shape[:2]):
        out[view] = blur_raw(views[view], kernel)
    return out


def share_leaving_square(spread_mm: float, side_mm: float, round_aperture: bool) -> float:
    """Fraction of the light of a uniformly lit square that diffraction moves out of it.

    It bounds the change of the mean over the square, relative to the range of the light: the loss
    if all is bright inside and dark outside.

    Parameters
    ----------
    spread_mm : float
        Wavelength times distance over the aperture's width, in mm, 0 or above.
    side_mm : float
        Side of the square in mm, above 0.
    round_aperture : bool
        Whether the aperture is round; otherwise square.
    """
    ratio = _samples_per_spread(spread_mm, side_mm, 0, math.inf)
    if ratio == 0:
        return 0.0
    if round_aperture:
        return 1 - float(_airy_shares(ratio, 0)[0, 0])
    return 1 - float(2 * ratio * _sinc2_twice_integrated(np.array([0, 1 / ratio]))[1]) ** 2


def _samples_per_spread(spread_mm: float, sample_mm: float, tail: float, most: float) -> float:
    """Spread in samples; 0 where float64 cannot distinguish the kernel from a point."""
    if not (math.isfinite(sample_mm) and sample_mm > 0):
        raise InputError(f"sample_mm must be a positive, finite length in mm, got {sample_mm}.")
    if not 0 <= spread_mm <= most * sample_mm:
        raise InputError(
            f"spread_mm must be 0 to {most * sample_mm:.6g} ({most} samples) for the kernel to "
            f"reach the first dark line, got {spread_mm}."
        )
    if not 0 <= tail <= 1:
        raise InputError(f"tail must be a share of the light, 0 to 1, got {tail}.")
    ratio = spread_mm / sample_mm
    return ratio if ratio > np.finfo(float).eps else 0.0


def _shortest(left_out: np.ndarray, tail: float) -> int:
    """First index that leaves out at most `tail`, else the last one."""
    enough = np.flatnonzero(left_out <= tail)
    return int(enough[0]) if enough.size else len(left_out) - 1


def _sinc2_twice_integrated(t: np.ndarray) -> np.ndarray:
    """Integrate sinc^2 twice from 0 to each t; the first t is 0."""
    z = 2 * np.pi * t[1:]
    si, ci = scipy.special.sici(z)
    cin = np.euler_gamma + np.log(z) - ci
    rest = t[1:] * si / np.pi - (np.sin(z / 2) / np.pi) ** 2 - cin / (2 * np.pi**2)
    return np.concatenate([[0], rest])


def _airy_shares(ratio: float, half: int) -> np.ndarray:
    """Fraction of the Airy pattern under the hat at each sample of a quadrant.

    With ``A(r)`` the mean of a hat over the circle of radius r, the fraction is the integral of A
    over the enclosed light. By parts it is ``A(0)`` plus the integral of ``A'(r)`` times the light
    outside r, which hardly oscillates.

    Returns
    -------
    ndarray of float64, shape (half + 1, half + 1)
    """
    sums = np.zeros((half + 3, half + 3))
    for low, high in pairwise(_panel_edges(ratio, half + 1)):
        r, weight = _panel_nodes(low, high)
        weighted = weight * _light_outside(r / ratio)
        sums += np.tensordot(weighted, _corner_slopes(r, half), axes=1)
    shares = np.diff(np.diff(sums, 2, axis=0), 2, axis=1) / (2 * np.pi)
    shares[0] *= 2  # a hat on an axis lies in two quadrants, the central one in four
    shares[:, 0] *= 2
    shares[0, 0] += 1
    return shares


def _panel_edges(ratio: float, reach: int) -> np.ndarray:
    """Radii between which the integrand is smooth: of samples, of rings, then doubling."""
    lattice = np.arange(reach + 1)
    corners = np.sqrt(np.unique(lattice[:, None] ** 2 + lattice**2))
    rings = ratio * np.arange(RINGS + 1)
    doublings = max(0, math.ceil(math.log2(corners[-1] / rings[-1])))
    far = rings[-1] * 2.0 ** np.arange(1, doublings + 1)
    edges = np.unique(np.concatenate([corners, rings, far]))
    return edges[edges <= corners[-1]]


def _panel_nodes(low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights on a panel, in the square root of the distance from its lower edge.

    The chord that a circle cuts off a grid line grows as that root once the two touch.
    """
    x, weight = np.polynomial.legendre.leggauss(NODES)
    t = (1 + x) / 2
    return low + (high - low) * t**2, (high - low) * t * weight


def _light_outside(r: np.ndarray) -> np.ndarray:
    """Fraction of the Airy pattern outside a radius in spreads; its trend beyond RINGS."""
    v = np.pi * r
    return np.where(r > RINGS, 2 / (np.pi * v), scipy.special.j0(v) ** 2 + scipy.special.j1(v) ** 2)


def _corner_slopes(r: np.ndarray, half: int) -> np.ndarray:
    """Slopes in r of the integral of ``(x - m)+ (y - n)+`` over a quarter of a circle.

    Second differences in m and n, from -1 to half + 1, turn these corners into hats.

    Returns
    -------
    ndarray of float64, shape (len(r), half + 3, half + 3)
    """
    corner, r = np.arange(-1, half + 2), r[:, None]
    start = np.maximum(corner, 0)
    near = start / r
    far = np.sqrt(np.maximum((r - start) * (r + start), 0)) / r
    # the arc runs from sin = n / r to cos = m / r; `near` holds these, `far` the other function
    lit = 1 - near[:, :, None] ** 2 - near[:, None, :] ** 2
    along = corner[:, None] * (near[:, :, None] - far[:, None, :])
    slopes = r[:, :, None] * lit + along + along.swapaxes(1, 2)
    return np.where(lit > 0, slopes, 0)


def _blur_in_two_dimensions(image: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    out = np.empty_like(image)
    above, aside = (n // 2 for n in kernel.shape)
    for low in range(0, len(image), ROWS_AT_ONCE):
        rows = np.arange(low - above, min(low + ROWS_AT_ONCE, len(image)) + above)
        slab = image[rows.clip(0, len(image) - 1)].astype(np.float64)
        padded = np.pad(slab, ((0, 0), (aside, aside)), "edge")
        blurred = scipy.signal.oaconvolve(padded, kernel, "valid")
        # rounding of the Fourier transform must not make dark pixels negative
        out[low : low + ROWS_AT_ONCE] = blurred.clip(slab.min(), slab.max())
    return out
