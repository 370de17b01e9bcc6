"""Numerics of learning: nearly equal scenes, steps behind the sigmoid, few bits, first steps."""

from fractions import Fraction

import numpy as np
from scipy.special import expit, logit

from experiments.hard_cases.case import UNIT, Values, as_exact, hard_case
from lf_flame.learning.ridge import Regression, gather_products, ridge_regression
from lf_flame.learning.sigmoid_regression import refine

SAMPLES, FEATURES = 12, 4


def solve(matrix: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Solve in rational arithmetic, by elimination."""
    rows = np.hstack([matrix, sides])
    for k in range(len(rows)):
        rows[k] = rows[k] / rows[k, k]
        for other in range(len(rows)):
            if other != k:
                rows[other] = rows[other] - rows[other, k] * rows[k]
    return rows[:, len(rows):]  # fmt: skip


def alike(difference: float) -> tuple[np.ndarray, np.ndarray]:
    """Draw features about 1 of scenes that hardly differ, and their images, which do."""
    rng = np.random.default_rng(3)
    features = (1 + difference * rng.uniform(-1, 1, (SAMPLES, FEATURES))).astype(np.float32)
    images = expit((features - 1.0) @ rng.normal(size=(FEATURES, 5)) * 2 / difference)
    return features, images.astype(np.float32)


def regress(difference: float) -> tuple[np.ndarray, np.ndarray, Regression]:
    """Give features, their logits and their regression by the package."""
    features, images = alike(difference)
    found = ridge_regression(gather_products(features), images, (features, images))
    return features, logit(np.clip(images.astype(float), 1e-3, 1 - 1e-3)), found


@hard_case(
    "ridge regression on scenes that differ by 1e-3, logits",
    "float32 normal equations with a column of ones",
    "axes of the centred inner products",
    1e-3,
    100,
)
def nearly_equal_scenes() -> Values:
    features, logits, found = regress(1e-3)
    x, y = as_exact(features.astype(float)), as_exact(logits)
    about = x - x.sum(axis=0) / SAMPLES
    strength = Fraction(found.strength) * np.sum(about**2) / SAMPLES
    weights = solve(about.T @ about + strength * as_exact(np.eye(FEATURES)),
                    about.T @ (y - y.sum(axis=0) / SAMPLES))  # fmt: skip
    exact = about @ weights + y.sum(axis=0) / SAMPLES
    ones = np.column_stack([features, np.ones(SAMPLES, np.float32)])
    damped = ones.T @ ones + np.float32(strength) * np.diag([1.0] * FEATURES + [0.0])
    normal = np.linalg.solve(damped.astype(np.float32), ones.T @ logits.astype(np.float32))
    ours = (features - found.mean) @ found.weights() + found.offset
    return Values(exact, ones @ normal, ours, scale=1.0)


def bits(difference: float, few) -> Values:
    """Compare a layer in float32, and with its weights or all numbers in few bits."""
    features, _, found = regress(difference)
    exact = (features - found.mean).astype(float) @ found.weights().astype(float) + found.offset
    ours = (features - found.mean) @ found.weights() + found.offset
    return Values(exact, few(features, found), ours, scale=1.0)


@hard_case(
    "a dense layer on features about 1 that differ by 0.01, in 8 bits, logits",
    "int8 weights by channel, int8 features by sample",
    "float32, the mean taken off first",
    1e-5,
)
def eight_bits() -> Values:
    def int8(features: np.ndarray, found: Regression) -> np.ndarray:
        weights = found.weights()
        by_channel = np.abs(weights).max(axis=0) / 127
        by_sample = np.abs(features).max(axis=1, keepdims=True) / 127
        product = np.rint(features / by_sample) @ np.rint(weights / by_channel)
        return product * by_sample * by_channel - found.mean @ weights + found.offset

    return bits(1e-2, int8)


@hard_case(
    "the same layer in 16 bits", "float16 throughout", "float32, the mean taken off first", 1e-5
)
def sixteen_bits() -> Values:
    def half(features: np.ndarray, found: Regression) -> np.ndarray:
        weights, mean = found.weights().astype(np.float16), found.mean.astype(np.float16)
        offset = found.offset.astype(np.float16) - mean @ weights
        return features.astype(np.float16) @ weights + offset

    return bits(1e-2, half)


@hard_case(
    "least squares behind a sigmoid, from a start far off",
    "Gauss-Newton steps",
    "damped; no step that raises the error",
    1e-4,
)
def behind_the_sigmoid() -> Values:
    numbers = np.linspace(-2, 2, 41)[:, None]
    exact, start = np.array([1.0, 0.5]), np.array([5.0, 4.0])
    known = np.column_stack([numbers, np.ones(len(numbers))])
    images = expit(known @ exact)
    obvious = start.copy()
    for _ in range(30):
        drawn = expit(known @ obvious)
        jacobian = (drawn * (1 - drawn))[:, None] * known
        normal = jacobian.T @ jacobian
        if not np.linalg.cond(normal) < 1 / UNIT:
            obvious[:] = np.nan
            break
        obvious += np.linalg.solve(normal, jacobian.T @ (images - drawn))
    drawings, offset = refine(numbers, images[:, None], start[:1, None], start[1:], steps=30)
    return Values(exact, obvious, np.array([drawings[0, 0], offset[0]]), scale=1.0)


@hard_case(
    "Adam's first ten steps", "running means that begin at 0", "bias corrected in float64", 1e-5
)
def first_steps() -> Values:
    from lf_flame.learning.array_training import ArrayAdam

    rate, exact, obvious, parameter = 1e-4, [], [], [np.zeros(1, np.float32)]
    adam, ours = ArrayAdam(rate, parameter), []
    corrected = plain = mean = square = 0.0
    for step in range(1, 11):
        gradient = 1.0 + 0.1 * step
        mean, square = 0.9 * mean + 0.1 * gradient, 0.999 * square + 0.001 * gradient**2
        plain -= rate * mean / (np.sqrt(square) + 1e-7)
        correction = np.sqrt(1 - 0.999**step) / (1 - 0.9**step)
        corrected -= rate * correction * mean / (np.sqrt(square) + 1e-7)
        adam.update(parameter, [np.array([gradient], np.float32)])
        exact.append(corrected)
        obvious.append(plain)
        ours.append(float(parameter[0][0]))
    return Values(np.array(exact), obvious, ours)
