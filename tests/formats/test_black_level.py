"""A black level that no dark image takes off, in raw images drawn pixel by pixel."""

import logging

import numpy as np
import pytest
from micro_images import nearest_lenslet

from lf_flame.formats import DecodePlan, LensletGrid

PITCH = 15.0


def drawn(layout, radius, black, rng, evenly=False):
    """Round micro-images of a scene of bars, in levels of 10 bits with noise; and their grid."""
    grid = LensletGrid(7.0, 7.0, PITCH, layout=layout)
    y, x = np.mgrid[:240, :300].astype(float)
    _, place, *way = nearest_lenslet(y - 7, x - 7, PITCH, hexagonal=layout == "hexagonal")
    bright = 500 if evenly else 60 + 800 * (np.floor(place) // 3 % 2)
    lit = np.clip((radius - np.hypot(*way)) / 2 + 0.5, 0, 1)
    levels = black + bright * lit + rng.normal(0, 1.5, y.shape)
    return np.rint(levels.clip(0, 1023)).astype(np.uint16), grid


@pytest.mark.parametrize("layout", ["rectangular", "hexagonal"])
def test_a_black_level_without_a_dark_image_is_said_once(caplog, rng, layout):
    raw, grid = drawn(layout, 6.0, 64, rng)
    plan = DecodePlan(grid, shape=raw.shape)
    plan.decode(raw), plan.decode(raw)
    (said,) = (one.message for one in caplog.records if one.levelno == logging.WARNING)
    assert "The gaps between the micro-images are evenly at 6" in said
    assert "--dark" in said


@pytest.mark.slow
@pytest.mark.parametrize(
    ("radius", "black", "dark", "evenly"),
    [
        (6.0, 0, None, False),  # no black level
        (20.0, 0, None, False),  # micro-images that touch: their gaps are lit
        (20.0, 0, None, True),  # the same, all alike
        (6.0, 64, 64, False),  # subtracted
    ],
)
def test_gaps_that_are_black_or_lit_raise_no_alarm(caplog, rng, radius, black, dark, evenly):
    raw, grid = drawn("rectangular", radius, black, rng, evenly)
    dark = None if dark is None else np.full(raw.shape, dark)
    DecodePlan(grid, shape=raw.shape, dark=dark).decode(raw)
    assert not [one for one in caplog.records if "gaps" in one.message]
