"""Slopes of planes in raws of round micro-images, made pixel by pixel by geometry of their own."""

import numpy as np
import pytest
import tifffile
from micro_images import Sensor

from lf_flame import LightField
from lf_flame.commands.reading_options import Reading
from lf_flame.formats import LensletGrid, decode_raw, estimate_grid
from lf_flame.refocus import find_sharpest_slope


def raw_of_a_plane(slope, hexagonal, seed=1, falloff=0.0):
    """Raw and white image of a plane that moves by `slope` pitches for each pixel."""
    sensor = Sensor((300, 344), 15, hexagonal=hexagonal)
    return sensor.plane(slope, seed, falloff), sensor.pixels(sensor.lit(falloff))


LEVELS = (0.52, 1.0, 0.61)
"""White behind a sensor's red, green and blue filters."""


def mosaic(colours, pattern):
    """Sensor image of three colour planes, with an even number of rows and columns."""
    out = np.zeros([n // 2 * 2 for n in colours[0].shape])
    for place, colour in enumerate(pattern):
        at = np.s_[place // 2 :: 2, place % 2 :: 2]
        number = "rgb".index(colour)
        out[at] = LEVELS[number] * colours[number][: out.shape[0], : out.shape[1]][at]
    return out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pattern", "slope", "hexagonal", "error"),
    [("rggb", -0.32, True, 0.008), ("gbrg", 0.6, False, 0.027)],
)
def test_each_colour_of_a_mosaic_is_decoded_from_its_own_pixels(pattern, slope, hexagonal, error):
    """Red, green and blue show planes of their own, at slopes of their own.

    At slopes at which a wave is 7 pixels long, red and blue have 3.3 pixels to it: outer views, to
    which light goes on from up to two pixels inside, make the steepest slope smaller.
    """
    slopes = (slope, -slope / 2, slope / 3)
    raws, whites = zip(
        *(raw_of_a_plane(one, hexagonal, seed=k, falloff=0.4) for k, one in enumerate(slopes)),
        strict=True,
    )
    raw, white = (np.rint(5e4 * mosaic(one, pattern)).astype(np.uint16) for one in (raws, whites))
    light_field = decode_raw(raw, estimate_grid(white), white=white, bayer=pattern)
    assert light_field.views.shape[4] == 3
    assert np.all(light_field.weights[[0, 0, -1, -1], [0, -1, 0, -1]] == 0)
    middle = light_field.views[7, 7].mean(axis=(0, 1))
    np.testing.assert_allclose(middle / 0.5, np.array(LEVELS) * middle[1] / 0.5, rtol=0.03)
    for channel, one in enumerate(slopes):
        truth = one * (2 / np.sqrt(3) if hexagonal else 1)
        alone = LightField(light_field.views[..., channel], weights=light_field.weights)
        found = find_sharpest_slope(alone, np.linspace(-1, 1, 41)).slope
        assert found == pytest.approx(truth, rel=error, abs=0.001)


def test_views_of_the_white_image_give_reflectance():
    """The white image's own level and colour are in neither raw nor quotient."""
    levels = np.tile([[0.5, 1.0], [1.0, 0.6]], (45, 45))
    grid, white = LensletGrid(7, 7, 15), np.ones((90, 90))
    one, other, itself = (
        decode_raw(raw * levels, grid, white=flat * levels, bayer="rggb").views
        for raw, flat in ((0.25 * white, white), (0.25 * white, 3 * white), (3 * white, 3 * white))
    )
    np.testing.assert_allclose(one, other, rtol=1e-5)
    np.testing.assert_allclose(one[7, 7, 2, 2], [0.125, 0.25, 0.15], rtol=1e-4)
    np.testing.assert_allclose(other / itself, 0.25 / 3, rtol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("hexagonal", [True, False])
def test_the_width_of_a_pixel_of_hexagonal_views_is_told(hexagonal, tmp_path, capsys):
    raw, white = raw_of_a_plane(0.1, hexagonal)
    for name, image in (("raw.tif", raw), ("white.tif", white)):
        tifffile.imwrite(tmp_path / name, image.astype(np.float32))
    Reading(white=tmp_path / "white.tif").read(tmp_path / "raw.tif")
    said = "".join(capsys.readouterr())
    assert ('must state layout = "hexagonal"' in said) == hexagonal
    assert "Black is taken as level 0" in said
    itself = Reading(lenslets=tmp_path / "raw.tif").read(tmp_path / "raw.tif")
    assert itself.shape[:2] == (15, 15)
