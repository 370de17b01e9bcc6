"""The raw image: behind lenslet (t, s) lie the pixels of all views, in blocks of v x u."""

import numpy as np
import pytest

from lf_flame.simulation.optical_pass import arrange, as_views, blank_image, seen_range


def test_blank_images_have_the_shape_of_the_sensor(small_camera):
    n, (lines, columns) = small_camera.views, small_camera.lenslets
    assert blank_image(small_camera, "views").shape == (n, n, lines, columns)
    raw = blank_image(small_camera, "raw", np.float64)
    assert raw.shape == (1, 1, n * lines, n * columns)
    assert raw.dtype == np.float64
    assert not raw.any()


def test_views_of_a_raw_image_are_its_own_pixels(small_camera):
    n, (lines, columns) = small_camera.views, small_camera.lenslets
    raw = blank_image(small_camera, "raw", np.int64)
    raw[...] = np.arange(raw.size).reshape(raw.shape)
    views = as_views(raw, small_camera, "raw")
    assert views.shape == (n, n, lines, columns)
    assert np.shares_memory(views, raw)
    for v, u in ((0, 0), (1, n - 1), (n - 1, 2)):
        np.testing.assert_array_equal(views[v, u], raw[0, 0, v::n, u::n])
    assert as_views(views, small_camera, "views") is views


@pytest.mark.parametrize("more", [(), (3,), (2, 4)])
def test_tables_follow_the_order_of_the_pixels(more, rng):
    table = rng.random((5, 7, *more))
    raw = arrange(table, "raw", 0)
    assert raw.shape == (1, 35, *more)
    for view, lenslet in np.ndindex(5, 7):
        np.testing.assert_array_equal(raw[0, 5 * lenslet + view], table[view, lenslet])
    assert arrange(table, "views", 0) is table


def test_places_that_see_a_plane_are_framed():
    seen = np.array([[0, 1, 0, 1, 0], [1, 1, 1, 1, 1], [0, 0, 0, 0, 0], [0, 0, 0, 0, 1]], bool)
    first, last = seen_range(seen)
    np.testing.assert_array_equal(first, [1, 0, 0, 4])
    np.testing.assert_array_equal(last, [4, 5, 0, 5])
