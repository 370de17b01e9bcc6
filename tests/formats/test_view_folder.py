"""Folders of views: names, grids, order, what is refused, and the way back."""

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
from sentences import refusals
from skimage.io import imsave
from tifffile import imwrite

from lf_flame import InputError, LightField, read_light_field
from lf_flame import write_light_field as write
from lf_flame.formats import scan_view_folder
from lf_flame.formats.view_files.orders import ORDERS, arranged, find_order, fold
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


def numbered(rows, columns, form):
    return [form.format(v, u) for v, u in product(rows, columns)]


# Names --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("names", "shape"),
    [
        (numbered(range(3), range(4), "{}_{}.png"), (3, 4)),
        (numbered(range(1, 4), range(1, 4), "2067_{:02}_{:02}.png"), (3, 3)),
        (numbered(range(2), range(12), "view_{}_{}.bmp"), (2, 12)),
        (numbered((4, 6, 8), (4, 6, 8), "scene1-v{:02d}-u{:02d}.tif"), (3, 3)),
        (numbered(range(1), range(9), "view_{:02}_{:02}.png"), (1, 9)),
        (numbered(range(1, 6), [1], "{}_{}.PNG"), (5, 1)),
        ([f"input_Cam{n:03}.png" for n in range(9)], (3, 3)),
        ([f"scene1_{n:03}.png" for n in range(9)], (3, 3)),
        ([f"frame{n}.png" for n in (10, 20, 30, 40)], (2, 2)),
        (["0.png", "0.5.png", "1.png", "1.5.png"], (2, 2)),
        (numbered(("0.00", "1.37", "2.74"), ("0", "1.37"), "y{}_x{}.png"), (3, 2)),
        (numbered((-40, -24, -8), (-40, -24), "pos_{}_{}.png"), (3, 2)),
        (numbered((-12.5, 0, 12.5, 25), (0, 12.5), "v1.20_y{:.2f}_x{:.2f}.png"), (4, 2)),
        (numbered((-1.25, 0, 1.25), (-1, 0.25), "y{:+.2f}_x{:.2f}.png"), (3, 2)),
        (numbered(range(9, 12), range(8, 11), "scene.{}.{}.png"), (3, 3)),
        (numbered(range(9, 12), range(8, 11), "view-{}-{}.png"), (3, 3)),
        ([f"a{3 * k}_{k // 2}_{k % 2}_{k}.png" for k in range(4)], (2, 2)),
        ([f"b{v % 2}_{v}_{u}_{9 * v + u}.png" for v, u in np.ndindex(3, 3)], (3, 3)),
    ],
    ids=lambda value: value[1] if isinstance(value, list) else "",
)
def test_names_are_found_row_by_row(tmp_path, rng, names, shape):
    views = levels(rng, (*shape, 5, 6))
    save(tmp_path, names, views)
    for grid in (None, shape):
        light_field = read_light_field(tmp_path, grid=grid)
        np.testing.assert_array_equal(light_field.views, views / np.float32(255))


def test_stanford_names_take_the_grid_and_not_the_positions(tmp_path, rng):
    views = levels(rng, (4, 4, 5, 6))
    places = [(-381.91 + 154.7 * v, 1103.38 - 55.1 * u) for v, u in np.ndindex(4, 4)]
    places = [(y + rng.uniform(-9, 9), x + rng.uniform(-9, 9)) for y, x in places]
    names = [f"out_{k // 4:02}_{k % 4:02}_{y:.6f}_{x:.6f}_.png" for k, (y, x) in enumerate(places)]
    save(tmp_path, names, views)
    np.testing.assert_array_equal(read_light_field(tmp_path).views, views / np.float32(255))


STAR = [(v, u) for v, u in np.ndindex(9, 9) if v in (4, u, 8 - u) or u == 4]
"""Places of EPINET's 33 of 9 x 9 views: the middle row and column, and both diagonals."""

EVERY = list(np.ndindex(9, 9))
CORNERS = [(0, 0), (0, 8), (8, 0), (8, 8)]
INNER = [at for at in EVERY if at not in CORNERS]


@pytest.mark.parametrize(
    ("form", "first", "there"),
    [
        ("input_Cam{2:03}.png", 0, STAR),
        ("input_Cam{2:03}.png", 0, EVERY[1:]),
        ("input_Cam{2:03}.png", 0, INNER),
        ("img{2}.png", 1, EVERY[1:]),
        ("view_{0:02}_{1:02}.png", 1, EVERY[9:]),
        ("view_{0}_{1}.png", 0, EVERY[:-9]),
        ("view_{0}_{1}.png", 0, INNER),
    ],
)
def test_numbers_are_places_in_the_stated_grid(tmp_path, form, first, there):
    """Each picture holds the number of its place, as a level."""
    running = "{2" in form
    for v, u in there:
        place = form.format(v + first, u + first, 9 * v + u + first * running)
        Image.new("L", (3, 2), 9 * v + u).save(tmp_path / place)
    found = read_light_field(tmp_path, grid="9x9")
    weights = np.zeros((9, 9))
    weights[tuple(zip(*there, strict=True))] = 1
    np.testing.assert_array_equal(found.weights, weights)
    wanted = weights * np.arange(81).reshape(9, 9) / 255
    np.testing.assert_allclose(found.views[..., 0, 0], wanted, atol=1e-7)


def test_names_choose_the_views_and_other_files_are_left_out(tmp_path, rng):
    views = levels(rng, (3, 3, 5, 6))
    save(tmp_path, numbered(range(3), range(3), "{}_{}.png"), views)
    (tmp_path / "SOURCE.txt").write_text("where it is from")
    (tmp_path / "._0_0.png").write_bytes(b"not a picture")
    imsave(tmp_path / "thumbnail.png", views[0, 0, ::2, ::2], check_contrast=False)
    folder = scan_view_folder(tmp_path)
    assert "3 x 3 views, top left 0_0.png, bottom right 2_2.png" in folder.describe()
    np.testing.assert_array_equal(folder.read().views, views / np.float32(255))
    imsave(tmp_path / "depth_0_0.png", views[0, 0], check_contrast=False)
    with pytest.raises(
        InputError, match=r"in numbers, got 9 of #_#.png, 1 of depth_#_#.png: choose"
    ):
        scan_view_folder(tmp_path)
    found = read_light_field(tmp_path, names="?_?.png")
    np.testing.assert_array_equal(found.views, folder.read().views)


def pictures(*names):
    """Call that writes small pictures of these names into the working folder, and reads them."""

    def call(**options):
        for name in names:
            Image.new("L", (4, 3)).save(name)
        return read_light_field(".", **options)

    return call


def uneven(form, *steps, order=None):
    names = numbered(*([step * n for n in range(3)] for step in steps), form)
    return partial(pictures(*names), order=order)


def test_a_row_and_a_column_without_views_are_holes():
    found = pictures(*numbered((0, 2, 5), (0, 2, 5), "{}_{}.png"))()
    np.testing.assert_array_equal(found.weights, np.outer([1, 0, 1, 0, 0, 1], [1, 0, 1, 0, 0, 1]))


STEPS, MM = "need equal steps along both axes, got", "y{:.2f}_x{:.2f}.png"
test_numbers_without_one_step_are_refused = refusals(
    [
        (uneven(MM, 1.37, 2.74), f"{STEPS} 0.00, 1.37, 2.74 and 0.00, 2.74, 5.48 by the numb"),
        (uneven(MM, 2.74, 1.37), f"{STEPS} 0.00, 2.74, 5.48 and 0.00, 1.37, 2.74"),
        (uneven(MM, 1.37, 1.39, order="col,-row"), STEPS),
        (uneven("{}_{}.png", 1, 2), f"{STEPS} 0, 1, 2 and 0, 2, 4 .* rename the files with 0, 1"),
        (uneven("{}_{}.png", 2, 1), f"{STEPS} 0, 2, 4 and 0, 1, 2"),
        (pictures(*numbered((0, 1.0, 2.5), (0, 1.0), MM)), f"{STEPS} 0.00, 1.00, 2.50"),
        (pictures(*numbered((0, 1.0), (0, 1.0, 2.5), MM)), f"{STEPS} 0.00, 1.00 and 0.00, 1.00, 2"),
        (pictures(*(f"{y:.2f}_{x:.2f}.png" for y, x in ((0, 0), (1.1, 0.2), (0.1, 1.3)))), "gaps"),
        (pictures("x0.00.png", "x1.00.png", "x2.50.png", "x4.00.png"), STEPS),
        (pictures(*numbered(("0.33", "0.67", "1.00"), (0, 0.33), "y{}_x{}.png")), STEPS),
        (pictures(*(f"{n}.png" for n in (0, 1, 2, 4))), "numbered 0, 1, 2, 4 with gaps"),
        (pictures(*numbered((1, 2), (1, 2), "{}.{}.png")), "numbered 1.1, 1.2, 2.1, 2.2 with gaps"),
        (
            partial(pictures(*(f"{9 * v + u:02}.png" for v, u in STAR)), grid="3x11"),
            "0, 4, 8, 10 ... 80, do not count 33 positions from 0",
        ),
        (partial(pictures("0_0.png", "0_1.png", "0_2.png"), grid="2x2"), "do not count 2 pos"),
        (partial(pictures("7.png", "8.png", "9.png"), grid="2x2"), "count 4 .* rename the files"),
        (partial(pictures(*(f"{10**30 + n}.png" for n in range(3))), grid="2x2"), "not count 4 po"),
        (
            pictures("0_0.png", "9999_0.png", "1_0.png", "5_1.png", "5_20000.png"),
            "cannot fill a grid of 10000 x 20001",
        ),
        (pictures(*(f"{n}.png" for n in range(7))), "form no square: .* --grid ROWSxCOLUMNS"),
    ]
)


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


# Order --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", ORDERS)
def test_a_stated_order_is_obeyed(tmp_path, rng, order):
    views = levels(rng, (2, 3, 4, 5))
    for v, u in product(range(2), range(3)):
        index = {"row": v, "-row": 1 - v, "col": u, "-col": 2 - u}
        one, other = (index[name] for name in order.split(","))
        save(tmp_path, [f"{one}_{other}.png"], views[v : v + 1, u : u + 1])
    for grid in (None, "2x3"):
        light_field = read_light_field(tmp_path, order=order.replace(",", ", "), grid=grid)
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
def test_where_the_parallax_shows_no_order_it_says_so(views):
    found = find_order(views)
    assert (found.order, found.slopes) == ("row,col", None)
    assert found.reason.startswith("as the numbers are: ")


def test_an_order_by_the_parallax_may_be_half_turned(rng):
    """Near objects below slope 0, far ones above: the half-turn has them the other way round."""
    views = on_both_sides(rng)
    assert len(find_order(views).describe()) == 1  # as a mosaic or names state it
    told = "".join(find_order(views[::-1]).describe())
    assert "order row,-col fits as well, and reverses all slopes: state --order=row,-col if" in told


# Running numbers ----------------------------------------------------------------------------------


def counted(folder, row, kind):
    """A row of views in a folder, as pages or as an array; with what has to be stated."""
    if kind == "folder":
        save(folder, [f"img{n:03}.png" for n in range(len(row))], row[:, None])
        return folder, {}
    path = folder.with_suffix(kind)
    if kind == ".npy":
        np.save(path, row)
        return path, {"axes": "nts"}
    imwrite(path, row, photometric="minisblack")
    return path, {}


KINDS = ["folder", ".tif", ".npy"]


def drawn(rng, shape=(3, 5)):
    return np.rint(255 * textured(rng, 0.7, views=shape)).astype(np.uint8)


@pytest.mark.parametrize("kind", KINDS)
def test_a_running_number_counts_the_stated_grid_row_by_row(tmp_path, rng, kind):
    views, dark = drawn(rng) // 2 + 60, rng.integers(0, 40, (3, 5, 60, 72), np.uint8)
    path, stated = counted(tmp_path / "a", views.reshape(15, 60, 72), kind)
    black, _ = counted(tmp_path / "dark", dark.reshape(15, 60, 72), kind)
    found = read_light_field(path, grid="3x5", **stated).views
    np.testing.assert_array_equal(found, views / np.float32(255))
    less = read_light_field(path, grid="3x5", dark=black, **stated).views
    np.testing.assert_allclose(255 * less, views.astype(float) - dark, atol=1e-3)
    with pytest.raises(InputError, match="15 views .* form no square"):
        read_light_field(path, **stated)
    with pytest.raises(InputError, match="grid of 2 x 5|not count 10"):
        read_light_field(path, grid="2x5", **stated)


def in_a_row(rng, count, axis=1):
    """Draw views along one row, or one column, with the numbers 0, 1 ..."""
    shape = (count, 1) if axis == 0 else (1, count)
    return textured(rng, 0.6, views=shape, shape=(60, 72)).reshape(count, 60, 72)


@pytest.mark.slow
@pytest.mark.parametrize(("count", "axis"), [(4, 0), (9, 1), (25, 1)])
def test_one_row_of_views_is_no_square(rng, count, axis):
    views = in_a_row(rng, count, axis)
    line = "1x{}" if axis else "{}x1"
    said = f"as one {'row' if axis else 'column'}, by the parallax, .*--grid {line.format(count)}"
    with pytest.raises(InputError, match=said):
        fold(views, "views")
    shape = (1, count) if axis else (count, 1)
    stated = fold(views, "views", shape)[0]
    found = find_sharpest_slope(stated, np.arange(-1, 1.01, 0.1))
    assert found.slope == pytest.approx(0.6, abs=0.02)


def test_what_is_no_square_is_not_said_to_be_one(rng):
    """Stripes in a row, other grids of a square number, noise, and shuffled views."""
    t, s = np.mgrid[:60, :60]
    rows = [rng.normal(size=(9, 60, 60)), np.ones((9, 60, 60))]
    for angle in np.deg2rad(range(0, 180, 18)):
        down, right = np.sin(angle), np.cos(angle)
        rows.append(np.array([np.sin((down * t + right * (s - 0.6 * n)) / 3) for n in range(9)]))
        rows[-1] += 0.01 * rng.normal(size=rows[-1].shape)
    for shape in ((4, 9), (2, 8)):
        rows.append(textured(rng, 0.6, views=shape).reshape(-1, 60, 72))
    square = on_both_sides(rng)[:, :4].reshape(16, 60, -1)
    rows += [rng.permutation(square) for _ in range(12)]
    for row in rows:
        found = fold(row, "views")[1]
        assert found.slopes is None
        assert "the parallax does not show an order" in found.reason
    assert fold(square, "views")[1].slopes is not None


# Files --------------------------------------------------------------------------------------------


SHAPES = st.tuples(*[st.integers(1, 3)] * 2, *[st.integers(1, 8)] * 2, st.sampled_from([0, 1, 3]))


@settings(max_examples=15, deadline=None)
@given(SHAPES, st.sampled_from([8, 16]), st.integers(0, 2**32))
def test_a_folder_comes_back(tmp_path_factory, shape, bits, seed):
    *shape, channels = shape
    shape = (shape[0] + 1, *shape[1:], *([channels] if channels else []))
    views = levels(np.random.default_rng(seed), shape, f"uint{bits}")
    views = (views / np.float32(2**bits - 1)).astype(np.float32)
    folder = tmp_path_factory.mktemp("round") / "views"
    write(LightField(views), folder, bits)
    expected = views[..., 0] if channels == 1 else views
    np.testing.assert_array_equal(read_light_field(folder).views, expected)


# Views side by side -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("order", "colour"), [("row,col", True), ("-row,col", False), ("col,row", True)]
)
def test_views_side_by_side_are_cut_apart(tmp_path, rng, order, colour):
    views = drawn(rng, (3, 4))
    views = np.stack([views, views // 2, 255 - views], axis=-1) if colour else views
    lines = views[::-1] if "-row" in order else views
    lines = lines.swapaxes(0, 1) if order.startswith("col") else lines
    picture = np.concatenate([np.concatenate(list(line), axis=1) for line in lines])
    Image.fromarray(picture).save(tmp_path / "mosaic.png")
    Image.fromarray(picture // 20).save(tmp_path / "dark.png")
    mosaic = f"{lines.shape[0]}x{lines.shape[1]}"
    expected = views / np.float32(255)
    found = read_light_field(tmp_path / "mosaic.png", mosaic=mosaic)
    np.testing.assert_array_equal(found.views, expected)
    stated = read_light_field(tmp_path / "mosaic.png", order=order, mosaic=mosaic)
    np.testing.assert_array_equal(stated.views, expected)
    less = read_light_field(tmp_path / "mosaic.png", mosaic=mosaic, dark=tmp_path / "dark.png")
    np.testing.assert_allclose(less.views, (views - views // 20) / 255, atol=1e-6)


# Real light fields --------------------------------------------------------------------------------


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
    with pytest.raises(InputError, match="one row, by the parallax"):
        fold(views[2, :4], "row")


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


@pytest.mark.slow
def test_the_still_life_has_the_slopes_of_its_true_depths():
    """Three by three views, four steps apart, and the depth of each pixel of the central one."""
    still = example("stilllife_3x3") / "stillLife_lf_3x3"
    folder = scan_view_folder(still / "lf")
    assert (folder.found.order, folder.files.shape) == ("row,col", (3, 3))
    depth = np.fromfile(still / "depth.bin", np.float32).reshape(768, 768)
    true = 288 - 614.4 * 9.375 / depth
    views = folder.read().views[..., 1]
    for rows, columns in ((np.s_[300:420], np.s_[300:420]), (np.s_[600:720], np.s_[100:220])):
        part = true[rows, columns]
        slopes = np.arange(-11, 11.01, 0.5)
        found = find_sharpest_slope(views[:, :, rows, columns], slopes).slope
        assert part.min() - 0.5 < found < part.max() + 0.5
