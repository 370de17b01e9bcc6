"""Each program's published definition, written out plainly, gives the same picture."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from lf_flame import PAPER_CAMERA
from lf_flame.optics.slope_conventions import CONVENTIONS, to_slope
from lf_flame.refocus import fourier_refocus, shift_and_sum

N = 5


def read_at(views, offsets):
    """Mean of the views, each read at its offset (down, right) from the pixel, edges repeated."""
    t, s = np.indices(views.shape[2:], dtype=float)
    return np.mean(
        [
            map_coordinates(views[v, u], [t + offsets[v], s + offsets[u]], order=1, mode="nearest")
            for v, u in np.ndindex(views.shape[:2])
        ],
        axis=0,
    )


def moved_by(views, motions):
    """Mean of the views, each moved by (down, right), edges repeated."""
    return read_at(views, -motions)


CENTRED = np.arange(N) - (N - 1) / 2
PUBLISHED = {
    "motion": lambda views, d: read_at(views, d * CENTRED),
    "hci": lambda views, d: read_at(views, -d * CENTRED),
    "lftoolbox": lambda views, d: read_at(views, np.linspace(-0.5, 0.5, N) * d * N),
    "liff": lambda views, d: read_at(views, d * CENTRED),
    "plenopticam": lambda views, d: moved_by(views, d * CENTRED),
    "plenopticam-refined": lambda views, d: moved_by(views, d * CENTRED / N),
    "plenpy": lambda views, d: moved_by(views, d * N / (N - 1) * CENTRED),
    "fdl": lambda views, d: moved_by(views, d * CENTRED),
}


@pytest.mark.parametrize("name", CONVENTIONS)
@pytest.mark.parametrize("number", [2.0, -0.7])
def test_same_picture_as_the_published_definition(name, number, rng):
    views = rng.uniform(size=(N, N, 14, 17))
    slope = to_slope(number, name, views=N)
    expected = PUBLISHED[name](views, number)
    np.testing.assert_allclose(shift_and_sum(views, slope), expected, atol=1e-6)


def test_plenopticam_enlarges_before_it_shifts(rng):
    """Whole shifts of views enlarged N times, on the pixels that the enlarging kept."""
    views, a = rng.uniform(size=(3, 3, 12, 12)), 2
    fine = np.arange(12 * 3) / 3
    total = np.zeros((36, 36))
    for v, u in np.ndindex(3, 3):
        large = map_coordinates(
            views[v, u], np.meshgrid(fine, fine, indexing="ij"), order=1, mode="nearest"
        )
        total += np.roll(large, (a * (v - 1), a * (u - 1)), axis=(0, 1))
    slope = to_slope(a, "plenopticam-refined", views=3)
    found = shift_and_sum(views, slope)
    np.testing.assert_allclose(found[2:-2, 2:-2], total[::3, ::3][2:-2, 2:-2] / 9, atol=1e-6)


def test_disparity_layers_turn_spectra(rng):
    """refocusFFT: the mean of the spectra times exp(-2 i pi d (wx U + wy V)), y and V upward."""
    views, d = rng.uniform(size=(N, N, 15, 17)), 0.8
    right, up = np.fft.fftfreq(17), -np.fft.fftfreq(15)[:, None]
    total = np.zeros((15, 17), complex)
    for v, u in np.ndindex(N, N):
        turn = np.exp(-2j * np.pi * d * (right * CENTRED[u] + up * -CENTRED[v]))
        total += np.fft.fft2(views[v, u]) * turn
    found = fourier_refocus(views, to_slope(d, "fdl"))
    np.testing.assert_allclose(found, np.fft.ifft2(total / N**2).real, atol=1e-6)


def test_a_nearer_object_has_a_positive_benchmark_disparity():
    """The slope is positive behind the focal plane, the disparity before it."""
    assert PAPER_CAMERA.slope_to_depth(to_slope(0.5, "hci")) < 0
