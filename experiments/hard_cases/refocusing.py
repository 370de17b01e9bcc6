"""Slopes, brightness and sharpness at their extremes, and scores of images without error."""

import math
from fractions import Fraction

import numpy as np

from experiments.hard_cases.case import UNIT32, Values, as_exact, hard_case
from lf_flame import InputError
from lf_flame._common.arrays import centred
from lf_flame.learning.scores import psnr, ssim
from lf_flame.refocus import find_sharpest_slope, fourier_refocus, shift_and_sum

SLOPES = np.linspace(-2, 2, 81)

MIDDLE = (12, 36, 12, 36)
"""Region of a planted pattern that the edges do not reach."""


def planted(slope: float, n: int = 48) -> np.ndarray:
    """Draw a smooth pattern between 0 and 1 about 1/2, displaced from view to view by the slope."""
    shifted = np.arange(n) - slope * centred(3)[:, None]
    waves = [(1, 2, 0.3), (3, -2, 1.1), (4, 1, 2.0), (2, 5, 0.7), (-5, 3, 2.6)]
    total = sum(
        np.cos(2 * np.pi * (a * shifted[:, None, :, None] + b * shifted[None, :, None, :]) / n + p)
        for a, b, p in waves
    )
    return 0.5 + total / (2 * len(waves))


def variances(stack: np.ndarray) -> np.ndarray:
    """Compute the variance of each image as ``E[x^2] - E[x]^2``, in the type of the images."""
    stack = stack.reshape(len(stack), -1)
    return np.mean(stack**2, axis=1) - np.mean(stack, axis=1) ** 2


def naive_slope(views: np.ndarray) -> float:
    """Find the slope of the largest variance."""
    return float(SLOPES[variances(fourier_refocus(views, SLOPES)).argmax()])


def found_slope(views: np.ndarray, **options) -> str:
    """Name the slope of sharpest focus, or that there is none."""
    try:
        return f"{find_sharpest_slope(views, **options).slope:.2f}"
    except InputError:
        return "none"


@hard_case(
    "sharpest slope of an image without structure",
    "highest point of the curve",
    "says that no slope is sharpest",
    0.0,
)
def flat_curve() -> Values:
    views = np.full((15, 15, 33, 31), 1 / 3)
    return Values("none", f"{naive_slope(views):.2f}", found_slope(views))


@hard_case(
    "sharpest slope of a pattern below the rounding of its ground",
    "highest point of the curve",
    "says that no slope is sharpest",
    0.0,
)
def below_rounding() -> Values:
    views = 1 + 3e-7 * planted(0.63)
    ours = found_slope(views, slopes=SLOPES, region=MIDDLE)
    return Values("none", f"{naive_slope(views):.2f}", ours)


@hard_case(
    "sharpest slope of a pattern of contrast 1e-3 to 1e-5 on bright ground",
    "float32 E[x^2] - E[x]^2",
    "gradients of scaled pixels",
    0.01,
    20,
)
def faint_pattern() -> Values:
    faint = [1 + contrast * planted(0.63) for contrast in (1e-3, 1e-4, 1e-5)]
    ours = [find_sharpest_slope(views, SLOPES, region=MIDDLE).slope for views in faint]
    return Values(np.full(3, 0.63), [naive_slope(x) for x in faint], ours, scale=1.0)


@hard_case(
    "the same pattern, brightness 2^-100 and 2^127",
    "float32 squares",
    "scaled by powers of two",
    0.01,
    20,
)
def extreme_brightness() -> Values:
    bright = [np.ldexp(planted(0.63).astype(np.float32), k) for k in (-100, 127)]
    ours = [find_sharpest_slope(views, SLOPES, region=MIDDLE).slope for views in bright]
    return Values(np.full(2, 0.63), [naive_slope(x) for x in bright], ours, scale=1.0)


@hard_case(
    "mean of 225 views near the largest float32",
    "float32 sum, divided at the end",
    "weights that add up to 1",
    4 * UNIT32,
)
def bright_views() -> Values:
    value = np.float32(3e38)
    views = np.full((15, 15, 10, 9), value)
    ours = shift_and_sum(views, 0.7)
    obvious = views.sum(axis=(0, 1), dtype=np.float32) / 225
    return Values(np.full(ours.shape, float(value)), obvious, ours)


@hard_case(
    "a constant image, refocused at slopes from 1e-300 to 1e9",
    "dark beyond the edge",
    "edges continued",
    2 * UNIT32,
)
def constant_image() -> Values:
    value = np.float32(0.3)
    views = np.full((5, 5, 12, 11), value)
    slopes = [0.0, 1e-300, -1e-300, 0.37, -2.5, 30.0, 1e9, -1e9]
    padded = np.pad(views, [(0, 0), (0, 0), (30, 30), (30, 30)])
    dark = shift_and_sum(padded, slopes)[:, 30:-30, 30:-30]
    ours = np.array([refocus(views, slopes) for refocus in (shift_and_sum, fourier_refocus)])
    return Values(np.full(ours.shape, float(value)), np.stack([dark] * 2), ours)


@hard_case(
    "slope of 3e9 lenslets a view and more",
    "shift as a 32-bit integer",
    "clamped before it is cast",
    4 * UNIT32,
)
def huge_slope() -> Values:
    views = np.random.default_rng(0).uniform(0.1, 1, size=(1, 3, 4, 20)).astype(np.float32)
    left, middle, right = views[0, 0, :, :1], views[0, 1], views[0, 2, :, -1:]
    exact = (left.astype(float) + middle + right) / 3
    shifts = (3e9 * centred(3)).astype(np.int64).astype(np.int32)
    columns = [np.clip(np.arange(20) + int(k), 0, 19) for k in shifts]
    obvious = sum(views[0, u][:, k] for u, k in enumerate(columns)) / 3
    ours = shift_and_sum(views, [1e9, 3e9, 1e300])
    return Values(np.stack([exact] * 3), np.stack([obvious] * 3), ours)


@hard_case(
    "sum of the phases of three views at slope 0", "sin(N x/2)/sin(x/2)", "added view by view", 1e-6
)
def no_phase() -> Values:
    views = np.random.default_rng(0).uniform(0.1, 1, size=(1, 3, 4, 20)).astype(np.float32)
    exact = views[0].mean(axis=0, dtype=float)
    kernel = np.sin(3 * np.float64(0.0)) / np.sin(np.float64(0.0)) / 3
    slopes = [0.0, 1e-300, -1e-300]
    ours = np.array([refocus(views, slopes) for refocus in (shift_and_sum, fourier_refocus)])
    return Values(np.broadcast_to(exact, ours.shape), kernel * np.ones_like(ours) * exact, ours)


def flat(value: float) -> np.ndarray:
    """Make an image of one value."""
    return np.full((16, 20), value, np.float32)


@hard_case(
    "PSNR of images that differ in the last digit, in dB",
    "E[a^2] + E[b^2] - 2 E[a b]",
    "mean of squared differences",
    1e-5,
)
def nearly_equal_images() -> Values:
    truth = np.random.default_rng(0).uniform(0.5, 0.9, size=(16, 20)).astype(np.float32)
    exact, obvious, ours = [], [], []
    for difference in (1e-3, 1e-6, UNIT32):
        image = truth.copy()
        image.ravel()[::10] += np.float32(difference)
        square = np.mean((as_exact(truth.astype(float)) - as_exact(image.astype(float))) ** 2)
        exact.append(-10 * (math.log10(square.numerator) - math.log10(square.denominator)))
        naive = np.mean(truth**2) + np.mean(image**2) - 2 * np.mean(truth * image)
        obvious.append(-10 * np.log10(naive))
        ours.append(psnr(truth, image))
    return Values(np.array(exact), obvious, ours, scale=1.0)


@hard_case("PSNR of equal images, in dB", "MSE + 1e-10", "infinity", 0.0)
def equal_images() -> Values:
    image = flat(0.3)
    obvious = -10 * np.log10(np.mean((image - image) ** 2) + 1e-10)
    return Values(math.inf, obvious, psnr(image, image))


@hard_case("PSNR of black against white, in dB", "difference of 8 bits", "floats", 0.0)
def black_against_white() -> Values:
    black, white = np.zeros((16, 20), np.uint8), np.full((16, 20), 255, np.uint8)
    obvious = 10 * np.log10(255**2 / np.mean((black - white) ** 2))
    return Values(0.0, obvious, psnr(flat(0), flat(1)), scale=1.0)


@hard_case("SSIM of constant images", "quality index without constants", "luminance term", 1e-6)
def constant_images() -> Values:
    pairs = [(0, 0), (1, 1), (0, 1), (0.5, 0.5), (0.4, 0.5), (1e-30, 0), (1, 1 - UNIT32)]
    exact, obvious, ours = [], [], []
    for one, other in pairs:
        a, b = flat(one), flat(other)
        p, q, k = (*(Fraction(float(x[0, 0])) for x in (a, b)), Fraction(1, 100) ** 2)
        exact.append((2 * p * q + k) / (p * p + q * q + k))
        means, covariance = np.array([a.mean(), b.mean()]), np.cov(a.ravel(), b.ravel())
        luminance = 2 * means.prod() / np.sum(means**2)
        obvious.append(luminance * 2 * covariance[0, 1] / np.trace(covariance))
        ours.append(ssim(a, b))
    return Values(np.array(exact), obvious, ours, scale=1.0)
