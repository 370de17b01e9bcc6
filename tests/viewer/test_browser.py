"""The picture of a real browser beside that of `shift_and_sum`, by 8 and by 16 bits."""

import shlex

import numpy as np
import pytest
from click.testing import CliRunner

from lf_flame.calibration import CameraLaw
from lf_flame.commands.cli import commands
from lf_flame.formats.images import read_image
from lf_flame.refocus import aperture_weights, shift_and_sum
from lf_flame.viewer.page import single_page
from lf_flame.viewer.server import ViewerServer

WHOLE = {"shape": "square", "width": 1.0, "ring": 0.0, "centre": (0.0, 0.0)}
APERTURES = [
    WHOLE,
    {"shape": "round", "width": 1.3, "ring": 0.5, "centre": (0.4, -0.5)},
    {"shape": "square", "width": 0.61, "ring": 0.0, "centre": (-0.5, 0.25)},
]


@pytest.mark.parametrize(
    ("bits", "shape", "renderer", "width"),
    [(8, (4, 5, 9, 13, 3), "webgl", 390), (16, (9, 9, 14, 23), "javascript", 1280)],
)
def test_a_page_shows_what_python_computes(
    tab, make_exhibit, tmp_path, rng, bits, shape, renderer, width
):
    """In one file, without a network; the copied command and Python make the same picture."""
    exhibit = make_exhibit(shape, bits=bits)
    views = exhibit.light_field.views
    source = tmp_path / "it's a $(field).npy"
    np.save(source, exhibit.coded.codes.reshape(shape))
    object.__setattr__(exhibit, "source", str(source))
    if shape[0] == shape[1]:  # the page shows what a calibration corrects
        fall_off = rng.uniform(0.6, 0.9, shape[:2]).round(4)
        law = CameraLaw(
            slope_at_infinity=2.0, slope_mm=-800.0, centre_mm=-400.0, scale=0.002, views=shape[0],
            depth_range_mm=(-37.5, 37.5), lenslets=shape[2:], fall_off=fall_off.tolist(),
        )  # fmt: skip
        (tmp_path / "law.toml").write_text(law.to_toml(), encoding="utf-8")
        np.save(source, views * fall_off[..., None, None])
        object.__setattr__(exhibit, "reading", {"camera": str(tmp_path / "law.toml")})
    object.__setattr__(exhibit, "title", "</script><img src=x onerror='globalThis.owned=1'>")
    (tmp_path / "page.html").write_text(single_page(exhibit, 10**8)[0], encoding="utf-8")
    tab.page.context.set_offline(True)
    tab.page.set_viewport_size({"width": width, "height": 844})
    tab.open((tmp_path / "page.html").as_uri(), renderer)
    name = tab.page.evaluate("() => lfViewer.renderer.name")
    assert (name == "JavaScript") == (renderer == "javascript")
    for aperture in APERTURES:
        slope = float(rng.uniform(-2, 2))
        tab.set(**aperture, slope=slope)
        image = shift_and_sum(views, slope, weights=aperture_weights(shape[:2], **aperture))
        np.testing.assert_allclose(tab.read(image.shape), image, atol=1e-5)
        levels = np.rint(255 * image.reshape(*shape[2:4], -1))
        assert np.abs(tab.canvas() - levels).max() <= 1
    tab.set(gain=1.6, gamma=2.2)
    tab.page.get_by_role("button", name="Copy command").click()
    words = shlex.split(tab.page.locator("code").inner_text())
    done = CliRunner().invoke(commands, [*words[1:], "--out", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    (picture,) = (tmp_path / "out").glob("refocused_*.png")
    large = 255 * read_image(picture)
    times = len(large) // shape[2]
    written = large[::times, ::times].reshape(*shape[2:4], -1)
    assert np.abs(written - tab.canvas()).max() <= 1
    tab.page.get_by_role("button", name="Copy Python").click()
    names = {}
    exec(tab.page.locator("code").inner_text(), names)
    shown = 255 * names["image"].reshape(*shape[2:4], -1)
    assert np.abs(shown - tab.canvas()).max() <= 1
    # A page with every second view: its viewpoint is in steps of two.
    tab.page.evaluate(
        "() => lfViewer.metadata.positions.forEach((x) => x.forEach((_, i) => (x[i] *= 2)))"
    )
    for button, words in (("command", "--viewpoint -1 0.5"), ("Python", "centre=(-1, 0.5)")):
        tab.page.get_by_role("button", name=f"Copy {button}").click()
        assert words in tab.page.locator("code").inner_text()
    assert tab.page.evaluate("() => document.documentElement.scrollWidth") == width
    assert all(url.startswith(("file:", "data:", "blob:")) for url in tab.requests)
    assert tab.page.evaluate("() => globalThis.owned") is None


def test_a_served_page_shows_what_python_computes_and_a_click_focuses(tab, make_exhibit, rng):
    """Two planes, with weights of views: the map, a click, an address that is brought in range."""
    texture = rng.uniform(size=(40, 80)).astype(np.float32)
    exhibit = make_exhibit((5, 5, 40, 60), with_map=True)
    views = exhibit.light_field.views
    for v, u in np.ndindex(5, 5):
        for slope, part in ((1, slice(0, 30)), (-1, slice(30, 60))):
            moved = np.roll(texture, (slope * (v - 2), slope * (u - 2)), (0, 1))
            views[v, u, :, part] = moved[:, 10:70][:, part]
    weights = rng.uniform(0.2, 1, (5, 5)).astype(np.float32)
    object.__setattr__(exhibit.light_field, "weights", weights)
    from threading import Thread

    with ViewerServer(exhibit) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        tab.open(server.url, "webgl", address="#slope=1e999&width=-4&centre=a,b&__proto__=1")
        assert tab.page.evaluate("() => lfViewer.state.width") == pytest.approx(0.2)
        tab.set(**WHOLE, slope=0.7)
        image = shift_and_sum(exhibit.light_field, 0.7)
        np.testing.assert_allclose(tab.read(image.shape), image, atol=1e-5)
        box = tab.page.locator(".lf-over").bounding_box()
        for column, slope in ((12, 1), (48, -1)):
            x = box["x"] + column / 60 * box["width"]
            tab.page.mouse.click(x, box["y"] + box["height"] / 2)
            tab.settle()
            found = tab.page.evaluate("() => lfViewer.state.slope")
            assert found == pytest.approx(slope, abs=0.05)
        assert all(url.startswith((server.url, "data:")) for url in tab.requests)
        server.shutdown()
