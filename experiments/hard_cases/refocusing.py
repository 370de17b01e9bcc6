"""Slopes, brightness and sharpness at their extremes."""

import numpy as np

from experiments.hard_cases.report import UNIT32, Values, hard_case
from lf_flame._common.arrays import centred
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


def naive_slope(views: np.ndarray) -> float:
    """Find the slope of the largest variance, ``E[x^2] - E[x]^2`` in the type of the images."""
    stack = fourier_refocus(views, SLOPES).reshape(len(SLOPES), -1)
    return float(SLOPES[(np.mean(stack**2, axis=1) - np.mean(stack, axis=1) ** 2).argmax()])


@hard_case(
    "sharpest slope at contrast 1e-3 to 1e-5, or brightness 2^-100 to 2^127",
    "float32 E[x^2] - E[x]^2",
    "gradients of pixels scaled by powers of 2",
    0.01,
    20,
)
def faint_or_bright_pattern() -> Values:
    seen = [1 + contrast * planted(0.63) for contrast in (1e-3, 1e-4, 1e-5)]
    seen += [np.ldexp(planted(0.63).astype(np.float32), k) for k in (-100, -90, 90, 127)]
    ours = [find_sharpest_slope(views, SLOPES, region=MIDDLE).slope for views in seen]
    return Values(np.full(len(seen), 0.63), [naive_slope(x) for x in seen], ours, scale=1.0)


@hard_case(
    "mean of 10,000 views of brightness 1e-30 to 3e38",
    "float32 sum, divided at the end",
    "weights that add up to 1",
    4 * UNIT32,
)
def bright_views() -> Values:
    one = np.random.default_rng(1).uniform(0.1, 1, size=(100, 100, 4, 3)).astype(np.float32)
    exact, obvious, ours = [], [], []
    for brightness in (1e-30, 1e30, 3e38):
        views = (one.astype(float) * brightness).astype(np.float32)
        for refocus in (shift_and_sum, fourier_refocus):
            exact.append(views.mean(axis=(0, 1), dtype=float))
            obvious.append(views.sum(axis=(0, 1), dtype=np.float32) / 10_000)
            ours.append(refocus(views, 0.0))
    return Values(np.array(exact), np.array(obvious), np.array(ours))


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
