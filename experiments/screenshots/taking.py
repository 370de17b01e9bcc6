"""Taking pictures: the demo, served, as one file and in a notebook; light fields of one's own."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from experiments.browser import headless_browser, served
from experiments.screenshots.notebook import open_notebook
from experiments.screenshots.sources import SHOWN, make_sources, viewed
from lf_flame._common.output_folders import output_folder
from lf_flame.commands.viewer import demo_exhibit
from lf_flame.viewer.demo import BURNER_MM, DEMO_CAMERA, WALL_MM
from lf_flame.viewer.exhibit import Exhibit
from lf_flame.viewer.page import single_page

RECORD = "screenshots.json"

NEAR, FAR = (DEMO_CAMERA.depth_to_slope(depth) for depth in (BURNER_MM, WALL_MM))

SERVED = {
    "viewer_near.png": f"#slope={NEAR}",
    "viewer_far.png": f"#slope={FAR}&gain=1.5&colours=inferno",
    "viewer_slope_map.png": f"#slope={FAR}&overlay=slope&opacity=0.7",
}
"""Pictures of the served page, and the address of each."""

IN_ONE_FILE = {"viewer_single_file.png": "#slope=0&shape=round&width=0.25"}

NOTEBOOK = "viewer_notebook.png"

CELLS = [
    "from lf_flame.viewer import DEMO_CAMERA, demo_light_field, show\n\n"
    "widget = show(demo_light_field(), camera=DEMO_CAMERA)\n"
    "widget"
]
"""Cells of the notebook."""

PLACE = {"x": 350, "y": 400}
"""Place of the pointer in the picture."""


def take_screenshots(out: Path, jupyter: Path | None) -> list[Path]:
    """Take all pictures into a folder, beside a record; without JupyterLab none of a notebook.

    An InputError says that there is no browser, or that JupyterLab does not start.
    """
    exhibit = demo_exhibit("demo.npy")
    with output_folder(out, RECORD) as folder, headless_browser() as browser:
        folder.facts["browser"] = f"Chromium {browser.version}"
        with served(exhibit) as url:
            for name, address in SERVED.items():
                _take(browser, url + address, folder.path(name))
        with _written(exhibit) as url:
            for name, address in IN_ONE_FILE.items():
                _take(browser, url + address, folder.path(name))
        with TemporaryDirectory() as aside:
            make_sources(Path(aside))
            for name, (words, address) in SHOWN.items():
                with viewed(Path(aside), words) as url:
                    _take(browser, url + address, folder.path(name))
        if jupyter:
            with open_notebook(browser, jupyter, CELLS) as notebook:
                notebook.run_cells()
                notebook.run(f"widget.slope = {NEAR}")
                notebook.page.wait_for_timeout(500)
                notebook.page.screenshot(path=folder.path(NOTEBOOK))
    return sorted(out / name for name in folder.files)


@contextmanager
def _written(exhibit: Exhibit) -> Iterator[str]:
    with TemporaryDirectory() as aside:
        path = Path(aside) / "demo.html"
        path.write_text(single_page(exhibit, 10_000_000)[0], encoding="utf-8")
        yield path.as_uri()


def _take(browser, url: str, path: Path) -> None:
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    page.goto(url)
    page.wait_for_function("() => globalThis.lfViewer")
    page.evaluate("() => lfViewer.ready.then(() => lfViewer.drawn())")
    page.locator(".lf-over").hover(position=PLACE)
    page.evaluate("() => lfViewer.drawn()")
    page.screenshot(path=path)
    page.close()
