"""Slopes of planes in raws of round micro-images, made pixel by pixel by geometry of their own."""

import numpy as np
import pytest

from lf_flame.formats import decode_raw, estimate_grid
from lf_flame.refocus import find_sharpest_slope

PITCH, SUB = 15, 3


def raw_of_a_plane(slope, hexagonal, rows=18, columns=20):
    """Raw and white image: a pixel shows the plane where the ray through its lenslet meets it.

    The plane is a sum of waves of 4 to 8 lenslets; it moves by `slope` pitches for each pixel.
    """
    rng = np.random.default_rng(1)
    row_pitch = PITCH * (np.sqrt(3) / 2 if hexagonal else 1)
    shape = int(row_pitch * (rows + 1) + PITCH), int(PITCH * (columns + 2.5))
    y, x = (((np.arange(n * SUB) + 0.5) / SUB - 0.5 - PITCH - 0.25) for n in shape)
    y, x = np.meshgrid(y, x, indexing="ij")
    nearest = np.full(y.shape, np.inf)
    place = np.zeros((2, *y.shape))
    for step in (-1, 0, 1):
        row = np.rint(y / row_pitch) + step
        offset = row % 2 / 2 if hexagonal else 0
        column = np.rint(x / PITCH - offset) + offset
        down, right = y - row * row_pitch, x - column * PITCH
        closer = down**2 + right**2 < nearest
        nearest = np.where(closer, down**2 + right**2, nearest)
        seen = np.stack([row * row_pitch / PITCH - slope * down, column - slope * right])
        place = np.where(closer, seen, place)
    light = 0.5
    for length, angle, phase in zip(
        rng.uniform(4, 8, 20), rng.uniform(0, 6.28, (20)), rng.uniform(0, 6.28, 20), strict=True
    ):
        along = np.sin(angle) * place[0] + np.cos(angle) * place[1]
        light = light + 0.05 * np.cos(2 * np.pi * along / length + phase)
    lit = nearest <= (PITCH / 2) ** 2
    pixels = (shape[0], SUB, shape[1], SUB)
    return tuple(a.reshape(pixels).mean(axis=(1, 3)) for a in (light * lit, 1.0 * lit))


@pytest.mark.parametrize("hexagonal", [True, False])
@pytest.mark.parametrize("slope", [-0.32, 0.6])
def test_views_of_neighbours_and_dark_ones_do_not_move_a_slope(hexagonal, slope):
    raw, white = raw_of_a_plane(slope, hexagonal)
    light_field = decode_raw(raw, estimate_grid(white), white=white)
    assert np.all(light_field.weights[[0, 0, -1, -1], [0, -1, 0, -1]] == 0)
    assert np.all(light_field.weights[4:-4, 4:-4] == 1)
    truth = slope * (2 / np.sqrt(3) if hexagonal else 1)
    found = find_sharpest_slope(light_field, np.linspace(-1, 1, 41))
    assert found.slope == pytest.approx(truth, rel=0.005)
