"""What steps between cells add to a change, against textures that are averaged by brute force."""

import numpy as np
import pytest

from lf_flame.simulation.planning.axis_spread import Box, Pairs
from lf_flame.simulation.planning.cell_rounding import find_rounding, teeth

FINE = 4000
"""Points of a cell."""


def departures(steps, lenslet, pixel, cell):
    """How far a bundle sees cells depart from the line between their middles, wherever it looks.

    The bundle is the convolution of two boxes; `steps` are those from cell to cell.
    """
    values = np.concatenate([[0.0], np.cumsum(steps)])
    x = (np.arange(FINE * values.size) + 0.5) / FINE  # in cells
    middles = np.arange(values.size) + 0.5
    apart = values[x.astype(int)] - np.interp(x, middles, values)
    seen = np.concatenate([[0.0], np.cumsum(apart)]) / FINE  # integral from the left
    edges = np.arange(seen.size) / FINE
    for box in filter(None, (lenslet, pixel)):
        half = box / cell / 2
        means = np.interp(edges + half, edges, seen) - np.interp(edges - half, edges, seen)
        seen = np.concatenate([[0.0], np.cumsum((means[1:] + means[:-1]) / 2)]) / FINE / (2 * half)
    inside = slice(2 * FINE, -2 * FINE)
    return np.gradient(seen, 1 / FINE)[inside]


@pytest.mark.parametrize("cell", [0.05, 1.0, 7.0])
@pytest.mark.parametrize(
    "widths", [(0.4, 0.3), (0.7, 0.35), (1.3, 0.45), (1.0, 0.9), (2.4, 0.6), (0.6, 0), (1.4, 0)]
)
def test_no_texture_departs_farther(rng, cell, widths):
    """Steps at random, and steps that are all alike, which cancel over whole cells."""
    lenslet, pixel = (width * cell for width in widths)
    wide, even, _ = teeth(Box((lenslet, lenslet), (pixel, pixel)), cell, cut=False)
    for steps in (rng.choice([-1.0, 1.0], 12), np.resize([1.0, -1.0], 12)):
        assert np.abs(departures(steps, lenslet, pixel, cell)).max() <= wide + 1e-3
    found = np.abs(departures(np.ones(12), lenslet, pixel, cell)).max()
    assert found <= even + 1e-3
    assert even <= (4 * found + 0.01 if pixel else 1.01 * found)


def test_narrowest_bundle_on_the_way_decides():
    """A short move changes the mean over a box by the step times the move over its width."""
    narrow, wide = (Box((width, width), (0.1, 0.1)) for width in (1.0, 3.0))
    pairs = Pairs.alike(np.array([1.0]), np.array([1e-3]))
    for ends in ((narrow, narrow), (narrow, wide), (wide, narrow)):
        found = find_rounding(pairs, 1.0, wide, [ends], cut=True)
        assert found.any_steps == pytest.approx(1e-3 / 1.0)
    assert find_rounding(pairs, 1.0, wide, [(wide, wide)], cut=True).any_steps == pytest.approx(
        1e-3 / 3.0
    )
