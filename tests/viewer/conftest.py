"""A real browser, and light fields to look at in it."""

import shutil

import numpy as np
import pytest

from lf_flame import LightField
from lf_flame.viewer.exhibit import Exhibit

BROWSERS = ("chromium-headless-shell", "chromium", "google-chrome")

FLAGS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
"""Software WebGL is off in headless Chromium unless it is asked for."""


@pytest.fixture(scope="session")
def chromium():
    """A headless browser."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="browser tests need playwright"
    ).sync_playwright
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        pytest.skip(f"browser tests need one of {', '.join(BROWSERS)}")
    with playwright() as started:
        browser = started.chromium.launch(executable_path=found, args=list(FLAGS))
        yield browser
        browser.close()


OF_READING = "GPU stall due to ReadPixels"
"""Message of the browser where a test, or the benchmark, reads a picture back."""


class Tab:
    """A page of the browser, and what it complained of or asked the network for."""

    def __init__(self, context):
        self.page = context.new_page()
        self.complaints, self.requests = [], []
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("console", self.hear)
        self.page.on("request", lambda request: self.requests.append(request.url))

    def hear(self, message):
        """Keep errors and warnings."""
        if message.type in ("error", "warning") and OF_READING not in message.text:
            self.complaints.append(message.text)

    def open(self, url, renderer=None, address=""):
        """Open a viewer, and wait until it shows all views."""
        self.page.goto(f"{url}{f'?renderer={renderer}' if renderer else ''}{address}")
        self.page.wait_for_function("() => globalThis.lfViewer")
        self.page.evaluate("() => lfViewer.ready")
        self.settle()

    def settle(self):
        """Wait until what was asked for is drawn."""
        self.page.evaluate("() => lfViewer.drawn()")

    def set(self, **changes):
        """Change the state, and wait for the picture."""
        self.page.evaluate("(changes) => lfViewer.set(changes)", changes)
        self.settle()

    def read(self, shape):
        """The last sums in units of full scale, before they are shown."""
        values = self.page.evaluate("() => Array.from(lfViewer.renderer.read())")
        return np.reshape(values, shape)

    def canvas(self, name=".lf-image"):
        """Levels of the picture shown, or of another canvas, shape (t, s, 3)."""
        height, width, levels = self.page.evaluate(
            """(name) => {
              const from = lfViewer.find(name);
              const to = document.createElement("canvas");
              [to.width, to.height] = [from.width, from.height];
              const context = to.getContext("2d");
              context.drawImage(from, 0, 0);
              const { data } = context.getImageData(0, 0, to.width, to.height);
              return [to.height, to.width, Array.from(data)];
            }""",
            name,
        )
        return np.reshape(levels, (height, width, 4))[..., :3]


@pytest.fixture
def tab(chromium):
    """A page in a browser of its own; what it complained of fails the test."""
    context = chromium.new_context(viewport={"width": 1200, "height": 900})
    tab = Tab(context)
    yield tab
    context.close()
    assert tab.complaints == []


@pytest.fixture
def make_exhibit():
    """Exhibits of random views of 8 or 16 bits."""

    def make(shape, seed=0, bits=8, **options):
        codes = np.random.default_rng(seed).integers(0, 2**bits, shape)
        views = (codes / np.float32(2**bits - 1)).astype(np.float32)
        options = {"slopes": (-2.0, 2.0), "slope": 0.0, "with_map": False, **options}
        return Exhibit(LightField(views), "Noise", **options)

    return make
