"""Raw pictures of lenslets by geometry of the tests' own: nothing of the package is used."""

import numpy as np


def nearest_lenslet(y, x, pitch, row_pitch=None, hexagonal=False):
    """Give row, place along the row, and way (down, along) from the lenslet nearest to places.

    The first lenslet stands at the origin, and the place counts pitches from it. All lenslets of
    the two rows beside a place are compared.
    """
    row_pitch = row_pitch or pitch * (np.sqrt(3) / 2 if hexagonal else 1)
    best = np.full((4, *y.shape), np.inf)
    for row in (np.floor(y / row_pitch), np.ceil(y / row_pitch)):
        shifted = row % 2 / 2 if hexagonal else 0
        place = np.round(x / pitch - shifted) + shifted
        found = np.stack([row, place, y - row * row_pitch, x - place * pitch])
        best = np.where(np.hypot(*found[2:]) < np.hypot(*best[2:]), found, best)
    return best


def waves(down, right, amplitude, rng):
    """Sum twenty plane waves 4 to 8 units long."""
    drawn = rng.uniform(4, 8, 20), rng.uniform(0, 6.28, 20), rng.uniform(0, 6.28, 20)
    return amplitude * sum(
        np.cos(2 * np.pi * (np.sin(angle) * down + np.cos(angle) * right) / length + phase)
        for length, angle, phase in zip(*drawn, strict=True)
    )
