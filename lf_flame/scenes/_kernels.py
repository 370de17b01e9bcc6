"""Compiled loop that renders dead leaves: arrays in, output array filled, nothing returned.

One thread computes each pixel in a fixed order: the bits do not depend on the number of threads.
"""

import math

from numba import njit

from lf_flame._common.threads import parallel

COLUMNS = (
    "y", "x", "slope", "half_height", "half_width", "cosine", "sine", "squareness",
    "brightness", "contrast", "wave_y", "wave_x", "phase",
)  # fmt: skip
"""Names of the numbers that describe a leaf. Lengths are in pixels; (cosine, sine) is the angle of
its axes; a squareness of 2 makes an ellipse, a larger one a superellipse closer to a rectangle."""

OPAQUE = 1e-3
"""Fraction of light from behind a pixel that is neglected; leaves farther back are then skipped."""


@njit
def shade(leaf, y, x):
    """Coverage and radiance of a leaf at a position relative to its centre."""
    down = leaf[5] * y - leaf[6] * x
    right = leaf[6] * y + leaf[5] * x
    p = leaf[7]
    rho = (abs(down / leaf[3]) ** p + abs(right / leaf[4]) ** p) ** (1.0 / p)
    # Distance to the edge along the ray from the centre, in pixels; the edge is a pixel wide.
    inside = 0.5 + math.hypot(down, right) * (1.0 - rho) / rho if rho > 0.0 else 1.0
    cover = min(max(inside, 0.0), 1.0)
    if cover == 0.0:
        return 0.0, 0.0
    wave = math.sin(leaf[10] * down + leaf[11] * right + leaf[12])
    return cover, min(max(leaf[8] + leaf[9] * wave, 0.0), 1.0)


@parallel(lambda out: out.shape[0] * out.shape[1] * out.shape[2])
def render_leaves(m, leaves, background, out):
    """Render leaves, sorted nearest first, in every view: out[v, u, t, s]."""
    rows, columns, height, width = out.shape
    k, t = m // height, m % height
    v, u = k // columns - (rows - 1) / 2.0, k % columns - (columns - 1) / 2.0
    for s in range(width):
        light, through = 0.0, 1.0
        for n in range(leaves.shape[0]):
            leaf = leaves[n]
            y = t - leaf[0] - leaf[2] * v
            x = s - leaf[1] - leaf[2] * u
            reach = leaf[3] + leaf[4] + 1.0
            if abs(y) > reach or abs(x) > reach:
                continue
            cover, radiance = shade(leaf, y, x)
            light += through * cover * radiance
            through *= 1.0 - cover
            if through < OPAQUE:
                break
        out[k // columns, k % columns, t, s] = light + through * background
