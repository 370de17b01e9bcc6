"""White images that fit a raw one, and others, by geometry of their own."""

from functools import partial

import numpy as np
import pytest
from micro_images import nearest_lenslet
from scipy import ndimage

from lf_flame import InputError
from lf_flame.formats import DecodePlan, estimate_grid

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
    row, column, down, right = nearest_lenslet(
        (y - 20.3) / pitch, (x - moved - 31.6) / pitch, 1.0, hexagonal=hexagonal
    )
    height, far = np.sqrt(3) / 2 if hexagonal else 1.0, np.hypot(down, right)
    lit = np.clip((radius - far) * pitch + 0.5, 0, 1) * (1 - 0.4 * (far / radius) ** 2)
    return lit * scene(row * height - slope * down, column - slope * right)


def said_of(raw, white, bayer=None):
    """What a pair is refused with, if it is."""
    try:
        DecodePlan(estimate_grid(white), shape=SHAPE, white=white, bayer=bayer).decode(raw)
    except InputError as error:
        return str(error)
    return "nothing"


OTHER = "does not fit the raw image"


def noisy(image, level=0.002):
    return image + level * np.random.default_rng(3).standard_normal(SHAPE)


def plane(scene=textured, **options):
    return lambda: noisy(sensor(scene, **options))


def flat(turned=False, **options):
    return lambda: np.rot90(sensor(**options), 2 * turned)


def one_side(edge):
    """A flame far out of focus, beside the picture: its light comes through the aperture's rim."""
    return plane(lambda y, x: 1.0 * (x > edge), slope=9.0)


OTHERS = [flat(pitch=12.1), flat(pitch=9.5), flat(moved=5), flat(moved=4), flat(turned=True)]
PAIRS = [
    *(
        (plane(scene, slope=slope, hexagonal=hexagonal), flat(hexagonal=hexagonal), "nothing")
        for scene, slope in ((textured, 0.0), (textured, -9.0), (small_flame, 4), (small_flame, -9))
        for hexagonal in (False, True)
    ),
    (partial(noisy, np.zeros(SHAPE)), flat(), "nothing"),
    (lambda: sensor(textured) + 0.06, flat(), "nothing"),  # with a black level
    (lambda: np.minimum(30 * sensor(textured), 1), flat(), "nothing"),  # overexposed
    (plane(radius=0.3), flat(), "nothing"),
    (one_side(23.5), flat(), "nothing"),
    (one_side(24.5), flat(), "nothing"),
    (plane(radius=0.9), flat(radius=0.4), "nothing"),  # no gaps that could be compared
    *((plane(small_flame), other, OTHER) for other in OTHERS),
    *((lambda: plane()() + 0.1, lambda x=other: x() + 0.1, OTHER) for other in OTHERS),
    (plane(hexagonal=True), flat(hexagonal=True, moved=5), OTHER),
    (plane(), flat(moved=2.5), OTHER),
    (plane(), flat(radius=0.2), OTHER),
    (plane(radius=0.6), flat(radius=0.4), OTHER),
]


@pytest.mark.parametrize(
    ("raw", "white", "said"),
    [*PAIRS[:1], *(pytest.param(*pair, marks=pytest.mark.slow) for pair in PAIRS[1:-1]), PAIRS[-1]],
)
def test_pairs_that_fit_are_taken_in_silence_and_others_are_not(raw, white, said):
    assert said in said_of(raw(), white())


@pytest.mark.slow
@pytest.mark.parametrize("pattern", ["rggb", "gbrg"])
def test_mosaics_of_strong_colours_fit_and_moved_ones_do_not(pattern):
    """Pixels under a lenslet of an even pitch have the same colour in every micro-image."""

    def coloured(image, levels):
        y, x = np.indices(SHAPE)
        colours = np.array([levels["rgb".index(letter)] for letter in pattern])
        return image * colours[2 * (y % 2) + x % 2]

    white = coloured(sensor(pitch=12.0), (0.5, 1.0, 0.6))
    for levels in ((1, 0.05, 0.02), (0.02, 0.1, 1)):
        raw = coloured(sensor(textured, pitch=12.0), levels)
        assert said_of(raw, white, pattern) == "nothing"
        moved = coloured(sensor(pitch=12.0, moved=5), (0.5, 1.0, 0.6))
        assert said_of(raw, moved, pattern) != "nothing"


@pytest.mark.parametrize(("share", "is_said"), [(0.32, True), (0.7, True), (0.0, False)])
def test_a_saturated_white_image_is_said(share, is_said, caplog):
    """Levels of 16 bits, of which a share is the highest one."""
    raw, white = (noisy(image + 0.01).clip(0) for image in (sensor(textured), sensor()))
    top = np.quantile(white, 1 - share) if share else 1.4
    white = np.rint(65535 * np.minimum(white / top, 1)).astype(np.uint16)
    DecodePlan(estimate_grid(white), shape=SHAPE, white=white).decode(raw)
    assert (f"({share} of all) are saturated: the white image is wrong" in caplog.text) == is_said
