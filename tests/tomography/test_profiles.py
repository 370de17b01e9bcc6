"""Profiles, against planes whose values are known by place."""

import numpy as np
import pytest

from lf_flame import InputError
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


def test_strips_are_averaged_over_their_width():
    # Middles of columns within 0.75 mm of -0.25: -0.75, -0.25, 0.25 and, on the edges, -1 to 0.5.
    up = profiles.axial(plane(), NONE, CELL, across_mm=-0.25, width_mm=1.0)
    assert up.values == pytest.approx(10 * np.arange(10) + 3)
    wide = profiles.axial(plane(), NONE, CELL, across_mm=0.25, width_mm=2.0)
    assert wide.values == pytest.approx(10 * np.arange(10) + 4)
    across = profiles.radial(plane(), NONE, CELL, height_mm=1.75, thickness_mm=1.1)
    assert across.values == pytest.approx(80 + np.arange(8))


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
    up = profiles.axial(image, draws, CELL, across_mm=0.25, width_mm=1.0)  # three columns
    assert up.sigma == pytest.approx(np.full(10, 0.5 / np.sqrt(3)), rel=0.15)
    assert profiles.axial(image, draws[:1], CELL).sigma is None
    # Draws that all miss by 0.3 are off by that, however little they scatter.
    aside = profiles.axial(image, image + 0.3 + np.zeros((5, 10, 8)), CELL)
    assert aside.sigma == pytest.approx(np.full(10, 0.3))
    assert aside.band == pytest.approx(np.full(10, 0.3 * 2.571), rel=1e-3)  # t of 5 draws


@pytest.mark.slow
def test_profiles_of_a_flame_are_right_within_some_per_cent(grid, truth, flames, fits):
    found = fits(0.01)
    for number, layer in enumerate(flames.layers):
        cell, at = grid.cell_mm(grid.depths_mm[number]), (layer.centre_mm[1], 0.4)
        wanted, values = (
            profiles.axial(one, no_draws(one), cell, *at).values
            for one in (truth[number], found.emission[number])
        )
        assert np.linalg.norm(values - wanted) < 0.02 * np.linalg.norm(wanted)


def no_draws(image):
    return np.empty((0, *image.shape))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((np.zeros(4), NONE, CELL), "shapes"),
        ((plane(), NONE[:, 1:], CELL), "shapes"),
        ((plane(), NONE, 0.0), "cell_mm must be"),
        ((plane(), NONE, CELL, 2.1), "must lie within the plane, -2 to 2 mm"),
        ((plane(), NONE, CELL, np.nan), "must lie within the plane"),
        ((plane(), NONE, CELL, 0.0, -1.0), "width must be"),
    ],
)
def test_what_cannot_be_is_refused(arguments, words):
    with pytest.raises(InputError, match=words):
        profiles.axial(*arguments)
