"""White images that fit a raw one, and others, made pixel by pixel by geometry of their own."""

import logging

import numpy as np
import pytest
from scipy import ndimage

from lf_flame import InputError
from lf_flame.formats import DecodePlan, estimate_grid
from lf_flame.formats.raw.white_match import Misfit, check_match, mean_micro_images

SHAPE, PITCH = (260, 310), 11.4
TEXTURE = 0.45 + 0.3 * ndimage.zoom(np.random.default_rng(5).uniform(-1, 1, (30, 30)), 5, order=1)
"""Light of a plane, a few points for each lenslet."""


def textured(y, x):
    return ndimage.map_coordinates(TEXTURE, [y + 50, x + 50], order=1, mode="wrap")


def small_flame(y, x):
    return np.exp(-(((x - 12) / 2) ** 2) - ((y - 10) / 5) ** 2)


def uniform(y, x):
    return np.ones_like(y)


def sensor(scene=uniform, pitch=PITCH, radius=0.47, slope=4.0, hexagonal=False, moved=0):
    """Round micro-images of a plane that moves by `slope` pitches over a micro-image."""
    y, x = (n.astype(float) for n in np.indices(SHAPE))
    y, x = (y - 20.3) / pitch, (x - moved - 31.6) / pitch
    nearest, place = np.full(SHAPE, np.inf), np.zeros((4, *SHAPE))
    height = np.sqrt(3) / 2 if hexagonal else 1.0
    for step in (-1, 0, 1):
        row = np.rint(y / height) + step
        offset = row % 2 / 2 if hexagonal else 0.0
        column = np.rint(x - offset) + offset
        down, right = y - row * height, x - column
        closer = np.hypot(down, right) < nearest
        nearest = np.where(closer, np.hypot(down, right), nearest)
        place = np.where(closer, [row * height, column, down, right], place)
    lit = np.clip((radius - nearest) * pitch + 0.5, 0, 1) * (1 - 0.4 * (nearest / radius) ** 2)
    return lit * scene(place[0] - slope * place[2], place[1] - slope * place[3])


def said_of(raw, white, step=1):
    """Whether a pair is taken in silence, with a warning, or refused."""
    grid = estimate_grid(white)
    flat, light = (mean_micro_images(image[..., None], grid, step) for image in (white, raw))
    try:
        return "warned" if check_match(flat, light) else "nothing"
    except InputError as error:
        return "refused" if "does not fit the raw image" in str(error) else str(error)


def noisy(image, level=0.002):
    return image + level * np.random.default_rng(3).standard_normal(SHAPE)


@pytest.mark.slow
@pytest.mark.parametrize("hexagonal", [False, True])
@pytest.mark.parametrize(
    ("scene", "slope"), [(textured, 0.0), (textured, -9.0), (small_flame, 4.0), (small_flame, -9.0)]
)
def test_a_white_image_that_fits_is_taken_in_silence(scene, slope, hexagonal):
    white = sensor(hexagonal=hexagonal)
    raw = noisy(sensor(scene, slope=slope, hexagonal=hexagonal))
    assert said_of(raw, white) == "nothing"


@pytest.mark.slow
def test_raw_images_without_light_black_or_overexposed_are_taken():
    white, raw = sensor(), sensor(textured)
    for image in (
        noisy(0 * raw),
        raw + 0.06,
        np.minimum(30 * raw, 1),
        sensor(textured, radius=0.3),
    ):
        assert said_of(image, white) == "nothing"


@pytest.mark.slow
def test_a_flame_that_lights_one_side_of_the_micro_images_is_taken():
    """A plane far out of focus, beside the picture: light comes through the rim of the aperture."""
    for edge in (23.5, 24.5):
        raw = noisy(sensor(lambda y, x, at=edge: 1.0 * (x > at), slope=9.0))
        assert said_of(raw, sensor()) == "nothing"


@pytest.mark.slow
@pytest.mark.parametrize(("scene", "dark"), [(textured, 0.1), (small_flame, 0.0)])
def test_a_white_image_of_another_pitch_moved_or_turned_is_refused(scene, dark):
    raw = noisy(sensor(scene)) + dark
    for white in (sensor(pitch=12.1), sensor(pitch=9.5), sensor(moved=5), sensor(moved=4)):
        assert said_of(raw, white + dark) == "refused"
    assert said_of(raw, sensor()[::-1, ::-1] + dark) == "refused"


def test_the_textured_plane_fits_its_white_image_and_no_turned_one():
    raw, white = sensor(textured), sensor()
    assert said_of(raw, white) == "nothing"
    assert said_of(raw, white[::-1, ::-1]) == "refused"


@pytest.mark.slow
def test_hexagonal_arrays_that_are_moved_are_refused():
    raw = noisy(sensor(textured, hexagonal=True))
    assert said_of(raw, sensor(hexagonal=True, moved=5)) == "refused"


@pytest.mark.slow
def test_a_white_image_that_is_moved_a_little_or_stopped_down_is_warned_of():
    raw = sensor(textured)
    assert said_of(raw, sensor(moved=2)) == "warned"
    assert said_of(raw, sensor(radius=0.24)) == "warned"
    assert said_of(sensor(textured, radius=0.6), sensor(radius=0.4)) == "warned"


@pytest.mark.slow
def test_a_raw_image_without_gaps_shows_no_misfit():
    """The aperture fills the micro-images, so that there is nothing to hold against the gaps."""
    assert said_of(noisy(sensor(textured, radius=0.9)), sensor(radius=0.4)) == "nothing"


def test_a_refusal_needs_every_sign():
    assert Misfit(0.6, 0.4, 0.34).certain
    assert not any(Misfit(*m).certain for m in ((0.59, 1, 1), (1, 0.39, 1), (1, 1, 0.33)))


@pytest.mark.slow
@pytest.mark.parametrize("pattern", ["rggb", "gbrg"])
@pytest.mark.parametrize("pitch", [PITCH, 12.0])
def test_mosaics_of_strong_colours_fit_and_moved_ones_do_not(pattern, pitch):
    """Pixels under a lenslet of an even pitch have the same colour in every micro-image."""

    def coloured(image, levels):
        y, x = np.indices(SHAPE)
        colours = np.array([levels["rgb".index(letter)] for letter in pattern])
        return image * colours[2 * (y % 2) + x % 2]

    white = coloured(sensor(pitch=pitch), (0.5, 1.0, 0.6))
    for levels in ((1, 0.05, 0.02), (0.02, 0.1, 1)):
        raw = coloured(sensor(textured, pitch=pitch), levels)
        assert said_of(raw, white, step=2) == "nothing"
        moved = coloured(sensor(pitch=pitch, moved=5), (0.5, 1.0, 0.6))
        assert said_of(raw, moved, step=2) != "nothing"


@pytest.mark.slow
def test_only_the_first_frame_is_held_against_the_white_image(caplog):
    caplog.set_level(logging.WARNING)
    white = sensor(moved=2)
    plan = DecodePlan(estimate_grid(white), shape=SHAPE, white=white)
    for _ in range(2):
        plan.decode(sensor(textured))
    assert caplog.text.count("may not fit") == 1
