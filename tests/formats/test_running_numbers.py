"""Views with one running number: the stated grid is that of the light field, in any order."""

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image
from scipy.ndimage import gaussian_filter
from tifffile import imwrite

from lf_flame import InputError, LightField, read_light_field
from lf_flame.commands.cli import commands
from lf_flame.formats import scan_view_folder, write_lenslet_image
from lf_flame.formats.view_files.parallax_order import find_order
from lf_flame.formats.view_files.running_numbers import fold
from lf_flame.refocus import find_sharpest_slope


def moved(rng, slopes=(1,), views=(3, 5), size=(56, 64)):
    """Stripes side by side, each of which moves by its whole slope from view to view."""
    widths = [size[1] // len(slopes)] * len(slopes)
    parts = []
    for slope, width in zip(slopes, widths, strict=True):
        texture = gaussian_filter(rng.normal(size=(size[0] + 60, width + 60)), 1.5)
        texture = np.rint(128 + 30 * texture / texture.std()).clip(0, 255).astype(np.uint8)
        part = [
            [np.roll(texture, (slope * v, slope * u), (0, 1)) for u in range(views[1])]
            for v in range(views[0])
        ]
        parts.append(np.array(part)[:, :, 30:-30, 30:-30])
    return np.concatenate(parts, axis=3)


def counted(views, order):
    """Views one by one, as a stage reaches them in this order."""
    *snake, first, second = order.split(",")
    flips = [name.startswith("-") for name in (first, second)]
    if "row" in second:
        views = views.swapaxes(0, 1)
    lines = [line[::-1] if flips[1] else line for line in (views[::-1] if flips[0] else views)]
    return np.concatenate([x[::-1] if snake and k % 2 else x for k, x in enumerate(lines)])


def write(folder, row, kind):
    """A row of views in a folder, as pages or as an array; with what has to be stated."""
    if kind == "folder":
        folder.mkdir()
        for number, view in enumerate(row):
            Image.fromarray(view).save(folder / f"img{number:03}.png")
        return folder, {}
    path = folder.with_suffix(kind)
    if kind == ".tif":
        imwrite(path, row, photometric="minisblack")
        return path, {}
    np.save(path, row)
    return path, {"axes": "nts"}


ORDERS = ["row,col", "-row,col", "col,row", "col,-row", "snake,row,col", "snake,col,row"]


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("kind", ["folder", ".tif", ".npy"])
def test_the_stated_grid_is_that_of_the_light_field(tmp_path, rng, order, kind):
    views = moved(rng)
    path, stated = write(tmp_path / "a", counted(views, order), kind)
    for given in (None, order):
        found = read_light_field(path, order=given, grid="3x5", **stated).views
        np.testing.assert_array_equal(found, views / np.float32(255))
    with pytest.raises(
        InputError, match="move as 3 rows of 5 do, not as 5 rows of 3: .*--grid 3x5"
    ):
        read_light_field(path, grid="5x3", **stated)
    assert find_sharpest_slope(found, np.arange(-2, 2.1, 0.25)).slope == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize(
    ("side", "order"),
    [
        (2, "row,col"),
        (3, "-row,col"),
        (2, "col,row"),
        (2, "snake,row,col"),
        (4, "snake,-row,col"),
        (3, "snake,col,row"),
    ],
)
def test_a_square_needs_no_grid(tmp_path, rng, side, order):
    views = moved(rng, views=(side, side))
    row = counted(views, order)
    (folder, _), (pages, _) = (write(tmp_path / "a", row, kind) for kind in ("folder", ".tif"))
    for given in (None, order):
        for path in (folder, pages):
            found = read_light_field(path, order=given).views
            np.testing.assert_array_equal(found, views / np.float32(255))
    if "snake" in order:
        assert f"order {order}, every other" in scan_view_folder(folder).describe()
    else:
        lines = row.reshape(side, *views.shape[1:])
        imwrite(tmp_path / "b.tif", lines, imagej=True, metadata={"axes": "TZYX"})
        found = read_light_field(tmp_path / "b.tif").views
        np.testing.assert_array_equal(found, views / np.float32(255))


@pytest.mark.parametrize(("shape", "grid"), [((3, 5), "3x5"), ((3, 3), None)])
def test_the_dark_image_has_the_order_of_the_light(tmp_path, rng, shape, grid):
    views = moved(rng, views=shape) // 2 + 60
    dark = rng.integers(0, 40, views.shape, np.uint8)
    for kind in ("folder", ".tif", ".npy"):
        (light, stated), (black, _) = (
            write(tmp_path / name, counted(kept, "snake,col,row"), kind)
            for name, kept in (("light", views), ("dark", dark))
        )
        found = read_light_field(light, grid=grid, dark=black, **stated).views
        np.testing.assert_allclose(255 * found, views.astype(float) - dark, atol=1e-3)


def test_a_missing_view_of_a_column_has_no_weight(tmp_path, rng):
    path, _ = write(tmp_path / "a", counted(moved(rng), "col,row"), "folder")
    (path / "img004.png").unlink()  # the second column's second view
    weights = read_light_field(path, grid=(3, 5)).weights
    np.testing.assert_array_equal(np.argwhere(weights == 0), [[1, 1]])


def test_names_may_count_columns_before_rows_of_the_stated_grid(tmp_path, rng):
    views = moved(rng)
    for v, u in np.ndindex(3, 5):
        if (v, u) != (2, 3):
            Image.fromarray(views[v, u]).save(tmp_path / f"x{u}_y{v}.png")
    for order in (None, "col,row"):
        weights = read_light_field(tmp_path, order=order, grid="3x5").weights
        np.testing.assert_array_equal(np.argwhere(weights == 0), [[2, 3]])
    with pytest.raises(InputError, match="5 x 3 views does not fit .* of 3 x 5"):
        read_light_field(tmp_path, grid="5x3")


def test_where_the_parallax_does_not_tell_the_stated_grid_is_filled_row_by_row(rng):
    row = rng.normal(size=(15, 40, 40))
    lines, found = fold(row, "views", (3, 5))
    np.testing.assert_array_equal(lines, row.reshape(3, 5, 40, 40))
    assert found.order == "row,col"
    assert not found.lead


def test_shuffled_views_are_no_square(rng):
    """Four neighbours alone agree with some order in most shuffles; all places do not."""
    views = moved(rng, (1, -1), (5, 5), (40, 80))
    row = views.reshape(25, *views.shape[2:])
    assert fold(row, "views")[1].order == "row,col"
    taken = 0
    for _ in range(25):
        try:
            fold(rng.permutation(row), "views")
            taken += 1
        except InputError:
            pass
    assert taken <= 1


def test_an_order_that_only_the_parallax_shows_may_be_turned_round(tmp_path, rng):
    """Near objects below slope 0, far ones above: the half-turn has them the other way round."""
    views = moved(rng, (-1, 1), (3, 3), (56, 80))
    told = "fits as well, and reverses all slopes: state --order="
    running, _ = write(tmp_path / "a", counted(views[::-1, ::-1], "row,col"), "folder")
    (line,) = [one for one in scan_view_folder(running).describe().splitlines() if told in one]
    order = line.partition("--order=")[2].split()[0]
    found = read_light_field(running, order=order).views
    np.testing.assert_array_equal(found, views / np.float32(255))
    assert told not in scan_view_folder(running, order).describe()
    assert told not in "".join(find_order(views).describe())  # as a mosaic or names state it
    assert told in "".join(find_order(views[::-1]).describe())


@pytest.mark.parametrize(
    "words", [["a.npy", "--axes", "vuts"], ["a.tif", "--views", "5"], ["a.npy"]]
)
def test_the_program_holds_every_array_against_the_parallax(tmp_path, rng, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    views = moved(rng, views=(5, 5))
    for turned, said in ((views[::-1], True), (views, False)):
        np.save("a.npy", turned)
        write_lenslet_image(LightField(turned / np.float32(255)), "a.tif", bits=32)
        done = CliRunner().invoke(commands, ["convert", *words, "b.npz"], catch_exceptions=False)
        assert ("wrong unless --order=-row,col" in done.stderr) == said
        stated = CliRunner().invoke(commands, ["convert", *words, "b.npz", "--order=row,col"])
        assert "wrong unless" not in stated.stderr
    if len(words) == 1:
        np.save("a.npy", views[::-1])
        assert (
            "wrong unless --order=-row,col" in CliRunner().invoke(commands, ["info", *words]).stdout
        )
