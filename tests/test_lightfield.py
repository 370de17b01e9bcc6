import numpy as np
import pytest

from lf_flame import InputError, LightField, shift_and_sum


def test_a_raw_image_is_micro_images_in_sensor_order_and_back(rng):
    views = rng.uniform(size=(3, 3, 4, 5)).astype(np.float32)
    raw = LightField(views).to_raw()
    assert raw.shape == (12, 15)
    np.testing.assert_array_equal(LightField.from_raw(raw, views=3).views, views)
    v, u, t, s = 2, 0, 1, 4
    assert raw[t * 3 + v, s * 3 + u] == views[v, u, t, s]


def test_colour_keeps_its_axis(rng):
    raw = rng.uniform(size=(6, 8, 3)).astype(np.float32)
    light_field = LightField.from_raw(raw, views=2)
    assert light_field.views.shape == (2, 2, 3, 4, 3)
    np.testing.assert_array_equal(light_field.to_raw(), raw)


def test_photograph_is_the_mean_view(rng):
    views = rng.uniform(size=(3, 3, 4, 5)).astype(np.float32)
    np.testing.assert_allclose(LightField(views).photograph, views.mean(axis=(0, 1)), rtol=1e-6)


def test_numpy_takes_a_light_field_for_its_views(rng):
    views = rng.uniform(size=(3, 3, 4, 5)).astype(np.float32)
    light_field = LightField(views)
    assert np.asarray(light_field) is views
    assert np.asarray(light_field, np.float64).dtype == np.float64
    np.testing.assert_array_equal(np.asarray(light_field, np.float64), views)
    assert not np.shares_memory(np.array(light_field), views)
    assert np.mean(light_field) == views.mean()
    assert LightField(light_field).views is views


def test_odd_shaped_and_unfinite_raw_images_are_refused():
    with pytest.raises(InputError, match=r"multiples of the 15 pixels.*\(31, 30\)"):
        LightField.from_raw(np.ones((31, 30)), views=15)
    with pytest.raises(InputError, match="must be finite, got 1 NaN"):
        LightField.from_raw(np.where(np.eye(30) * np.arange(30) == 7, np.nan, 1.0), views=15)
    with pytest.raises(InputError, match="real-valued"):
        LightField(np.ones((2, 2, 2, 2), complex))
    with pytest.raises(InputError, match="and of one shape"):
        LightField([[np.ones((2, 3)), np.ones((2, 2))]])


@pytest.mark.slow
def test_named_axes_go_in_and_come_out(rng):
    xarray = pytest.importorskip("xarray")
    views = rng.uniform(size=(3, 5, 4, 6, 3)).astype(np.float32)
    named = xarray.DataArray(views, dims=("v", "u", "t", "s", "channel"))
    turned = LightField(named.transpose("channel", "s", "u", "t", "v"))
    np.testing.assert_array_equal(turned.views, views)
    # Functions that take views alone know the names too.
    mean = turned.photograph
    np.testing.assert_allclose(
        shift_and_sum(named.transpose("channel", "s", "u", "t", "v"), 0.0), mean, rtol=1e-5
    )
    out = turned.to_xarray()
    assert out.dims == named.dims
    np.testing.assert_array_equal(out.sel(v=-1.0, u=2.0), views[0, 4])
    with pytest.raises(InputError, match="must be named v, u, t, s .* got y, u, t, s"):
        LightField(named[..., 0].rename(v="y"))


def test_values_whose_sums_float32_does_not_hold_are_refused():
    with pytest.raises(InputError, match=r"must be at most 1e\+37, .* got 3e\+38: scale them"):
        LightField(np.full((3, 3, 4, 6), -3e38))


def test_it_says_what_it_is(rng):
    colour = LightField(rng.uniform(size=(3, 5, 4, 6, 3)))
    assert repr(colour) == "LightField(3 x 5 views of 4 x 6 pixels, colour)"
    assert (colour.shape, colour.channels) == ((3, 5, 4, 6, 3), 3)
    grey = colour.grey()
    assert (grey.channels, grey.grey()) == (1, grey)
    np.testing.assert_allclose(grey.views, colour.views.mean(axis=4), rtol=1e-6)


def test_known_pixels_of_views_that_count():
    views = np.array([[[[9.0, 1.0]], [[5.0, 2.0]]]])
    for known, expected in (([[[[1, 1]], [[0, 1]]]], [2.0]), ([[[[1, 1]], [[0, 0]]]], views)):
        found = LightField(views, weights=[[0, 1]], valid=known).used_values
        np.testing.assert_array_equal(found, expected)
