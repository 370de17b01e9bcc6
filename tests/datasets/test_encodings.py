"""What an image network is shown of a light field."""

from dataclasses import replace

import numpy as np
import pytest

from lf_flame import LightField
from lf_flame.datasets.encodings import InputEncoding, area_average, spread

SIZE = (4, 6)


@pytest.fixture
def light_field(rng):
    return LightField(rng.uniform(size=(5, 5, 8, 12)).astype(np.float32))


def test_raw_is_the_raw_image_resized_by_area(light_field):
    """Excluded views, such as a round aperture cuts, are in the raw image, too."""
    blocks = light_field.to_raw().reshape(4, 10, 6, 10).mean(axis=(1, 3))
    for weights in (None, np.eye(5)):
        found = InputEncoding().encode(replace(light_field, weights=weights), SIZE)
        np.testing.assert_allclose(found[..., 0], blocks, atol=1e-6)


def test_central_is_the_raw_image_resized_without_averaging(rng):
    """For odd numbers of views and of lenslets in a pixel, single pixels of the raw image."""
    light_field = LightField(rng.uniform(size=(5, 5, 12, 18)).astype(np.float32))
    raw = light_field.to_raw()
    assert raw.shape == (60, 90)
    found = InputEncoding("central").encode(light_field, SIZE)[..., 0]
    np.testing.assert_array_equal(found, raw[7::15, 7::15])
    np.testing.assert_array_equal(found, light_field.views[2, 2, 1::3, 1::3])


@pytest.mark.slow
def test_keras_and_tensorflow_show_the_central_view_of_the_papers_camera(rng):
    keras, tensorflow = pytest.importorskip("keras"), pytest.importorskip("tensorflow")
    light_field = LightField(rng.uniform(size=(15, 15, 270, 540)).astype(np.float32))
    found = InputEncoding("central").encode(light_field, (90, 180))
    raw = light_field.to_raw()[..., None]
    for method in ("bilinear", "nearest"):
        shown = tensorflow.image.resize(raw, (90, 180), method)
        np.testing.assert_array_equal(found, shown.numpy())
        layer = keras.layers.Resizing(90, 180, interpolation=method)
        np.testing.assert_array_equal(found, layer(raw[None])[0])


def test_views_are_the_ends_and_the_middle_of_the_middle_row(light_field):
    found = InputEncoding("views").encode(light_field, SIZE)
    for channel, u in enumerate((0, 2, 4)):
        view = area_average(light_field.views[2, u], SIZE)
        np.testing.assert_array_equal(found[..., channel], view)


def test_a_grid_shows_views_side_by_side(light_field):
    found = InputEncoding("grid").encode(light_field, SIZE)[..., 0]
    for row, v in enumerate((0, 2, 4)):
        for column, u in enumerate((0, 2, 4)):
            tile = found[4 * row : 4 * row + 4, 6 * column : 6 * column + 6]
            np.testing.assert_array_equal(tile, area_average(light_field.views[v, u], SIZE))


@pytest.mark.parametrize("kind", ["raw", "central", "views", "grid"])
def test_inputs_have_the_shape_that_is_announced(kind, light_field):
    encoding = InputEncoding(kind, grid=2)
    found = encoding.encode(light_field, SIZE)
    assert found.shape == encoding.shape(SIZE)
    assert found.dtype == np.float32


def test_inputs_saturate_as_a_sensor_does():
    bright = LightField(np.full((3, 3, 4, 6), 7.0))
    for kind in ("raw", "central", "views", "grid"):
        assert InputEncoding(kind).encode(bright, SIZE).max() == 1.0


def test_views_are_spread_from_the_first_to_the_last():
    assert spread(15, 3) == [0, 7, 14]
    assert spread(15, 2) == [0, 14]
    assert spread(15, 1) == [7]
    assert spread(3, 3) == [0, 1, 2]


def test_of_an_even_number_of_views_the_one_before_the_middle_is_central():
    assert [spread(count, 1) for count in (1, 2, 4, 14)] == [[0], [0], [1], [6]]
    assert InputEncoding("views").view_indices(4, 6) == [(1, 0), (1, 2), (1, 5)]
    views = np.zeros((4, 6, *SIZE), np.float32)
    views[1] = np.arange(1, 7)[:, None, None] / 8
    shown = InputEncoding("views").encode(LightField(views), SIZE)
    np.testing.assert_array_equal(shown[0, 0], [1 / 8, 3 / 8, 6 / 8])
