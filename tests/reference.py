"""Slow, obvious twins of the compiled code, in float64."""

import math

import numpy as np
from numpy.linalg import inv

from lf_flame.optics import ray_transfer


def trace_one_pixel(layer, camera, v, u, t, s, rays):
    """Mean radiance over a grid of rays, each pushed through the matrices by itself."""

    def heights(axis, view, lenslet):
        n, k = camera.lenslets[axis], camera.views
        i0, f = camera.image_distance_mm, camera.lenslet_focal_mm
        # The sensor is stored turned by 180 degrees: undo that to get physical positions.
        axis_mm = -(lenslet - (n - 1) / 2) * camera.lenslet_pitch_mm
        chief_mm = axis_mm * (1 + f / i0)
        pixel_mm = chief_mm - (view - (k - 1) / 2) * camera.pixel_mm
        sub = (np.arange(rays) + 0.5) / rays - 0.5
        array_to_object = inv(camera.object_to_array(layer.depth_mm))
        lens = ray_transfer.chain(ray_transfer.thin_lens(f), ray_transfer.free_space(f))
        height = sub[:, None] * camera.lenslet_pitch_mm
        on_pixel = pixel_mm + sub * camera.pixel_mm
        # angle in front of the lenslet for which the ray ends on the pixel
        angle = (on_pixel - axis_mm - lens[0, 0] * height) / lens[0, 1]
        return (array_to_object[0, 0] * (axis_mm + height) + array_to_object[0, 1] * angle).ravel()

    rows, columns = (
        np.floor(
            (heights(axis, *pixel) - layer.cell_edges_mm(axis)[0])
            / (layer.size_mm[axis] / layer.texture.shape[axis])
        )
        for axis, pixel in ((0, (v, t)), (1, (u, s)))
    )
    # How often each row and column of cells is hit, those beside the layer at both ends.
    down, right = (
        np.bincount(np.clip(index + 1, 0, length + 1).astype(int), minlength=length + 2)
        for index, length in zip((rows, columns), layer.texture.shape, strict=True)
    )
    return down @ np.pad(layer.texture, 1) @ right / (down.sum() * right.sum())


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
