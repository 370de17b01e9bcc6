"""Profiles, against planes whose values are known by place."""

import numpy as np
import pytest

from lf_flame.tomography import profiles

CELL = 0.5


def plane():
    """Ten rows and eight columns: 10 a row from the bottom, 1 a column from the left."""
    return 10.0 * np.arange(10)[::-1, None] + np.arange(8)[None, :]


NONE = np.empty((0, 10, 8))


def test_heights_go_up_and_places_to_the_right():
    up = profiles.axial(plane(), NONE, CELL, across_mm=-0.25)  # the fourth column
    assert up.places_mm == pytest.approx(np.arange(-2.25, 2.3, 0.5))
    assert up.values == pytest.approx(10 * np.arange(10) + 3)
    assert up.sigma is None
    across = profiles.radial(plane(), NONE, CELL, height_mm=1.75)  # the second row from the top
    assert across.places_mm == pytest.approx(np.arange(-1.75, 1.8, 0.5))
    assert across.values == pytest.approx(80 + np.arange(8))


def test_a_strip_between_cells_is_the_mean_of_what_is_inside():
    """Cells hold means of x squared + x, and a strip's mean has a closed form."""

    def mean(low, high):
        return (high**3 - low**3) / (3 * (high - low)) + (high + low) / 2

    edges = np.arange(-2, 2, CELL)
    image = np.broadcast_to(mean(edges, edges + CELL), (10, 8))
    # 0.1 of the cell from -1 to -0.5, all of the next, 0.3 of that from 0 to 0.5.
    wanted = (0.05 * mean(-1, -0.5) + 0.5 * mean(-0.5, 0) + 0.15 * mean(0, 0.5)) / 0.7
    up = profiles.axial(image, image[None], CELL, across_mm=-0.2, width_mm=0.7)
    assert up.values == pytest.approx(np.full(10, wanted))
    across = profiles.radial(image.T, NONE.swapaxes(1, 2), CELL, height_mm=0.2, thickness_mm=0.7)
    assert across.values == pytest.approx(np.full(10, wanted))
    # Narrower than a cell it is one cell wide, and beyond the plane there is nothing.
    narrow = profiles.axial(image, NONE, CELL, across_mm=-0.4, width_mm=0.1)
    assert narrow.values[0] == pytest.approx(0.3 * mean(-1, -0.5) + 0.7 * mean(-0.5, 0))
    edge = profiles.axial(image, NONE, CELL, across_mm=2.0, width_mm=0.6)
    assert edge.values[0] == pytest.approx(mean(1.5, 2))


def test_strips_run_through_the_middle_of_the_light_if_nothing_is_said():
    image = np.zeros((10, 8))
    image[2, 6] = 4.0
    assert profiles.axial(image, NONE, CELL).values.max() == 4
    assert profiles.radial(image, NONE, CELL).values.argmax() == 6
    dark = np.zeros((10, 8))
    assert profiles.axial(dark, NONE, CELL).values.max() == 0


def test_errors_are_those_of_the_average_over_the_strip():
    image = plane()
    draws = image + 0.5 * np.random.default_rng(0).standard_normal((400, 10, 8))
    up = profiles.axial(image, draws, CELL, across_mm=0.25, width_mm=1.5)  # three columns
    assert up.sigma == pytest.approx(np.full(10, 0.5 / np.sqrt(3)), rel=0.15)
    assert profiles.axial(image, draws[:1], CELL).sigma is None
    # Draws that all miss by 0.3 are off by that, however little they scatter.
    aside = profiles.axial(image, image + 0.3 + np.zeros((5, 10, 8)), CELL)
    assert aside.sigma == pytest.approx(np.full(10, 0.3))
    assert aside.band == pytest.approx(np.full(10, 0.3 * 2.571), rel=1e-3)  # t of 5 draws
