"""A rendered table top: bare dark things, soft shadows, highlights, and the true slopes.

Pinhole cameras are on a square grid, all with the same orientation, with their
images shifted so that a point at the distance `FOCUS` is in the same place in all. A point at the
distance Z then moves by ``d = STEP (1 - FOCUS / Z)`` pixels from a view to the next: its slope.
Each ray meets balls, boxes, the table and the wall behind it; light comes from an extended lamp
(soft shadows), from all sides, and by reflection (highlights that glide over a surface as the
camera moves). Nothing is shared with the package's simulator.
"""

import math

import numpy as np
from numba import njit, prange

SIZE = (144, 192)
FOCUS, STEP, LENGTH = 10.0, 4.2, 248.0
"""Distance in focus, slope at infinity, and focal length in pixels."""

SAMPLES = 2
"""Samples of a pixel along each axis."""

LAMP = np.array([(-5.2 + x, 9.0 - 0.4 * x, 3.0 + z) for x in (-0.9, -0.3, 0.3, 0.9)
                 for z in (-0.8, 0.0, 0.8)])  # fmt: skip
"""Points of the lamp: to the left, above, nearer than the things."""

TABLE, WALL = -2.2, 15.0
"""Height of the table, and distance of the wall."""


def draw_scene(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw balls and boxes on a table.

    A ball is ``x, y, z, radius``, a box the lower and the upper corner; both continue with
    brightness, contrast of the pattern, its scale, and gloss. The table and the wall stand for the
    last two boxes' material. Six in ten things are bare and dark.
    """
    rng = np.random.default_rng(seed)

    def material() -> list[float]:
        bare = rng.random() < 0.6
        bright = rng.uniform(0.02, 0.12) if bare else rng.uniform(0.2, 0.8)
        contrast = rng.uniform(0.0, 0.1) if bare else rng.uniform(0.3, 0.9)
        return [bright, contrast, rng.uniform(2.0, 7.0), rng.choice([0.0, 0.15, 0.5])]

    balls, boxes = [], []
    for _ in range(7):
        radius, z = rng.uniform(0.35, 1.2), rng.uniform(7.5, 13.5)
        balls.append([rng.uniform(-0.33, 0.33) * z, TABLE + radius, z, radius, *material()])
    for _ in range(6):
        z, side = rng.uniform(7.5, 13.0), rng.uniform(0.08, 0.9)
        x, tall, deep = rng.uniform(-0.36, 0.36) * z, rng.uniform(0.6, 3.6), rng.uniform(0.1, 1.0)
        boxes.append([x - side, TABLE, z, x + side, TABLE + tall, z + deep, *material()])
    table = [0.0] * 6 + [rng.uniform(0.15, 0.5), rng.uniform(0.1, 0.6), 3.0, 0.1]
    wall = [0.0] * 6 + [rng.uniform(0.05, 0.4), rng.choice([0.02, 0.08, 0.4]), 1.5, 0.0]
    return np.array(balls), np.array([*boxes, table, wall])


def make_tabletop(seed: int, views: int = 9) -> tuple[np.ndarray, np.ndarray]:
    """Render views of a table top: uint8 [v, u, t, s], and the true slopes [t, s].

    The renderer's light is stored with a gamma of 2.2, with noise of 0.3 % of white.
    """
    balls, boxes = draw_scene(seed)
    light, distance = np.empty((views, views, *SIZE)), np.empty(SIZE)
    lens = FOCUS, STEP, LENGTH
    _render(balls, boxes, LAMP, lens, light, np.empty(SIZE))
    _render(balls, boxes, LAMP, lens, np.empty((1, 1, *SIZE)), distance)
    rng = np.random.default_rng(seed)
    coded = np.clip(light, 0, 1) ** (1 / 2.2) + 0.003 * rng.standard_normal(light.shape)
    return np.uint8(np.rint(255 * np.clip(coded, 0, 1))), STEP * (1 - FOCUS / distance)


@njit(parallel=True)
def _render(balls, boxes, lamp, lens, out, distance):
    """Radiance of views[v, u, t, s], and distance of what the middle of each pixel shows."""
    rows, columns, height, width = out.shape
    focus, step, length = lens
    for line in prange(rows * columns * height):
        v, u, t = line // (columns * height), line // height % columns, line % height
        across, down = u - (columns - 1) / 2, v - (rows - 1) / 2
        # The camera's place: a point at `focus` moves by the shift of the images.
        x, y = across * step * focus / length, -down * step * focus / length
        for s in range(width):
            total = 0.0
            for k in range(SAMPLES * SAMPLES):
                i = t + (k // SAMPLES + 0.5) / SAMPLES - height / 2
                j = s + (k % SAMPLES + 0.5) / SAMPLES - width / 2
                way = ((j - across * step) / length, -(i - down * step) / length, 1.0)
                total += _radiance((x, y, 0.0), way, balls, boxes, lamp, 1)
            out[v, u, t, s] = total / SAMPLES**2
            if rows * columns == 1:
                way = ((s + 0.5 - width / 2) / length, -(t + 0.5 - height / 2) / length, 1.0)
                distance[t, s] = _first((x, y, 0.0), way, balls, boxes)[0]


@njit
def _first(at, way, balls, boxes):
    """Nearest thing on a ray: how far along the ray, which thing, and its normal."""
    best, which, normal = 1e9, -1, (0.0, 0.0, 0.0)
    for k in range(len(balls)):
        a = way[0] ** 2 + way[1] ** 2 + way[2] ** 2
        px, py, pz = at[0] - balls[k, 0], at[1] - balls[k, 1], at[2] - balls[k, 2]
        b = px * way[0] + py * way[1] + pz * way[2]
        root = b * b - a * (px * px + py * py + pz * pz - balls[k, 3] ** 2)
        if root > 0:
            far = (-b - math.sqrt(root)) / a
            if 1e-4 < far < best:
                best, which, r = far, k, balls[k, 3]
                normal = ((px + far * way[0]) / r, (py + far * way[1]) / r, (pz + far * way[2]) / r)
    for k in range(len(boxes) - 2):
        enter, leave, side = -1e9, 1e9, 0
        for axis in range(3):
            step = way[axis] if abs(way[axis]) > 1e-12 else 1e-12
            one, other = (boxes[k, axis] - at[axis]) / step, (boxes[k, axis + 3] - at[axis]) / step
            if min(one, other) > enter:
                enter, side = min(one, other), axis
            leave = min(leave, max(one, other))
        if 1e-4 < enter < min(leave, best):
            best, which = enter, len(balls) + k
            sign = -1.0 if way[side] > 0 else 1.0
            normal = (sign * (side == 0), sign * (side == 1), sign * (side == 2))
    if way[1] < 0 and 1e-4 < (TABLE - at[1]) / way[1] < best:
        best, which = (TABLE - at[1]) / way[1], len(balls) + len(boxes) - 2
        normal = (0.0, 1.0, 0.0)
    if way[2] > 0 and 1e-4 < (WALL - at[2]) / way[2] < best:
        best, which = (WALL - at[2]) / way[2], len(balls) + len(boxes) - 1
        normal = (0.0, 0.0, -1.0)
    return best, which, normal


@njit
def _radiance(at, way, balls, boxes, lamp, bounces):
    """Light that comes along a ray."""
    far, which, normal = _first(at, way, balls, boxes)
    if which < 0:
        return 0.05
    p = (at[0] + far * way[0], at[1] + far * way[1], at[2] + far * way[2])
    some = balls[which, 4:] if which < len(balls) else boxes[which - len(balls), 6:]
    bright = some[0] * (1 + some[1] * _pattern(p[0] * some[2], p[1] * some[2], p[2] * some[2]))
    lit, shine = 0.15 + 0.1 * normal[1], 0.0
    size = math.sqrt(way[0] ** 2 + way[1] ** 2 + way[2] ** 2)
    along = (way[0] * normal[0] + way[1] * normal[1] + way[2] * normal[2]) / size
    mirror = (way[0] / size - 2 * along * normal[0], way[1] / size - 2 * along * normal[1],
              way[2] / size - 2 * along * normal[2])  # fmt: skip
    for k in range(len(lamp)):
        to = (lamp[k, 0] - p[0], lamp[k, 1] - p[1], lamp[k, 2] - p[2])
        length = math.sqrt(to[0] ** 2 + to[1] ** 2 + to[2] ** 2)
        facing = (to[0] * normal[0] + to[1] * normal[1] + to[2] * normal[2]) / length
        if facing > 0:
            hit, _, _ = _first(p, to, balls, boxes)
            if hit >= 1.0:
                lit += 100 * facing / length**2 / len(lamp)
                glint = (to[0] * mirror[0] + to[1] * mirror[1] + to[2] * mirror[2]) / length
                shine += max(glint, 0.0) ** 60 / len(lamp)
    light = bright * lit + some[3] * shine
    if some[3] > 0 and bounces > 0:  # what a glossy surface mirrors
        share = some[3] * (0.08 + 0.9 * (1 + along) ** 5)
        light += share * _radiance(p, mirror, balls, boxes, lamp, 0)
    return light


@njit
def _pattern(x, y, z):
    """Marbling from -1 to 1: four octaves of smooth noise."""
    total, size = 0.0, 0.5
    for _ in range(4):
        total += size * (2 * _noise(x, y, z) - 1)
        x, y, z, size = 2.1 * x + 5.3, 2.1 * y + 1.7, 2.1 * z + 9.2, size / 2
    return max(-1.0, min(1.0, 2 * total))


@njit
def _noise(x, y, z):
    """Random values at whole places, smoothly between them, from 0 to 1."""
    i, j, k = math.floor(x), math.floor(y), math.floor(z)
    total = 0.0
    for corner in range(8):
        a, b, c = corner & 1, corner >> 1 & 1, corner >> 2
        weight = 1.0
        for part, bit in ((x - i, a), (y - j, b), (z - k, c)):
            smooth = part * part * (3 - 2 * part)
            weight *= smooth if bit else 1 - smooth
        value = math.sin((i + a) * 127.1 + (j + b) * 311.7 + (k + c) * 74.7) * 43758.5453
        total += weight * (value - math.floor(value))
    return total
