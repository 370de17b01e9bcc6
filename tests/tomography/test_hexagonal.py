"""Emission from raws of hexagonal lenslets, made pixel by pixel by geometry of the test's own."""

from dataclasses import replace

import numpy as np
import pytest
from micro_images import nearest_lenslet

from experiments.emission.truth import Lens, Sheet, cells
from lf_flame import PAPER_CAMERA
from lf_flame.formats import decode_raw, estimate_grid
from lf_flame.tomography import FrustumGrid, reconstruct

VIEWS, SUB, ROW = 9, 3, np.sqrt(3) / 2
LENS = Lens(views=VIEWS)
SHEETS = [Sheet(3.0, (0.2, -0.5), (0.6, 0.4)), Sheet(-4.0, (-0.2, 0.6), (0.5, 0.45))]
"""Difference of the vergences of the focal plane and of the first sheet, per mm."""


def raw_and_white(rows=34, columns=32):
    """A pixel sees what its lenslet, whose second moment is 5 / 72 of its squared width, sees."""
    shape = round(VIEWS * (ROW * rows + 1)), round(VIEWS * (columns + 1.5))
    y, x = ((np.arange(n * SUB) + 0.5) / SUB - 0.5 - VIEWS / 2 for n in shape)
    y, x = np.meshgrid(y, x, indexing="ij")
    row, column, down, right = nearest_lenslet(y, x, VIEWS, hexagonal=True)
    light, middle = 0.0, (ROW * (rows - 1) / 2, (columns - 0.5) / 2)
    for sheet in SHEETS:
        far = sheet.depth / LENS.focus
        one = sheet.peak
        for axis, (place, way) in enumerate(((row * ROW, down), (column, right))):
            at = LENS.cell * (place - middle[axis]) * (1 + far) - LENS.step * way * far
            width = np.sqrt(sheet.width[axis] ** 2 + 10 / 72 * (LENS.cell * (1 + far)) ** 2)
            seen = np.exp(-(((at - sheet.middle[axis]) / width) ** 2))
            one = one * seen * sheet.width[axis] / width
        light = light + one
    lit = np.hypot(down, right) <= VIEWS / 2
    pixels = (shape[0], SUB, shape[1], SUB)
    return tuple(a.reshape(pixels).mean(axis=(1, 3)) for a in (light * lit, 1.0 * lit))


@pytest.fixture(scope="module")
def decoded():
    raw, white = raw_and_white()
    return decode_raw(raw, estimate_grid(white), white=white)


def emission(light_field, **changes):
    """Emission by the camera whose square cells are as wide as the rows are apart."""
    camera = replace(PAPER_CAMERA, views=VIEWS, lenslets=light_field.views.shape[2:4], **changes)
    grid = FrustumGrid(camera, [3.0, -4.0])
    return reconstruct(light_field, grid), grid


@pytest.mark.slow
def test_emission_behind_hexagonal_lenslets(decoded):
    """With pitch and focal length of the lenslets times the distance of their rows in pitches."""
    found, grid = emission(decoded, lenslet_pitch_mm=0.112 * ROW, lenslet_focal_mm=0.4 * ROW)
    assert len(found.warnings) == 1
    assert "views are fitted" in found.warnings[0]
    for one, sheet in zip(found.emission.astype(float), SHEETS, strict=True):
        side = grid.cell_mm(sheet.depth)
        light = np.pi * np.prod(sheet.width)
        assert one.sum() * side**2 == pytest.approx(light, rel=5e-3)
        # Where the decoded part of the sensor begins, only the whole picture tells.
        places = [(np.arange(n) - (n - 1) / 2) * side for n in one.shape]
        middle = places[0] @ one.sum(axis=1), places[1] @ one.sum(axis=0)
        placed = replace(sheet, middle=tuple(np.array(middle) / one.sum()))
        lens = Lens(views=VIEWS, lenslets=one.shape, pitch=0.112 * ROW)
        truth = cells(lens, placed)
        assert np.linalg.norm(one - truth) < 0.025 * np.linalg.norm(truth)
