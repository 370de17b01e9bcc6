"""Slopes of views that are not equally bright, against those of the same views when they are.

The views are photographs shifted exactly, by the Fourier transform: a wall and a card before it.
"""

from functools import cache

import numpy as np
import pytest
from skimage import data

from lf_flame.refocus import all_in_focus, find_sharpest_slope, matching
from lf_flame.refocus.focus_map import TRUSTED

SIZE, COUNT, MARGIN = (64, 80), 7, 16
STEPS = np.arange(COUNT) - 3.0
WALL, CARD = -0.8, 0.9
CARD_ROWS, CARD_COLUMNS = (20, 46), (24, 60)
SLOPES = np.arange(-1.4, 1.41, 0.1)


def photograph(image, top, left):
    """Part of a photograph, halved, with a margin about it."""
    height, width = (n + 2 * MARGIN for n in SIZE)
    part = image.reshape(*image.shape[:2], -1).mean(axis=2) / 255
    part = part[top : top + 2 * height, left : left + 2 * width]
    return part.reshape(height, 2, width, 2).mean(axis=(1, 3))


def seen_at(slope, picture, v, u):
    """What view (v, u) sees of a picture: what is at x in the middle is at x + slope u."""
    down, across = (np.fft.fftfreq(n) for n in picture.shape)
    turn = np.exp(2j * np.pi * slope * (down[:, None] * -v + across * -u))
    return np.fft.ifft2(np.fft.fft2(picture) * turn).real[MARGIN:-MARGIN, MARGIN:-MARGIN]


def covered(count, ends, shift):
    """Share of each pixel that the card covers along an axis."""
    at = np.arange(count) - shift
    return np.clip(np.minimum(at - ends[0] + 0.5, ends[1] - 0.5 - at), 0, 1)


@cache
def scene():
    """Evenly bright views of the two, and the true slopes of the middle one."""
    wall = photograph(data.coffee(), 100, 100)
    card = photograph(data.astronaut(), 20, 120)
    views = np.empty((COUNT, COUNT, *SIZE))
    for i, j in np.ndindex(COUNT, COUNT):
        v, u = STEPS[i], STEPS[j]
        share = np.outer(
            covered(SIZE[0], CARD_ROWS, CARD * v), covered(SIZE[1], CARD_COLUMNS, CARD * u)
        )
        views[i, j] = (1 - share) * seen_at(WALL, wall, v, u) + share * seen_at(CARD, card, v, u)
    truth = np.full(SIZE, WALL)
    truth[slice(*CARD_ROWS), slice(*CARD_COLUMNS)] = CARD
    return views, truth


def brightness(kind):
    """By what each pixel of each view is multiplied, shape (v, u, t, s)."""
    v, u = np.meshgrid(STEPS / 3, STEPS / 3, indexing="ij")
    v, u = v[..., None, None], u[..., None, None]
    t, s = np.linspace(-1, 1, SIZE[0])[:, None], np.linspace(-1, 1, SIZE[1])
    gains = np.random.default_rng(3).standard_normal(v.shape)
    return {
        "even": 1.0,
        "corners 10 % darker": 1 - 0.1 * (v**2 + u**2) / 2,
        "corners 20 % darker": 1 - 0.2 * (v**2 + u**2) / 2,
        "gains of 5 %": 1 + 0.05 * gains,
        # tan of the angle of a ray from (v, u) of the pupil to (t, s) of the image
        "cos^4": (1 + (0.15 * v - 0.2 * t) ** 2 + (0.15 * u - 0.2 * s) ** 2) ** -2,
        "tilt of 10 %": 1 + 0.1 * (v * t + u * s) / 2,
        "tilt over the views": 1 + 0.1 * (u + 0 * v),
    }[kind]


@cache
def shares(kind, noise):
    """Percent of pixels whose slope is wrong, that are certain, and that are both."""
    views, truth = scene()
    views = brightness(kind) * views
    views += noise * np.random.default_rng(1).standard_normal(views.shape)
    found = all_in_focus(views.astype(np.float32), SLOPES)
    wrong, certain = np.abs(found.slope - truth) > 0.07, found.confidence >= TRUSTED
    return [100 * np.mean(x) for x in (wrong, certain, wrong & certain)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "noise"),
    [
        ("gains of 5 %", 0.01), ("cos^4", 0.01), ("tilt of 10 %", 0.01),
        ("corners 10 % darker", 0.0),
    ],
)  # fmt: skip
def test_slopes_of_uneven_views_are_as_right_as_those_of_even_ones(kind, noise):
    wrong, certain, both = shares(kind, noise)
    even_wrong, even_certain, even_both = shares("even", noise)
    assert even_wrong < 5
    assert even_certain > 50
    assert wrong <= 1.3 * even_wrong + 5  # cos^4 is no polynomial of second order
    assert both <= 1.3 * even_both + 2.5
    assert certain > 0.85 * even_certain


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_even_views_are_left_as_they_are(noise):
    views = scene()[0] + noise * np.random.default_rng(2).standard_normal(scene()[0].shape)
    assert matching.ComparedViews(views.astype(np.float32), SLOPES, np.ones((7, 7))).even


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["corners 20 % darker", "tilt over the views"])
def test_the_sharpest_slope_of_uneven_views_is_that_of_even_ones(kind):
    picture = photograph(data.coffee(), 100, 100)
    views = np.array([[seen_at(0.6, picture, v, u) for u in STEPS] for v in STEPS])
    even = find_sharpest_slope(views.astype(np.float32), np.arange(-1.5, 1.51, 0.1)).slope
    uneven = (brightness(kind) * views).astype(np.float32)
    assert even == pytest.approx(0.6, abs=0.005)
    assert find_sharpest_slope(uneven, np.arange(-1.5, 1.51, 0.1)).slope == pytest.approx(
        even, abs=0.005
    )
