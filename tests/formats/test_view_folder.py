"""Folders of views: names, order, what is refused, and the way back."""

from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from builders import textured
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.ndimage import gaussian_filter
from skimage.io import imsave
from tifffile import imwrite

from lf_flame import InputError, Layer, LightField, Scene, read_light_field, render
from lf_flame.formats import read_view_folder, scan_view_folder, write_view_folder
from lf_flame.formats.view_files.orders import ORDERS, arranged
from lf_flame.formats.view_files.parallax_order import find_order
from lf_flame.formats.view_files.running_numbers import fold
from lf_flame.refocus import find_sharpest_slope, shift_and_sum

EXAMPLES = Path(__file__).parents[3] / "shared" / "lightfields"


def example(name):
    if not (EXAMPLES / name).is_dir():
        pytest.skip(f"the example light field {name} is not beside the checkout")
    return EXAMPLES / name


def save(folder, names, views):
    """Save views of levels in [v, u] order under the given names."""
    folder.mkdir(exist_ok=True)
    for name, view in zip(names, views.reshape(-1, *views.shape[2:]), strict=True):
        (imwrite if name.endswith("tif") else imsave)(
            folder / name, view, **({} if name.endswith("tif") else {"check_contrast": False})
        )


def levels(rng, shape, dtype=np.uint8):
    return rng.integers(0, np.iinfo(dtype).max, shape, dtype, endpoint=True)


def numbered(rows, columns, form, first=0, step=1):
    return [form.format(first + step * v, first + step * u) for v, u in product(rows, columns)]


@pytest.mark.parametrize(
    ("names", "shape"),
    [
        (numbered(range(3), range(4), "{}_{}.png"), (3, 4)),
        (numbered(range(3), range(3), "2067_{:02}_{:02}.png", first=1), (3, 3)),
        (numbered(range(2), range(12), "view_{}_{}.bmp"), (2, 12)),
        (numbered(range(3), range(3), "scene1-v{:02d}-u{:02d}.tif", first=4, step=2), (3, 3)),
        (numbered(range(1), range(9), "view_{:02}_{:02}.png"), (1, 9)),
        (numbered(range(5), range(1), "{}_{}.PNG", first=1), (5, 1)),
        ([f"input_Cam{n:03}.png" for n in range(9)], (3, 3)),
        ([f"scene1_{n:03}.png" for n in range(9)], (3, 3)),
        ([f"frame{n}.png" for n in (3, 7, 8, 12)], (2, 2)),
        (numbered((0, 15), (0, 3, 100), "mm_{:03}_{:03}.png"), (2, 3)),
        (
            [f"y{y}_x{x}.png" for y in ("0.00", "1.37", "2.74", "4.11", "5.48") for x in (0, 3, 6)],
            (5, 3),
        ),
        (numbered((-40, -24, -8), (-40, -8), "pos_{}_{}.png"), (3, 2)),
        (numbered((-12.5, 0, 2.25), (-1, 0.5), "y{:+.2f}_x{:.2f}.png"), (3, 2)),
        (numbered(range(9, 12), range(8, 11), "scene.{}.{}.png"), (3, 3)),
        (numbered(range(9, 12), range(8, 11), "view-{}-{}.png"), (3, 3)),
        ([f"cam_{n}.png" for n in range(-4, 5)], (1, 9)),
        ([f"{20240101120000000000 + 7**n}.png" for n in range(4)], (2, 2)),
    ],
    ids=lambda value: value[1] if isinstance(value, list) else "",
)
def test_names_are_found_row_by_row(tmp_path, rng, names, shape):
    views = levels(rng, (*shape, 5, 6))
    save(tmp_path, names, views)
    light_field = read_view_folder(tmp_path, grid=shape)
    np.testing.assert_array_equal(light_field.views, views / np.float32(255))


def test_a_missing_position_is_named(tmp_path, rng):
    names = numbered((-1.5, -0.5, 0.5), (0, 1), "p_{:.1f}_{}.png")
    save(tmp_path, names, levels(rng, (3, 2, 3, 4)))
    (tmp_path / "p_-0.5_1.png").unlink()
    folder = scan_view_folder(tmp_path)
    assert "1 view is missing and has weight 0: -0.5_1" in folder.describe()
    np.testing.assert_array_equal(folder.read().weights, [[1, 1], [1, 0], [1, 1]])


def in_a_row(rng, count, slope=0.6, axis=1):
    """Draw views along one row, or one column, with the numbers 0, 1 ..."""
    shape = (count, 1) if axis == 0 else (1, count)
    return textured(rng, slope, views=shape, shape=(60, 72)).reshape(count, 60, 72)


@pytest.mark.slow
@pytest.mark.parametrize(("count", "axis"), [(4, 0), (25, 1)])
def test_one_row_of_views_is_no_square(tmp_path, rng, count, axis):
    views = in_a_row(rng, count, axis=axis)
    stored = np.rint(255 * views).astype(np.uint8)
    save(tmp_path / "row", [f"cam{n:02}.png" for n in range(count)], stored[None])
    imwrite(tmp_path / "pages.tif", views, photometric="minisblack", metadata={"axes": "ZYX"})
    imwrite(tmp_path / "i.tif", views[None], imagej=True, metadata={"axes": "TZYX"})
    np.save(tmp_path / "n.npy", views)
    for name in ("row", "pages.tif", "i.tif", "n.npy"):
        axes = "nts" if name == "n.npy" else None
        for order in (None, "row,col"):
            with pytest.raises(InputError, match=rf"{count} views .*--grid 1x{count}, if"):
                read_light_field(tmp_path / name, order=order, axes=axes)
        grid = (count, 1) if axis == 0 else f"1x{count}"
        light_field = read_light_field(tmp_path / name, grid=grid, axes=axes)
        assert light_field.views.shape == ((count, 1) if axis == 0 else (1, count)) + (60, 72)
    found = find_sharpest_slope(light_field, np.arange(-1, 1.01, 0.1))
    assert found.slope == pytest.approx(0.6, abs=0.02)


@pytest.mark.parametrize(("count", "axis"), [(4, 0), (9, 1)])
def test_a_row_of_slanted_stripes_is_no_square(rng, count, axis):
    """Where gradients down and right go together, rows and columns seem alike."""
    t, s = np.mgrid[:60, :60]
    for angle in np.deg2rad(range(0, 180, 9)):
        down, right = np.sin(angle), np.cos(angle)
        moved = [0.6 * n * (right, down)[axis] for n in range(count)]
        row = np.array([np.sin((down * t + right * s - move) / 3) for move in moved])
        row += 0.01 * rng.normal(size=row.shape)
        with pytest.raises(InputError, match="shows no"):
            fold(row, "row")


@pytest.mark.parametrize("shape", [(4, 9), (2, 8)])
def test_a_square_number_in_other_rows_is_no_square(rng, shape):
    views = textured(rng, 0.6, views=shape)
    with pytest.raises(InputError, match="shows no"):
        fold(views.reshape(-1, *views.shape[2:]), "views")


def test_what_does_not_tell_is_no_snake(rng):
    for views in (rng.normal(size=(9, 60, 60)), np.ones((9, 60, 60)), in_a_row(rng, 9)):
        with pytest.raises(InputError, match="shows no"):
            fold(views, "views")


def test_stanford_names_take_the_grid_and_not_the_positions(tmp_path, rng):
    views = levels(rng, (4, 4, 5, 6))
    places = [(-381.91 + 154.7 * v, 1103.38 - 55.1 * u) for v, u in product(range(4), range(4))]
    names = [f"out_{k // 4:02}_{k % 4:02}_{y:.6f}_{x:.6f}_.png" for k, (y, x) in enumerate(places)]
    assert any("_-" in name for name in names)
    assert any("_-" not in name for name in names)
    save(tmp_path, names, views)
    np.testing.assert_array_equal(read_view_folder(tmp_path).views, views / np.float32(255))


def test_other_files_are_left_out(tmp_path, rng):
    views = levels(rng, (3, 3, 5, 6))
    save(tmp_path, numbered(range(3), range(3), "{}_{}.png"), views)
    (tmp_path / "SOURCE.txt").write_text("where it is from")
    (tmp_path / "._0_0.png").write_bytes(b"not a picture")
    (tmp_path / "gt_disp_lowres.pfm").write_bytes(b"Pf")
    imsave(tmp_path / "thumbnail.png", views[0, 0, ::2, ::2], check_contrast=False)
    imsave(tmp_path / "depth_0_0.png", views[0, 0], check_contrast=False)
    folder = scan_view_folder(tmp_path)
    assert folder.left_out == 5
    assert "3 x 3 views, top left 0_0.png, bottom right 2_2.png" in folder.describe()
    assert "left out: 5" in folder.describe()
    np.testing.assert_array_equal(folder.read().views, views / np.float32(255))


@pytest.mark.parametrize("order", ORDERS)
def test_a_stated_order_is_obeyed(tmp_path, rng, order):
    views = levels(rng, (2, 3, 4, 5))
    for v, u in product(range(2), range(3)):
        index = {"row": v, "-row": 1 - v, "col": u, "-col": 2 - u}
        first, second = (index[name] for name in order.split(","))
        save(tmp_path, [f"{first}_{second}.png"], views[v : v + 1, u : u + 1])
    light_field = read_light_field(tmp_path, order=order.replace(",", ", "))
    np.testing.assert_array_equal(light_field.views, views / np.float32(255))


STORED = {
    "row,col": lambda views: views,
    "-row,col": lambda views: views[::-1],
    "col,row": lambda views: views.swapaxes(0, 1),
    "col,-row": lambda views: views[::-1].swapaxes(0, 1),
}
"""Views as a file holds them in these orders."""


def on_both_sides(rng):
    """Depths on both sides of the focal plane."""
    return np.concatenate([textured(rng, slope) for slope in (-0.8, 0.8)], axis=3)


def beside_noise(rng):
    """Weak noise in most of the image: taken for texture, its patches have any slope."""
    views = textured(rng, 0.7, shape=(60, 120))
    views[..., 44:] = 0.5 + 0.002 * rng.normal(size=views[..., 44:].shape)
    return views


@pytest.mark.parametrize(
    ("draw", "order", "slopes"),
    [
        (partial(textured, slope=-3.0), "row,col", (-3.0, -3.0)),
        (partial(textured, slope=0.7), "-row,col", (0.7, 0.7)),
        (partial(textured, slope=-0.2), "col,row", (-0.2, -0.2)),
        (partial(textured, slope=0.7), "col,-row", (0.7, 0.7)),
        *((on_both_sides, order, (-0.8, 0.8)) for order in ("row,col", "-row,col", "col,row")),
        (beside_noise, "row,col", (0.7, 0.7)),
    ],
)
def test_the_order_is_found_by_the_parallax(rng, draw, order, slopes):
    views = draw(rng)
    stored = STORED[order](views)
    found = find_order(stored)
    assert found.order == order
    assert found.slopes == pytest.approx(slopes, abs=0.1, rel=0.3)
    np.testing.assert_array_equal(arranged(stored, found.order), views)


def test_where_the_columns_run_the_other_way_the_slope_changes_its_sign(rng):
    found = find_order(textured(rng, 0.7)[:, ::-1])
    assert found.order == "-row,col"
    assert found.slopes == pytest.approx((-0.7, -0.7), abs=0.1)


def test_views_of_24_pixels_are_enough(rng):
    """A patch of 16 pixels and a border of 4 on each side."""
    assert find_order(textured(rng, 0.7, shape=(24, 48))[::-1]).order == "-row,col"
    assert find_order(textured(rng, 0.7, shape=(23, 48))[::-1]).slopes is None


def diagonal_stripes(slope):
    """Draw stripes along which rows and columns change alike, so that either can be either."""
    v, u, t, s = np.ogrid[-1:2, -1:2, :60, :60]
    return np.sin((t - slope * v + s - slope * u) / 3)


@pytest.mark.parametrize(
    "views",
    [
        np.ones((3, 3, 60, 60)),
        np.tile(np.sin(np.arange(60) / 3), (3, 3, 60, 1)),
        np.random.default_rng(1).normal(size=(3, 3, 60, 60)),
        np.random.default_rng(1).normal(size=(3, 3, 6, 60)),
        diagonal_stripes(0.7),
        np.random.default_rng(1).normal(size=(1, 9, 60, 60)),
    ],
    ids=["uniform", "all alike", "noise", "small", "diagonal", "one row"],
)
def test_where_the_parallax_does_not_tell_the_numbers_stand(views):
    found = find_order(views)
    assert found.order == "row,col"
    assert found.reason.startswith("as the numbers stand")
    assert found.slopes is None


def test_a_simulated_camera_is_row_by_row_and_near_is_the_lower_slope(rng, small_camera, tmp_path):
    camera = replace(small_camera, lenslets=(40, 48))
    texture = gaussian_filter(rng.uniform(size=(200, 240)), 6)
    texture = (texture - texture.min()) / np.ptp(texture) / 1.01
    for depth in (6.0, -5.0):
        layer = Layer(texture, depth_mm=depth, size_mm=(8.0, 9.6))
        folder = tmp_path / f"{depth:g}"
        write_view_folder(render(Scene([layer]), camera), folder)
        found = scan_view_folder(folder).found
        assert found.order == "row,col"
        assert found.slopes == pytest.approx([float(camera.depth_to_slope(depth))] * 2, rel=0.2)
        assert np.sign(found.slopes[0]) == np.sign(depth)


def test_missing_views_are_named(tmp_path, rng):
    names = numbered(range(9), range(9), "view_{:02}_{:02}.png", first=1)
    save(tmp_path, names, levels(rng, (9, 9, 2, 2)))
    (tmp_path / "view_03_07.png").unlink()
    for k in range(1, 10):
        (tmp_path / f"view_05_{k:02}.png").unlink()
    said = "10 views are missing and have weight 0: 03_07, 05_01, 05_02 and 7 more"
    assert said in scan_view_folder(tmp_path).describe()
    for k in (1, 2, 7):
        for name in numbered([k], range(9), "view_{:02}_{:02}.png", first=1):
            (tmp_path / name).unlink(missing_ok=True)
    with pytest.raises(InputError, match=r"9 x 9 .*view_01_01.png, views 02_01, .* --grid 9x9 rea"):
        read_view_folder(tmp_path)
    assert read_view_folder(tmp_path, grid="9x9").weights.sum() == 81 - 36


def test_a_cross_of_views_is_read_in_its_stated_grid(tmp_path, rng):
    views = np.rint(255 * textured(rng, 0.6, views=(5, 5))).astype(np.uint8)
    save(tmp_path, numbered(range(5), range(5), "{}_{}.png"), views)
    weights = np.zeros((5, 5))
    weights[2], weights[:, 2] = 1, 1
    for v, u in np.argwhere(weights == 0):
        (tmp_path / f"{v}_{u}.png").unlink()
    with pytest.raises(InputError, match="do not number a grid"):
        read_view_folder(tmp_path)
    found = read_view_folder(tmp_path, grid="5x5")
    np.testing.assert_array_equal(found.weights, weights)
    assert find_sharpest_slope(found, np.arange(-1, 1.01, 0.1)).slope == pytest.approx(
        0.6, abs=0.02
    )


@pytest.mark.parametrize("gap", [(0, 0), (1, 2), (2, 2)])
def test_what_is_missing_changes_nothing_else(tmp_path, rng, gap):
    """The order is found beside the gap, and the picture is that of the other views."""
    views = np.rint(200 * textured(rng, 0.6, views=(4, 5))).astype(np.uint8) + 40
    save(tmp_path / "light", numbered(range(4), range(5), "{1}_{0}.png"), views)
    save(tmp_path / "dark", numbered(range(4), range(5), "{1}_{0}.png"), views // 20)
    (tmp_path / "light" / f"{gap[1]}_{gap[0]}.png").unlink()
    (tmp_path / "dark" / "4_3.png").unlink()
    weights = np.ones((4, 5))
    weights[gap] = 0
    found = read_light_field(tmp_path / "light")
    np.testing.assert_array_equal(found.weights, weights)
    assert "1 of the 20 views do not count: they are missing" in found.uncounted
    expected = shift_and_sum(views / np.float32(255), 0.6, weights=weights)
    np.testing.assert_allclose(shift_and_sum(found, 0.6), expected, atol=1e-6)
    weights[3, 4] = 0
    less = read_light_field(tmp_path / "light", dark=tmp_path / "dark")
    np.testing.assert_array_equal(less.weights, weights)
    there = (views - views // 20) / np.float32(255)
    np.testing.assert_allclose(less.views[weights > 0], there[weights > 0], atol=1e-6)


def test_a_missing_running_number_is_named(tmp_path, rng):
    save(tmp_path, [f"input_Cam{n:03}.png" for n in range(9)], levels(rng, (3, 3, 2, 2)))
    (tmp_path / "input_Cam004.png").unlink()
    with pytest.raises(InputError, match="view 004 is missing; --grid ROWSxCOLUMNS reads the oth"):
        read_view_folder(tmp_path)
    np.testing.assert_array_equal(
        read_view_folder(tmp_path, grid="3x3").weights, [[1, 1, 1], [1, 0, 1], [1, 1, 1]]
    )
    (tmp_path / "input_Cam008.png").rename(tmp_path / "input_Cam004.png")  # the last is missing
    with pytest.raises(InputError, match=r"holds 8 views .* make no square: .* --grid 1x8"):
        read_view_folder(tmp_path)


@pytest.mark.parametrize("mode", ["RGBA", "P", "1"])
def test_transparency_palettes_and_single_bits_are_read(tmp_path, rng, mode):
    grey = rng.integers(0, 2, (4, 5, 6)) * 255
    for k, view in enumerate(grey.astype(np.uint8)):
        image = Image.fromarray(view).convert(mode)
        if "A" in mode:
            image.putalpha(Image.fromarray(levels(rng, (5, 6))))
        image.save(tmp_path / f"{k}.png")
    views = read_view_folder(tmp_path, grid="2x2").views
    views = views if views.ndim == 4 else views[..., 1]
    np.testing.assert_array_equal(views.reshape(4, 5, 6), grey / 255)


def test_floats_stay_as_they_are(tmp_path, rng):
    views = rng.normal(size=(2, 2, 5, 6)).astype(np.float32) * 1e3
    save(tmp_path, numbered(range(2), range(2), "{}_{}.tif"), views)
    np.testing.assert_array_equal(read_view_folder(tmp_path).views, views)


SHAPES = st.tuples(*[st.integers(1, 3)] * 2, *[st.integers(1, 8)] * 2, st.sampled_from([0, 1, 3]))


@settings(max_examples=15, deadline=None)
@given(SHAPES, st.sampled_from([8, 16]), st.integers(0, 2**32))
def test_a_folder_comes_back(tmp_path_factory, shape, bits, seed):
    *shape, channels = shape
    shape = (shape[0] + 1, *shape[1:])
    shape = (*shape, channels) if channels else shape
    views = levels(np.random.default_rng(seed), shape, f"uint{bits}")
    views = (views / np.float32(2**bits - 1)).astype(np.float32)
    folder = tmp_path_factory.mktemp("round") / "views"
    write_view_folder(LightField(views), folder, bits)
    expected = views[..., 0] if channels == 1 else views
    np.testing.assert_array_equal(read_light_field(folder).views, expected)


def test_any_value_comes_back_to_half_a_level(tmp_path, rng):
    views = rng.uniform(size=(2, 12, 5, 6)).astype(np.float32)
    for bits in (8, 16):
        write_view_folder(LightField(views), tmp_path / str(bits), bits)
        back = read_view_folder(tmp_path / str(bits)).views
        np.testing.assert_allclose(back, views, rtol=0, atol=0.5001 / (2**bits - 1))


def test_a_writer_that_is_cut_leaves_nothing(tmp_path, rng, monkeypatch):
    written = []

    def full(path, levels, **_):
        if written:
            raise OSError("disk full")
        written.append(path)
        path.write_bytes(b"half")

    monkeypatch.setattr("lf_flame.formats.view_files.folder_output.write_image", full)
    with pytest.raises(OSError, match="disk full"):
        write_view_folder(LightField(rng.uniform(size=(2, 2, 3, 3))), tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_lytro_views_are_row_by_row_and_near_is_in_front():
    folder = scan_view_folder(example("lytro_2067"))
    assert folder.files.shape == (9, 9)
    assert folder.found.order == "row,col"
    views = replace(folder, files=folder.files[2:7, 2:7]).read().views
    assert views.shape == (5, 5, 383, 552, 3)
    low, high = folder.found.slopes
    sharpest = find_sharpest_slope(views[..., 100:250, 150:400, 1], np.arange(-1.5, 1.6, 0.25))
    assert low < sharpest.slope < min(high, 0)
    for order, stored in STORED.items():
        assert find_order(stored(views)).order == order


@pytest.mark.slow
def test_parallel_cameras_counted_from_the_bottom_right_are_turned():
    """The shop's views have slopes above 0; cameras that look the same way have them below."""
    plain = scan_view_folder(example("shop_mossberg"))
    assert plain.found.order == "row,col"
    assert 0.5 < plain.found.slopes[0] < plain.found.slopes[1] < 6.5
    assert "state --order=-row,-col if" in plain.describe()
    turned = scan_view_folder(example("shop_mossberg"), "-row,-col")
    views = replace(turned, files=turned.files[1:6, 1:6]).read().views[..., 1]
    views = np.ascontiguousarray(views[:, :, ::2, ::2])  # halves the slopes
    ahead, behind = (shift_and_sum(views, slope)[40:-40, 40:-40] for slope in (-1.5, 1.5))
    assert np.square(np.diff(ahead)).mean() > 5 * np.square(np.diff(behind)).mean()
