"""Slow, obvious twins of the compiled code, in float64."""

import math

import numpy as np


def keys(x):
    """Cubic convolution kernel of Keys with a = -1/2."""
    x = np.abs(x)
    near = 1.5 * x**3 - 2.5 * x**2 + 1
    far = -0.5 * x**3 + 2.5 * x**2 - 4 * x + 2
    return np.where(x <= 1, near, np.where(x < 2, far, 0.0))


KERNELS = {
    "nearest": lambda x: ((x < 0.5) & (x >= -0.5)).astype(float),  # halves up
    "linear": lambda x: np.maximum(1 - np.abs(x), 0.0),
    "cubic": keys,
}
"""Weight of a neighbour at a signed distance, ``position - neighbour``."""


def shift_matrix(shift, length, interpolation):
    """Matrix that shifts a line, edges clamped: every neighbour's weight put in its place."""
    matrix = np.zeros((length, length))
    for at in range(length):
        position = at + np.clip(shift, -length, length)
        for neighbour in range(math.floor(position) - 2, math.floor(position) + 4):
            weight = KERNELS[interpolation](np.float64(position - neighbour))
            matrix[at, min(max(neighbour, 0), length - 1)] += weight
    return matrix


def shift_and_sum(views, slope, interpolation="linear", weights=None):
    """Shift-and-sum, coordinates clamped, one view after the other."""
    rows, columns, height, width = views.shape
    weights = np.ones((rows, columns)) if weights is None else weights
    total = np.zeros((height, width))
    for v in range(rows):
        down = shift_matrix(slope * (v - (rows - 1) / 2), height, interpolation)
        for u in range(columns):
            right = shift_matrix(slope * (u - (columns - 1) / 2), width, interpolation)
            total += weights[v, u] * (down @ views[v, u].astype(np.float64) @ right.T)
    return total / weights.sum()
