"""A page in one file: what it holds, what one does with it, and what it must not do."""

import json
import shlex

import numpy as np
import pytest
from click.testing import CliRunner

from lf_flame import PAPER_CAMERA, InputError, LightField
from lf_flame.commands.cli import commands
from lf_flame.formats.images import read_image
from lf_flame.refocus import f_number_aperture, refocus
from lf_flame.viewer.exhibit import Exhibit
from lf_flame.viewer.page import single_page
from lf_flame.viewer.scripts import STATIC

MINUS = "\N{MINUS SIGN}"

HOSTILE = """</script><script>globalThis.owned=1</script><img src=x onerror="owned=1">'"`$title"""


def written(exhibit, folder, most_bytes=10**8):
    """Write an exhibit as one file."""
    path = folder / "page.html"
    path.write_text(single_page(exhibit, most_bytes)[0], encoding="utf-8")
    return path.as_uri()


@pytest.fixture
def two_planes(rng):
    """A left half at slope 1 and a right half at slope -1, by shifting noise."""
    texture = rng.uniform(size=(40, 80)).astype(np.float32)
    views = np.empty((5, 5, 40, 60), np.float32)
    for v in range(5):
        for u in range(5):
            for slope, part in ((1, slice(0, 30)), (-1, slice(30, 60))):
                moved = np.roll(texture, (slope * (v - 2), slope * (u - 2)), (0, 1))
                views[v, u, :, part] = moved[:, 10:70][:, part]
    return Exhibit(LightField(views), "Two planes", (-2.0, 2.0), 0.0)


def test_scripts_stay_small():
    assert sum(len(path.read_bytes()) for path in STATIC.iterdir()) < 60_000


def test_a_page_asks_nobody_and_runs_without_a_network(tab, make_exhibit, tmp_path):
    tab.page.context.set_offline(True)
    tab.open(written(make_exhibit((3, 3, 8, 9)), tmp_path), "webgl")
    tab.set(slope=0.5)
    assert all(url.startswith(("file:", "data:", "blob:")) for url in tab.requests)


def test_hostile_names_are_text(tab, make_exhibit, tmp_path):
    exhibit = make_exhibit((3, 3, 8, 9))
    for name in ("title", "source"):
        object.__setattr__(exhibit, name, HOSTILE)
    tab.open(written(exhibit, tmp_path), "javascript")
    tab.page.get_by_role("button", name="Copy Python").click()
    assert tab.page.evaluate("() => globalThis.owned") is None
    assert tab.page.locator("h1").inner_text() == HOSTILE
    line = tab.page.locator("code").inner_text().splitlines()[2]
    assert eval(line.removeprefix("light_field = read_light_field")) == HOSTILE


@pytest.mark.parametrize("renderer", ["webgl", "javascript"])
def test_a_click_focuses_where_the_slope_is_certain(tab, two_planes, tmp_path, renderer):
    tab.open(written(two_planes, tmp_path), renderer)
    box = tab.page.locator(".lf-over").bounding_box()
    for share, slope in ((0.25, 1), (0.75, -1)):
        tab.page.mouse.click(box["x"] + share * box["width"], box["y"] + box["height"] / 2)
        assert tab.page.evaluate("() => lfViewer.state.slope") == pytest.approx(slope, abs=0.05)
    tab.page.mouse.move(box["x"] + 0.05 * box["width"], box["y"] + 0.3 * box["height"])
    tab.page.mouse.down()
    tab.page.mouse.move(box["x"] + 0.35 * box["width"], box["y"] + 0.6 * box["height"], steps=3)
    tab.page.mouse.up()
    state = tab.page.evaluate("() => lfViewer.state")
    assert state["slope"] == pytest.approx(1, abs=0.05)
    assert state["region"] == pytest.approx([12, 25, 3, 22], abs=1)


def test_a_tall_picture_fits_the_window_and_is_pointed_at_rightly(tab, make_exhibit, tmp_path):
    tab.open(written(make_exhibit((3, 3, 90, 30)), tmp_path), "webgl")
    box = tab.page.locator(".lf-over").bounding_box()
    assert box["height"] == pytest.approx(0.75 * 900, abs=1)
    assert box["width"] == pytest.approx(box["height"] / 3, abs=1)
    tab.page.mouse.click(box["x"] + 0.9 * box["width"], box["y"] + 0.1 * box["height"])
    assert tab.page.evaluate("() => lfViewer.pointing.place") == [9, 27]


def test_keys_move_the_place_and_focus(tab, two_planes, tmp_path):
    tab.open(written(two_planes, tmp_path), "webgl")
    tab.page.locator(".lf-over").focus()
    for key in ("Shift+ArrowLeft", "ArrowUp", "Enter"):
        tab.page.keyboard.press(key)
    assert tab.page.evaluate("() => lfViewer.pointing.place") == [19, 20]
    assert tab.page.evaluate("() => lfViewer.state.slope") == pytest.approx(1, abs=0.05)
    tab.page.get_by_role("slider", name="Slope").focus()
    before = tab.page.evaluate("() => lfViewer.state.slope")
    tab.page.keyboard.press("ArrowRight")
    after = tab.page.evaluate("() => lfViewer.state.slope")
    assert after == pytest.approx(before + 0.01, abs=0.006)


def test_where_the_slope_is_unknown_nothing_moves(tab, tmp_path):
    flat = Exhibit(LightField(np.full((3, 3, 20, 20), 0.5)), "Flat", (-2.0, 2.0), 0.3)
    tab.open(written(flat, tmp_path), "webgl")
    tab.page.locator(".lf-over").click()
    assert "not certain" in tab.page.get_by_role("status").inner_text()
    assert tab.page.evaluate("() => lfViewer.state.slope") == 0.3


def test_overlays_are_the_slope_map_and_the_image_in_focus(tab, two_planes, tmp_path):
    tab.open(written(two_planes, tmp_path), "webgl")
    tab.page.get_by_label("Overlay").select_option("focus")
    tab.settle()
    shown = tab.canvas(".lf-over")
    address = "#overlay=focus"
    tab.open(written(two_planes, tmp_path), "webgl", address)
    assert tab.page.evaluate("() => lfViewer.state.overlay") == "focus"
    np.testing.assert_array_equal(tab.canvas(".lf-over"), shown)
    focused = np.rint(255 * np.clip(two_planes.focus_map.all_in_focus, 0, 1))
    assert np.abs(shown[..., 0] - focused).max() <= 1
    tab.page.get_by_label("Overlay").select_option("slope")
    tab.settle()
    colours = tab.canvas(".lf-over")
    left, right = colours[20, 15], colours[20, 45]
    assert left[1] > 150 > right[1]  # viridis: bright and dark


def test_slices_are_rows_and_columns_of_the_views(tab, make_exhibit, tmp_path):
    exhibit = make_exhibit((4, 5, 10, 12))
    tab.open(written(exhibit, tmp_path), "webgl")
    tab.page.evaluate("() => lfViewer.slicesAt(3, 7)")
    codes = exhibit.coded.codes[..., 0]
    for name, expected in ((".lf-row", codes[1, :, 3, :]), (".lf-column", codes[:, 2, :, 7])):
        np.testing.assert_array_equal(tab.canvas(name)[..., 0], expected)


@pytest.mark.parametrize(
    "state",
    [
        {"slope": 0.85},
        {"slope": -1.3, "shape": "round", "width": 0.7, "ring": 0.2, "centre": [0.5, -1]},
        {"slope": 0.4, "width": 0.6, "centre": [1, 0], "gain": 1.6, "gamma": 2.2},
    ],
)
def test_the_copied_command_gives_the_picture_shown(tab, make_exhibit, tmp_path, state):
    exhibit = make_exhibit((5, 5, 16, 20, 3))
    source = tmp_path / "it's a $(field).npy"
    np.save(source, exhibit.coded.codes)
    object.__setattr__(exhibit, "source", str(source))
    tab.open(written(exhibit, tmp_path), "webgl")
    tab.set(**state)
    tab.page.get_by_role("button", name="Copy command").click()
    words = shlex.split(tab.page.locator("code").inner_text())
    out = tmp_path / "out"
    result = CliRunner().invoke(commands, [*words[1:], "--out", str(out)])
    assert result.exit_code == 0, result.output
    (picture,) = out.glob("refocused_*.png")
    assert np.abs(255 * read_image(picture) - tab.canvas()).max() <= 1
    tab.page.get_by_role("button", name="Copy Python").click()
    names = {}
    exec(tab.page.locator("code").inner_text(), names)
    assert np.abs(255 * names["image"] - tab.canvas()).max() <= 1


@pytest.mark.parametrize(
    ("reading", "words", "line"),
    [
        ({"views": 5, "order": "-row,-col"}, ["--views=5", "--order=-row,-col"],
         'light_field = read_light_field("x", views=5, order="-row,-col")'),
        ({"white": "it's.png", "pitch": 9.5}, ["--white=it's.png", "--pitch=9.5"],
         'light_field, _ = read_raw("x", white="it\'s.png", pitch=9.5)'),
    ],
)  # fmt: skip
def test_what_is_copied_reads_the_source_in_the_same_way(
    tab, make_exhibit, tmp_path, reading, words, line
):
    exhibit = make_exhibit((3, 3, 8, 9), source="x", reading=reading)
    tab.open(written(exhibit, tmp_path), "webgl")
    tab.page.get_by_role("button", name="Copy command").click()
    assert shlex.split(tab.page.locator("code").inner_text())[2:5] == ["x", *words]
    tab.page.get_by_role("button", name="Copy Python").click()
    assert tab.page.locator("code").inner_text().splitlines()[2] == line


def test_depths_and_f_numbers_of_a_known_camera(tab, tmp_path, rng):
    views = rng.uniform(size=(15, 15, 40, 40)).astype(np.float32)
    exhibit = Exhibit(LightField(views), "Noise", (-2.0, 2.0), 1.0, PAPER_CAMERA, with_map=False)
    tab.open(written(exhibit, tmp_path), "webgl")
    output = tab.page.locator("label span").first
    for slope in (-1.25, 0.5, 2.0):
        tab.set(slope=slope)
        depth = PAPER_CAMERA.slope_to_depth(slope)
        words = f", {depth:+.1f} mm".replace("-", MINUS)
        assert output.inner_text().endswith(words)
    tab.set(slope=0.9, shape="round", width=0.4)
    shown = float(tab.page.locator("label span").nth(1).inner_text().partition("f/")[2])
    weights = f_number_aperture(PAPER_CAMERA, shown)
    image = refocus(exhibit.light_field, [0.9], weights=weights)[0]
    assert np.abs(tab.read(image.shape) - image).max() < 1e-3  # f/8.9 is rounded


def test_screen_readers_find_nothing_serious(tab, two_planes, tmp_path):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="needs axe")
    tab.open(written(two_planes, tmp_path), "webgl")
    found = axe.Axe().run(tab.page).response["violations"]
    assert [x["id"] for x in found if x["impact"] in ("serious", "critical")] == []


def test_the_benchmark_tells_frames_a_second(tab, make_exhibit, tmp_path):
    tab.page.goto(written(make_exhibit((3, 3, 8, 9)), tmp_path) + "?bench&renderer=webgl")
    tab.page.wait_for_function("() => globalThis.lfViewer?.benchmark")
    assert tab.page.evaluate("() => lfViewer.benchmark") > 1
    assert "frames a second" in tab.page.get_by_role("status").inner_text()


def smooth(shape, rng):
    """Views that JPEG can do something with."""
    ramp = np.linspace(0, 3, shape[3])[:, None] + np.arange(3)
    return np.clip(0.5 + 0.3 * np.sin(ramp) + rng.uniform(-0.05, 0.05, shape), 0, 1)


def test_what_does_not_fit_is_carried_coarser_and_said_so(tab, tmp_path, rng):
    exhibit = Exhibit(LightField(smooth((9, 9, 60, 80, 3), rng)), "Smooth", (-2.0, 2.0), 0.0,
                      with_map=False)  # fmt: skip
    whole, quality = single_page(exhibit, 10**8)
    assert quality == "views of 16 bits, nothing lost"
    seen = set()
    for part in (0.6, 0.25, 0.12):
        page, quality = single_page(exhibit, int(part * len(whole)))
        assert len(page.encode()) <= part * len(whole)
        assert quality.startswith("preview: views ")
        assert quality in page
        seen.add(quality.partition(",")[0])
        (tmp_path / "page.html").write_text(page)
        tab.open((tmp_path / "page.html").as_uri(), "webgl")
        tab.set(slope=1.0)
        image = refocus(exhibit.light_field, [1.0])[0]
        inner = (slice(8, -8), slice(8, -8))
        assert np.sqrt(np.mean((tab.read(image.shape) - image)[inner] ** 2)) < 0.02
    assert len(seen) > 1
    with pytest.raises(InputError, match="allow a larger file"):
        single_page(exhibit, 100_000)


def test_metadata_holds_nothing_that_json_does_not_know(make_exhibit):
    page, _ = single_page(make_exhibit((3, 3, 8, 9)), 10**8)
    text = page.partition('id="lf-metadata">')[2].partition("</script>")[0]
    assert json.loads(text, parse_constant=pytest.fail)["levels"] == 255
