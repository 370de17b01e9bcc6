"""A page in one file: what it holds, what one does with it, and what it must not do."""

import html
import io
import json
import shlex

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner
from matplotlib import colormaps
from PIL import Image

from lf_flame import PAPER_CAMERA, InputError, LightField
from lf_flame._common.output_folders import output_folder
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
    assert sum(len(path.read_bytes()) for path in STATIC.iterdir()) < 66_000


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


def test_a_page_inside_another_one_runs_without_an_address(tab, make_exhibit, tmp_path):
    inside = html.escape(single_page(make_exhibit((3, 3, 8, 9)), 10**8)[0])
    frame = f'<iframe title="inside" sandbox="allow-scripts" srcdoc="{inside}"></iframe>'
    (tmp_path / "outside.html").write_text(frame, encoding="utf-8")
    tab.page.goto((tmp_path / "outside.html").as_uri())
    page = tab.page.locator("iframe").element_handle().content_frame()
    page.wait_for_function("() => globalThis.lfViewer")
    page.evaluate("() => lfViewer.ready")
    page.evaluate("() => lfViewer.set({ slope: 0.5 })")
    tab.page.wait_for_timeout(400)  # the address would be written, and refused, after 200 ms
    assert page.evaluate("() => lfViewer.state.slope") == 0.5


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
    inside = "() => document.documentElement.scrollHeight <= innerHeight"
    assert 0.7 * 900 < box["height"] < 900
    assert tab.page.evaluate(inside)
    assert box["width"] == pytest.approx(box["height"] / 3, abs=1)
    tab.page.mouse.click(box["x"] + 0.91 * box["width"], box["y"] + 0.11 * box["height"])
    assert tab.page.evaluate("() => lfViewer.pointing.place") == [9, 27]


def test_all_controls_are_in_sight_in_a_small_window(tab, two_planes, tmp_path):
    object.__setattr__(two_planes, "source", "views")
    tab.page.set_viewport_size({"width": 1280, "height": 800})
    tab.open(written(two_planes, tmp_path), "webgl")
    for control in tab.page.locator("input, select, button").all():
        box = control.bounding_box()
        assert box["x"] + box["width"] <= 1280
        assert box["y"] + box["height"] <= 800


def test_greys_are_coloured_as_matplotlib_does_with_a_scale(tab, tmp_path):
    ramp = np.broadcast_to(np.linspace(0, 1, 64), (3, 3, 40, 64))
    exhibit = Exhibit(LightField(ramp), "Ramp", (-1.0, 1.0), 0.0, with_map=False)
    tab.open(written(exhibit, tmp_path), "webgl")
    tab.page.get_by_label("Colours").select_option("inferno")
    tab.set(gain=0.5)
    picture = Image.open(io.BytesIO(tab.page.locator(".lf-over").screenshot())).convert("RGB")
    shown = np.asarray(picture.resize((64, 40), Image.Resampling.BOX))[20]
    expected = 255 * colormaps["inferno"](np.linspace(0, 0.5, 64))[:, :3]
    assert np.abs(shown - expected).max() < 20  # linear between nine places: up to 16
    assert tab.page.locator(".lf-scale span").all_inner_texts() == ["0", "2"]


@pytest.fixture
def reconstructed(tmp_path):
    """A folder as `lf-flame reconstruct` leaves it: three planes, two places that glow."""
    emission = np.zeros((3, 20, 30), np.float32)
    emission[:, 4, 5], emission[:, 12, 20] = (0.02, 0.01, 0), (0.001, 0.002, 0.004)
    folder = tmp_path / "results"
    with output_folder(folder, "emission.json") as out:
        tifffile.imwrite(out.path("emission.tif"), emission, photometric="minisblack")
        out.facts |= {"geometry": "planes", "depths_mm": [4, 0, -4], "cell_mm": [0.1] * 3}
    return folder


def test_emission_is_looked_at_plane_by_plane(tab, reconstructed, tmp_path):
    folder = reconstructed
    page = tmp_path / "emission.html"
    call = ["view", str(folder), "--single-file", str(page)]
    assert CliRunner().invoke(commands, call).exit_code == 0
    tab.open(page.as_uri(), "webgl")
    assert tab.page.evaluate("() => lfViewer.state.slope") == 4  # its brightest plane
    tab.set(slope=3)
    shown = tab.read((20, 30))
    assert shown[4, 5] == pytest.approx((0.75 * 0.02 + 0.25 * 0.01) / 0.02, abs=1e-4)
    assert shown[12, 20] == pytest.approx((0.75 * 0.001 + 0.25 * 0.002) / 0.02, abs=1e-4)
    box = tab.page.locator(".lf-over").bounding_box()
    tab.page.mouse.click(box["x"] + 20.5 / 30 * box["width"], box["y"] + 12.5 / 20 * box["height"])
    assert tab.page.evaluate("() => lfViewer.state.slope") == -4
    tab.page.mouse.move(box["x"] + 20.4 / 30 * box["width"], box["y"] + 12.5 / 20 * box["height"])
    assert tab.page.locator(".lf-hint").inner_text().startswith("Here: 0.00400.")
    assert tab.page.locator(".lf-scale span").all_inner_texts() == ["0", "0.02"]
    refused = CliRunner().invoke(commands, [*call[:2], "--slopes", "0", "1"])
    assert "--slopes does not apply" in str(refused.exception)


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


def test_what_was_unsure_is_unsaid_by_a_click_that_works(tab, two_planes, tmp_path):
    two_planes.light_field.views[..., 30:] = 0.5
    tab.open(written(two_planes, tmp_path), "webgl")
    box, status = tab.page.locator(".lf-over").bounding_box(), tab.page.get_by_role("status")
    hint = tab.page.locator(".lf-hint")
    assert "click a place, or drag a box" in hint.inner_text()

    def click(across, down=0.5):
        tab.page.mouse.click(box["x"] + across * box["width"], box["y"] + down * box["height"])
        tab.settle()

    click(0.9)
    assert "not certain" in status.inner_text()
    assert "not certain" in hint.inner_text()  # said before, as the pointer comes
    click(0.25)
    assert status.inner_text() == ""
    assert hint.inner_text().startswith("Here: slope +1.0")
    click(0.9)
    tab.set(gain=1.5)
    assert status.inner_text() == ""
    tab.page.mouse.move(box["x"] + 0.8 * box["width"], box["y"] + 0.2 * box["height"])
    tab.page.mouse.down()
    tab.page.mouse.move(box["x"] + 0.95 * box["width"], box["y"] + 0.6 * box["height"], steps=3)
    tab.page.mouse.up()
    assert "No slope in this box is certain" in status.inner_text()
    assert tab.page.evaluate("() => lfViewer.state.region")


def test_without_a_map_a_click_says_so(tab, make_exhibit, tmp_path):
    tab.open(written(make_exhibit((3, 3, 8, 9)), tmp_path), "webgl")
    assert tab.page.locator(".lf-hint").inner_text() == "Drag the slope to focus."
    tab.page.locator(".lf-over").click()
    assert tab.page.get_by_role("status").inner_text() == "There is no slope map."


def test_the_map_has_a_scale(tab, two_planes, tmp_path):
    object.__setattr__(two_planes, "camera", PAPER_CAMERA)
    tab.open(written(two_planes, tmp_path), "webgl")
    scale = tab.page.locator(".lf-scale")
    assert not scale.is_visible()
    tab.set(overlay="slope")
    ends = [f"{PAPER_CAMERA.slope_to_depth(x):+.1f} mm".replace("-", MINUS) for x in (-2, 2)]
    assert scale.locator("span").all_inner_texts() == [
        f"{MINUS}2.00, {ends[0]}", f"+2.00, {ends[1]}"
    ]  # fmt: skip
    assert scale.locator("i").bounding_box()["width"] > 100
    colours = scale.locator("i").evaluate("(x) => getComputedStyle(x).backgroundImage")
    assert colours.startswith("linear-gradient(90deg, rgb(68, 1, 84)")  # as the map's lowest slope
    assert colours.endswith("rgb(253, 231, 37))")


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


@pytest.mark.slow
def test_the_copied_command_puts_all_in_focus_where_that_is_shown(tab, two_planes, tmp_path):
    """Whatever slope and aperture were set before: the map is made from all views."""
    source = tmp_path / "views.npy"
    np.save(source, two_planes.light_field.views)
    exhibit = Exhibit(two_planes.light_field, "x", (-1.7, 2.2), 0.0, source=str(source))
    tab.open(written(exhibit, tmp_path), "webgl")
    tab.set(overlay="focus", slope=0.3, width=0.4, gain=0.8, gamma=2.0)
    tab.page.get_by_role("button", name="Copy command").click()
    words = shlex.split(tab.page.locator("code").inner_text())
    result = CliRunner().invoke(commands, [*words[1:], "--out", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    shown = tab.canvas(".lf-over")[..., 0] / 255
    picture = read_image(tmp_path / "out" / "all_in_focus.png")
    assert np.abs(picture**2 - shown**2).max() <= 2 / 255  # 8 bits before gamma, and behind it
    tab.page.get_by_role("button", name="Copy Python").click()
    names = {}
    exec(tab.page.locator("code").inner_text(), names)
    assert np.abs(names["image"] ** 2 - shown**2).max() <= 2 / 255


@pytest.mark.parametrize(
    ("reading", "words", "line"),
    [
        ({"views": 5, "order": "-row,-col"}, ["--views=5", "--order=-row,-col"],
         'light_field = read_light_field("x", views=5, order="-row,-col")'),
        ({"white": "it's.png", "pitch": 9.5}, ["--white=it's.png", "--pitch=9.5"],
         'light_field, _ = read_raw("x", white="it\'s.png", pitch=9.5)'),
        ({"focused": "c.xml", "virtual_depth": 4.0}, ["--focused=c.xml", "--virtual-depth=4"],
         'light_field = read_focused("x", calibration="c.xml", virtual_depth=4)'),
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


@pytest.mark.slow
def test_the_benchmark_tells_frames_a_second(tab, make_exhibit, tmp_path):
    tab.page.goto(written(make_exhibit((3, 3, 8, 9)), tmp_path) + "?bench&renderer=webgl")
    tab.page.wait_for_function("() => globalThis.lfViewer?.benchmark")
    assert tab.page.evaluate("() => lfViewer.benchmark") > 1
    assert "frames a second" in tab.page.get_by_role("status").inner_text()


def smooth(shape, rng):
    """Views that JPEG can do something with."""
    ramp = np.linspace(0, 3, shape[3])[:, None] + np.arange(3)
    return np.clip(0.5 + 0.3 * np.sin(ramp) + rng.uniform(-0.05, 0.05, shape), 0, 1)


@pytest.mark.slow
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
    with pytest.raises(InputError, match=r"allow that many \(--megabytes") as refused:
        single_page(exhibit, 100_000)
    needed = float(str(refused.value).partition("--megabytes ")[2].rstrip(")."))
    assert len(single_page(exhibit, int(needed * 1e6))[0].encode()) <= needed * 1e6
    with pytest.raises(InputError):
        single_page(exhibit, int((needed - 0.1) * 1e6))


def test_metadata_holds_nothing_that_json_does_not_know(make_exhibit):
    page, _ = single_page(make_exhibit((3, 3, 8, 9)), 10**8)
    text = page.partition('id="lf-metadata">')[2].partition("</script>")[0]
    assert json.loads(text, parse_constant=pytest.fail)["levels"] == 255
