"""The browser's pictures beside those of `shift_and_sum`, by graphics processor and without one."""

import json
import re

import numpy as np
import pytest

from lf_flame import LightField
from lf_flame.learning.scores import psnr
from lf_flame.refocus import aperture_weights, shift_and_sum
from lf_flame.viewer.page import single_page

RENDERERS = ("webgl", "javascript")

SHAPES = [(9, 9, 14, 23), (4, 5, 9, 13, 3), (2, 2, 7, 9), (17, 17, 18, 17)]

APERTURES = [
    {},
    {"shape": "round", "width": 0.8},
    {"shape": "round", "width": 1.3, "ring": 0.5, "centre": [0.4, -0.5]},
    {"shape": "square", "width": 0.61, "centre": [-0.5, 0.25]},
    {"shape": "square", "width": 1.0, "ring": 0.45},
]


@pytest.fixture
def opened(tab, tmp_path):
    """Open an exhibit as one file."""

    def open_exhibit(exhibit, renderer, **more):
        path = tmp_path / "page.html"
        path.write_text(single_page(exhibit, 10**8)[0], encoding="utf-8")
        tab.open(path.as_uri(), renderer, **more)
        return tab

    return open_exhibit


@pytest.mark.parametrize("renderer", RENDERERS)
def test_what_draws_is_what_was_asked_for(opened, make_exhibit, renderer):
    """A suite that is green on no renderer proves nothing."""
    tab = opened(make_exhibit(SHAPES[0]), renderer)
    name = tab.page.evaluate("() => lfViewer.renderer.name")
    assert re.search("SwiftShader|ANGLE" if renderer == "webgl" else "^JavaScript$", name)
    assert np.ptp(tab.canvas()) > 20


def expected(exhibit, slope, aperture):
    """The picture by the engine, radiance."""
    views = exhibit.light_field.views
    weights = None
    if aperture:
        options = {"shape": "square", "centre": (0.0, 0.0), **aperture}
        weights = aperture_weights(views.shape[:2], **options)
    return shift_and_sum(views, [slope], weights=weights)[0]


@pytest.mark.parametrize("renderer", RENDERERS)
@pytest.mark.parametrize(("shape", "bits"), [*((shape, 8) for shape in SHAPES), (SHAPES[0], 16)])
def test_sums_are_those_of_the_engine(opened, make_exhibit, rng, renderer, bits, shape):
    exhibit = make_exhibit(shape, bits=bits)
    tab = opened(exhibit, renderer)
    for aperture in APERTURES:
        slope = float(rng.uniform(-2, 2))
        tab.set(**{"shape": "square", "width": 1, "ring": 0, "centre": [0, 0], **aperture},
                slope=slope)  # fmt: skip
        image = expected(exhibit, slope, aperture)
        found = tab.read(image.shape)
        np.testing.assert_allclose(found, image, atol=1e-5 if renderer == "webgl" else 1e-6)
        levels = np.rint(255 * np.clip(image, 0, 1))
        if levels.ndim == 2:
            levels = levels[..., None]
        assert np.abs(tab.canvas() - levels).max() <= 1


@pytest.mark.parametrize("renderer", RENDERERS)
def test_views_count_as_the_light_field_says(opened, make_exhibit, rng, renderer):
    """Within the aperture; where none in it counts, all in it are drawn rather than nothing."""
    exhibit = make_exhibit((5, 6, 12, 17))
    own = rng.uniform(0.2, 1, (5, 6))
    own[:, :2] = 0
    weighted = LightField(exhibit.light_field.views, weights=own)
    object.__setattr__(exhibit, "light_field", weighted)
    own = own.astype(np.float32)
    tab = opened(exhibit, renderer)
    for aperture, counted in (({}, own), (APERTURES[1], own), ({"shape": "square", "width": 0.2,
                              "centre": [0, -2.5]}, 1)):  # fmt: skip
        tab.set(**{"shape": "square", "width": 1, "ring": 0, "centre": [0, 0], **aperture},
                slope=0.7)  # fmt: skip
        options = {"shape": "square", "centre": (0.0, 0.0), "width": 1.0, **aperture}
        weights = aperture_weights((5, 6), **options) * counted
        image = shift_and_sum(exhibit.light_field.views, [0.7], weights=weights)[0]
        atol = 1e-5 if renderer == "webgl" else 1e-6
        np.testing.assert_allclose(tab.read(image.shape), image, atol=atol)


@pytest.mark.parametrize("renderer", RENDERERS)
def test_radiance_of_any_range_shows_as_it_should(opened, make_exhibit, renderer):
    """Below 0 and above 1, with gain and gamma."""
    exhibit = make_exhibit((3, 3, 8, 9))
    views = 4 * exhibit.light_field.views - 0.5
    object.__setattr__(exhibit, "light_field", LightField(views))
    tab = opened(exhibit, renderer)
    tab.set(slope=0.7, gain=1.5, gamma=2.2)
    image = np.clip(1.5 * expected(exhibit, 0.7, {}) / views.max(), 0, 1) ** (1 / 2.2)
    assert np.abs(tab.canvas() - np.rint(255 * image)[..., None]).max() <= 1


def test_eight_bits_are_near_the_float_views(opened, make_exhibit, rng):
    """Where 16 would be too large: forced here by looking at the coded views alone."""
    exhibit = make_exhibit((9, 9, 30, 40), bits=16)
    codes = np.rint(exhibit.coded.codes / 257).astype(np.uint8)
    object.__setattr__(exhibit.coded, "codes", codes)
    tab = opened(exhibit, "webgl")
    tab.set(slope=0.3)
    image = expected(exhibit, 0.3, {})
    assert psnr(tab.read(image.shape), image) >= 58


def test_binned_images_while_dragging_are_those_of_binned_views(opened, make_exhibit):
    exhibit = make_exhibit((5, 5, 24, 36))
    tab = opened(exhibit, "javascript")
    tab.page.evaluate(
        "() => { lfViewer.renderer.block = 3; lfViewer.set({ slope: 1.2 }, { dragging: true }); }"
    )
    tab.settle()
    views = exhibit.light_field.views.reshape(5, 5, 8, 3, 12, 3).mean(axis=(3, 5))
    image = shift_and_sum(views, [1.2 / 3])[0]
    np.testing.assert_allclose(tab.read(image.shape), image, atol=1e-6)
    tab.set(slope=1.2)
    assert tab.canvas().shape == (24, 36, 3)


def test_a_lost_context_comes_back_with_the_picture(opened, make_exhibit):
    tab = opened(make_exhibit(SHAPES[0]), "webgl")
    tab.set(slope=0.6)
    before = tab.canvas()
    tab.page.evaluate(
        """async () => {
          const { gl, canvas } = lfViewer.renderer;
          const lose = gl.getExtension("WEBGL_lose_context");
          const event = (name) => new Promise((done) =>
            canvas.addEventListener(name, () => setTimeout(done), { once: true }));
          const lost = event("webglcontextlost");
          lose.loseContext();
          await lost;
          const restored = event("webglcontextrestored");
          lose.restoreContext();
          await restored;
        }"""
    )
    tab.set(slope=0.6)
    np.testing.assert_array_equal(tab.canvas(), before)


def test_an_address_shows_the_same_picture(opened, make_exhibit):
    exhibit = make_exhibit(SHAPES[0])
    tab = opened(exhibit, "webgl")
    tab.set(slope=-0.85, shape="round", width=0.7, centre=[1, -2], gain=1.4, region=[2, 9, 3, 20])
    shown, state = tab.canvas(), tab.page.evaluate("() => lfViewer.state")
    tab.page.wait_for_function("() => location.hash.includes('gain')")
    address = tab.page.evaluate("() => location.hash")
    tab.page.goto("about:blank")
    opened(exhibit, "webgl", address=address)
    assert tab.page.evaluate("() => lfViewer.state") == state
    np.testing.assert_array_equal(tab.canvas(), shown)


@pytest.mark.parametrize(
    "address",
    ["#slope=nan&width=-4", "#slope=1e999&centre=a,b,c&region=9,1,2", "#__proto__=1&shape=<b>"],
)
def test_a_senseless_address_is_brought_into_range(opened, make_exhibit, address):
    tab = opened(make_exhibit(SHAPES[0]), "webgl", address=address)
    state = tab.page.evaluate("() => lfViewer.state")
    assert -2 <= state["slope"] <= 2
    assert 1 / 9 <= state["width"] <= 1
    assert state["shape"] == "square"
    assert state["region"] is None
    json.dumps(state, allow_nan=False)
