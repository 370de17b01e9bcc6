"""A headless browser, and pages of the viewer in it."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Thread

from lf_flame.errors import InputError
from lf_flame.viewer.exhibit import Exhibit
from lf_flame.viewer.server import ViewerServer

BROWSERS = ("chromium-headless-shell", "chromium", "google-chrome")

FLAGS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
"""Software WebGL is off in headless Chromium unless it is asked for."""


def find_browser() -> str | None:
    """Path of a browser, if there is one."""
    return next(filter(None, map(shutil.which, BROWSERS)), None)


@contextmanager
def headless_browser() -> Iterator:
    """Start a browser of playwright's; an InputError says that there is none."""
    from playwright.sync_api import sync_playwright

    found = find_browser()
    if found is None:
        raise InputError(f"Pages need a browser, one of {', '.join(BROWSERS)}.")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=found, args=list(FLAGS))
        yield browser
        browser.close()


@contextmanager
def served(exhibit: Exhibit) -> Iterator[str]:
    """Serve an exhibit, and give the address of its page."""
    with ViewerServer(exhibit) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield server.url
        server.shutdown()
