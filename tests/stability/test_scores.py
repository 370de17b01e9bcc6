"""Scores of images without structure and of images without error.

Truth is rational arithmetic on the same pixels. Each test also runs the formula that suggests
itself, `naive` here, and shows that it fails what ours passes. A warning fails any test.
"""

import math
from fractions import Fraction

import numpy as np
import pytest

from lf_flame._common.metrics import psnr, ssim
from lf_flame.learning.scoring import score

UNIT32 = 2.0**-24
"""Unit roundoff of float32, in which the images are stored."""

K1_SQUARED, K2_SQUARED = Fraction(1, 100) ** 2, Fraction(3, 100) ** 2

as_exact = np.frompyfunc(Fraction, 1, 1)


def flat(value):
    return np.full((16, 20), value, np.float32)


def exact_psnr(truth, image):
    """10 log10(1 / MSE), the mean square in rational arithmetic."""
    difference = as_exact(truth.astype(float)) - as_exact(image.astype(float))
    mean_square = sum((difference**2).ravel()) / difference.size
    return -10 * (math.log10(mean_square.numerator) - math.log10(mean_square.denominator))


def naive_psnr(truth, image):
    """Mean square as ``E[a^2] + E[b^2] - 2 E[a b]``, which needs one pass over the images."""
    with np.errstate(divide="ignore", invalid="ignore"):
        mean_square = np.mean(truth**2) + np.mean(image**2) - 2 * np.mean(truth * image)
        return -10 * np.log10(mean_square)


def windowed_ssim(truth, image, c1=float(K1_SQUARED), c2=float(K2_SQUARED)):
    """SSIM as defined, with variances about each window's own mean; naive without constants."""
    weights = np.exp(-(np.arange(-5, 6) ** 2) / (2 * 1.5**2))
    weights = np.outer(weights, weights) / weights.sum() ** 2
    a, b = (np.lib.stride_tricks.sliding_window_view(x.astype(float), (11, 11)).reshape(-1, 121)
            for x in (truth, image))  # fmt: skip
    w = weights.ravel()
    mean_a, mean_b = a @ w, b @ w
    a, b = a - mean_a[:, None], b - mean_b[:, None]
    luminance = (2 * mean_a * mean_b + c1) / (mean_a**2 + mean_b**2 + c1)
    with np.errstate(invalid="ignore"):
        structure = (2 * (a * b) @ w + c2) / ((a**2 + b**2) @ w + c2)
    return (luminance * structure).mean()


@pytest.mark.parametrize(
    ("a", "b"), [(0, 0), (1, 1), (0, 1), (0.5, 0.5), (0.4, 0.5), (1e-30, 0), (1, 1 - UNIT32)]
)
def test_ssim_of_constant_images_is_their_luminance_term(a, b):
    """Black, saturated, grey: (2 a b + K1^2) / (a^2 + b^2 + K1^2).

    Naive: the quality index without K1 and K2; its structure is 0 / 0, or 0 over rounding.
    """
    images = flat(a), flat(b)
    exact_a, exact_b = (Fraction(float(image[0, 0])) for image in images)
    truth = (2 * exact_a * exact_b + K1_SQUARED) / (exact_a**2 + exact_b**2 + K1_SQUARED)
    allowed = 1e-6
    assert abs(ssim(*images) - float(truth)) <= allowed
    with np.errstate(divide="ignore", invalid="ignore"):
        naive = windowed_ssim(*images, c1=0, c2=0)
    assert not abs(naive - float(truth)) <= 1e3 * allowed


def test_ssim_of_saturated_images_is_finite(rng):
    """Flames clipped to white on black. Naive: windows without structure are 0 / 0."""
    scene = np.zeros((40, 40), np.float32)
    scene[20:, 15:] = rng.uniform(0.5, 3, size=(20, 25))
    truth, image = np.minimum(scene, 1), np.minimum(0.8 * scene, 1)
    allowed = 1e-6
    assert abs(ssim(truth, image) - windowed_ssim(truth, image)) <= allowed
    with np.errstate(invalid="ignore"):
        naive = windowed_ssim(truth, image, c1=0, c2=0)
    assert np.isnan(naive)


def test_psnr_of_equal_images_is_infinite(rng):
    """Naive: keep the logarithm finite by 1e-10 under the bar; it ends at 100 dB."""
    for image in (flat(0), flat(1), flat(0.3), rng.uniform(size=(16, 20)).astype(np.float32)):
        assert psnr(image, image) == np.inf
        naive = -10 * np.log10(np.mean((image - image) ** 2) + 1e-10)
        assert naive == pytest.approx(100)


@pytest.mark.parametrize("difference", [1e-3, 1e-6, UNIT32])
def test_psnr_of_nearly_equal_images_keeps_its_digits(difference, rng):
    """Down to the last digit of one pixel in ten. Naive: the expanded mean square cancels."""
    truth = rng.uniform(0.5, 0.9, size=(16, 20)).astype(np.float32)
    image = truth.copy()
    image.ravel()[::10] += np.float32(difference)
    expected = exact_psnr(truth, image)
    allowed = 1e-5  # dB
    assert abs(psnr(truth, image) - expected) <= allowed
    assert not abs(naive_psnr(truth, image) - expected) <= 1e3 * allowed


def test_psnr_of_black_against_white_is_0_db():
    """Naive, for pixels of 8 bits: their difference comes around to 1, 48 dB too good."""
    assert psnr(flat(0), flat(1)) == 0
    black, white = np.zeros((16, 20), np.uint8), np.full((16, 20), 255, np.uint8)
    naive = 10 * np.log10(255**2 / np.mean((black - white) ** 2))
    assert naive > 48


def test_table_of_equal_images_has_no_nan(rng):
    """Infinite PSNR of some or all samples. Naive: their spread is infinity less infinity."""
    targets = rng.uniform(size=(3, 4, 16, 20)).astype(np.float32)
    predictions = targets.copy()
    predictions[1:, 1] *= 0.9  # one sample of three is equal
    predictions[:, 2] *= 0.9
    targets[:, 3] = predictions[:, 3] = 0
    table = score(targets, predictions)
    lit = ["psnr_foreground_db", "psnr_foreground_sd"]
    assert not table.drop(columns=lit).isna().any(axis=None)
    assert list(table[lit].isna().any(axis=1)) == [False, False, False, True]  # black: none is lit
    assert list(np.isinf(table.psnr_db)) == [True, True, False, True]
    assert list(table.psnr_sd[[0, 1, 3]]) == [0, np.inf, 0]
    assert 0 < table.psnr_sd[2] < 1
    assert list(table.ssim[[0, 3]]) == [1, 1]
    two = score(targets[:2], predictions[:2])
    assert list(two.psnr_sd[:2]) == [0, np.inf]
    with np.errstate(invalid="ignore"):
        naive = np.std([np.inf] * 3, ddof=1)
    assert np.isnan(naive)
