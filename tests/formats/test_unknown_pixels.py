"""What saturated and bad pixels, and dark lenslets, leave unknown in a decoded raw image."""

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner
from micro_images import waves

from lf_flame import LightField
from lf_flame.commands.cli import commands
from lf_flame.formats import DecodePlan, LensletGrid, read_light_field, write_light_field
from lf_flame.refocus import find_sharpest_slope, shift_and_sum


def raw_of_a_highlight(pitch, slope, lenslets=(30, 34), sub=3):
    """Raw of a plane of waves with a highlight: it moves by `slope` lenslets over a micro-image."""
    shape = [int(pitch * n) for n in lenslets]
    places = [((np.arange(n * sub) + 0.5) / sub / pitch) for n in shape]
    whole = [np.floor(place) for place in places]
    t, s = (
        i - slope * (place - i - 0.5) - (n - 1) / 2
        for i, place, n in zip(whole, places, lenslets, strict=True)
    )
    t, s = np.meshgrid(t, s, indexing="ij")
    rng = np.random.default_rng(1)
    light = 0.5 + 2 * np.exp(-((t - 3) ** 2 + (s + 2) ** 2) / 25)
    light = light + waves(t, s, 0.03, rng)
    return light.reshape(shape[0], sub, shape[1], sub).mean(axis=(1, 3))


@pytest.mark.slow
@pytest.mark.parametrize("pitch", [9, 10.4])
def test_saturated_pixels_are_unknown_in_every_view_that_they_touch(pitch):
    full, grid = (
        raw_of_a_highlight(pitch, -2.5),
        LensletGrid((pitch - 1) / 2, (pitch - 1) / 2, pitch),
    )
    full /= 0.6 * full.max()  # 1 is the largest level of a sensor
    plan = DecodePlan(grid, shape=full.shape, views=9)
    whole, found = plan.decode(full), plan.decode(np.minimum(full, 1))
    assert whole.valid is None
    counts = np.broadcast_to(plan.weights[..., None, None], found.valid.shape)
    assert found.valid[~counts].all()  # what does not count need not be known
    known = counts & found.valid
    np.testing.assert_allclose(found.views[known], whole.views[known], rtol=0.005)
    off = np.abs(found.views / whole.views - 1) > 0.02
    assert np.all(off[counts & ~known].mean() > (0.95 if pitch == 9 else 0.7))
    slopes = np.linspace(-1, 1, 41)
    truth = find_sharpest_slope(whole, slopes).slope
    assert find_sharpest_slope(found, slopes).slope == pytest.approx(truth, rel=0.005)
    share = shift_and_sum(LightField(known * np.float32(1), weights=plan.weights), truth)
    outside = share > 0.98
    images = [shift_and_sum(one, truth)[outside] for one in (found, whole)]
    np.testing.assert_allclose(*images, rtol=0.01)


@pytest.mark.parametrize(
    ("bayer", "full"),
    [(None, 65535), ("rggb", 65535), (None, 65520), (None, 65520 / 65535), (None, 4095.0)],
)
def test_levels_of_files_saturate(bayer, full, caplog):
    """Twelve bits may be the low or the high ones of 16, and scaled or not as floats."""
    rng, kind = np.random.default_rng(2), np.uint16 if full > 5000 else np.float32
    raw = (rng.integers(2000, 5000, (60, 80)) / 65535 * full).astype(kind)
    dark = (rng.integers(90, 110, (60, 80)) / 65535 * full).astype(kind)
    raw[24:28, 34:38] = full
    plan = DecodePlan(LensletGrid(4.5, 4.5, 10), shape=raw.shape, views=10, dark=dark, bayer=bayer)
    valid = plan.decode(raw).valid
    assert "16 pixels (0.0033 of all) are saturated" in caplog.text
    assert "left out" in caplog.text
    pixels = LightField.trusted(valid.astype(np.float32)).to_raw()
    wide = 0 if bayer is None else 4  # a cubic through pixels two apart
    clipped = np.zeros(raw.shape, bool)
    clipped[24 - wide : 28 + wide, 34 - wide : 38 + wide] = True
    assert not np.any((pixels == 0) & ~clipped)
    assert not np.any(pixels[24:28, 34:38])
    raw[24:28, 34:38] = 0.05 * full
    assert plan.decode(raw).valid is None


def test_bad_pixels_of_the_white_and_the_dark_image_are_unknown():
    raw, white, dark = (np.full((120, 160), level) for level in (0.4, 1.0, 0.01))
    dark += np.random.default_rng(2).normal(0, 1e-4, raw.shape)
    lone = np.zeros(raw.shape, bool)
    white[31:34, 42] = white[32, 41:44] = 20  # a cross of stuck pixels
    white[12, 14], dark[50, 11] = 0.1, 0.9
    lone[31:34, 42] = lone[32, 41:44] = lone[12, 14] = lone[50, 11] = True
    options = {"shape": raw.shape, "views": 10, "white": white}
    plan = DecodePlan(LensletGrid(4.5, 4.5, 10), dark=dark, **options)
    found = plan.decode(raw)
    np.testing.assert_array_equal(LightField.trusted(~found.valid).to_raw(), lone)
    assert not found.views[~found.valid].any()


def test_a_dead_row_of_a_turned_array_shows_nothing_of_the_next_lenslet():
    """What is known of every fourth lenslet is the same, whatever the others show."""
    row, column = np.indices((120, 160))
    place = (column - 80) * np.cos(0.03) + (row - 60) * np.sin(0.03)
    grid, white = LensletGrid(80, 60, 9, 0.03), 1 - 1e-3 * np.hypot(row - 60, column - 80)
    white[62] = 0
    plan = DecodePlan(grid, shape=row.shape, views=9, white=white)
    own = np.round(place / 9) % 4 == 0
    plain, lit = (plan.decode(white * np.where(own, 1.0, others)) for others in (1.0, 9.0))
    middles = [s for s, k in enumerate(grid.block(row.shape)[1]) if k % 4 == 0]
    both = (plain.valid & lit.valid)[:, 2:-2, :, middles]
    away = np.abs(lit.views - plain.views)[:, 2:-2, :, middles]
    assert away[both].max() < 1e-6


@pytest.mark.parametrize("layout", ["rectangular", "hexagonal"])
def test_lenslets_that_are_dark_in_a_view_that_counts_are_unknown_there(layout, tmp_path):
    grid = LensletGrid(11, 11, 9, layout=layout)
    white = np.ones((80, 100))
    for column in (4, 5):  # two neighbours, so that one is not taken for dead pixels
        y, x = (round(float(place)) for place in grid.position(4, column))
        white[y - 4 : y + 5, x - 4 : x - 2] = 0.3  # the left part, as by dirt on the lenslet
    found = DecodePlan(grid, shape=white.shape, views=5, white=white).decode(0.7 * white)
    rows, columns = (list(some) for some in grid.block(white.shape))
    assert not found.valid[2, 0, rows.index(4)].all()
    assert found.valid[:, :, [0, 1, -1]].all()  # rows of lenslets far away
    if layout == "rectangular":
        assert not found.valid[:, 0, rows.index(4), [columns.index(4), columns.index(5)]].any()
        assert np.count_nonzero(~found.valid[:, 0]) == 5 * 2
        assert found.valid[:, 2:].all()
    plain = shift_and_sum(found, 0.0)
    np.testing.assert_allclose(plain, np.median(plain), rtol=1e-3)
    assert (found.views[~found.valid] == 0).any()
    for name, options in (("views", {}), ("a.npy", {}), ("a.tif", {"views": 5})):
        write_light_field(found, tmp_path / name)
        written = read_light_field(tmp_path / name, order="row,col", **options).views[2]
        np.testing.assert_allclose(written, np.median(plain), rtol=2e-3)


def test_weights_and_what_is_known_come_back_from_npz(tmp_path):
    rng = np.random.default_rng(1)
    views, valid = rng.uniform(size=(3, 4, 6, 7)), rng.uniform(size=(3, 4, 6, 7)) > 0.2
    weights = rng.uniform(size=(3, 4)).astype(np.float32)
    weights[0, 0] = 0
    write_light_field(LightField(views, weights=weights, valid=valid), tmp_path / "a.npz")
    stored = {"views": views.transpose(2, 3, 0, 1), "valid": valid.astype(np.uint8)}
    np.savez(tmp_path / "b.npz", **stored, weights=weights)
    for name, axes in (("a", None), ("b", "tsvu")):
        found = read_light_field(tmp_path / f"{name}.npz", axes=axes)
        np.testing.assert_array_equal(found.views, views.astype(np.float32))
        np.testing.assert_array_equal(found.weights, weights)
        np.testing.assert_array_equal(found.valid, valid)
    turned = read_light_field(tmp_path / "a.npz", order="-row,col")
    np.testing.assert_array_equal(turned.valid, valid[::-1])
    np.testing.assert_array_equal(turned.weights, weights[::-1])
    less = read_light_field(tmp_path / "a.npz", dark=tmp_path / "a.npz")
    np.testing.assert_array_equal(less.valid, valid)
    write_light_field(LightField(views), tmp_path / "c.npz")
    write_light_field(LightField(views), tmp_path / "D.NPY")
    np.testing.assert_array_equal(np.load(tmp_path / "D.NPY"), views.astype(np.float32))
    plain = read_light_field(tmp_path / "c.npz")
    assert plain.weights is None
    assert plain.valid is None


def test_commands_say_what_is_unknown_and_which_files_do_not_hold_it(tmp_path):
    raw = np.random.default_rng(3).integers(2000, 5000, (120, 160)).astype(np.uint16)
    raw[24:28, 34:38] = 65535
    tifffile.imwrite(tmp_path / "raw.tif", raw)
    for target, lost in (("views.npz", False), ("views.tif", True)):
        job = ["convert", str(tmp_path / "raw.tif"), str(tmp_path / target), "--pitch", "10"]
        done = CliRunner().invoke(commands, job)
        assert done.exit_code == 0
        assert "of the views (" in done.stderr
        assert "are unknown: saturated, bad" in done.stderr
        assert ("does not store which" in done.stderr) == lost
    said = CliRunner().invoke(commands, ["info", str(tmp_path / "views.npz")])
    assert "are unknown: saturated, bad" in said.stdout
