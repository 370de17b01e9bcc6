"""How long the viewer's page takes to show a light field, and its frames a second.

In a headless browser without a graphics processor: by JavaScript, as a page chooses there itself,
and by WebGL2 on a software renderer, which says nothing of a real one (`?bench` behind the address
of a page does). And by the program that serves the page, as it does for light fields that are too
large: a page asks it for each picture.
"""

import sys
from dataclasses import replace

import numpy as np
import pandas as pd

from experiments.benchmarks.report import command_line, finish
from experiments.browser import headless_browser, served
from lf_flame.lightfield import LightField
from lf_flame.viewer.exhibit import Exhibit

SHAPES = ((15, 15, 90, 180), (15, 15, 270, 540), (9, 9, 512, 512, 3))

RENDERERS = ("javascript", "webgl", "the program")

MARKS = ("lf-first-picture", "lf-all-views")


def random_exhibit(shape: tuple[int, ...]) -> Exhibit:
    """Make views of noise, of 8 bits."""
    codes = np.random.default_rng(0).integers(0, 256, shape, np.uint8)
    views = LightField(codes / np.float32(255))
    return Exhibit(views, "Noise", (-2.0, 2.0), 0.0, with_map=False)


def measure_page(browser, url: str, renderer: str) -> dict[str, float]:
    """Open a page; seconds from asking for it to the pictures, and frames a second."""
    page = browser.new_page(viewport={"width": 1200, "height": 900})
    page.goto(f"{url}?renderer={renderer}&bench")
    page.wait_for_function("() => globalThis.lfViewer?.benchmark")
    rate = page.evaluate("() => lfViewer.benchmark")
    first, all_views = (
        page.evaluate("(mark) => performance.getEntriesByName(mark)[0].startTime / 1000", mark)
        for mark in MARKS
    )
    page.close()
    return {"first picture": first, "all views": all_views, "frames a second": rate}


def measure(repetitions: int) -> list[dict]:
    """Open every light field by every renderer; of several times the median."""
    rows = []
    with headless_browser() as browser:
        for shape in SHAPES:
            exhibit = random_exhibit(shape)
            for renderer in RENDERERS:
                sys.stderr.write(f"{shape} by {renderer} ...\n")
                most = 0 if renderer == "the program" else exhibit.most_bytes
                with served(replace(exhibit, most_bytes=most)) as url:
                    runs = [measure_page(browser, url, renderer) for _ in range(repetitions)]
                row = {"views": " x ".join(map(str, shape)), "drawn by": renderer}
                rows.append(row | pd.DataFrame(runs).median().to_dict())
    return rows


COLUMNS = {
    "views": ("views", ""),
    "drawn by": ("drawn by", ""),
    "first picture": ("first picture (s)", ".2f"),
    "all views": ("all views (s)", ".2f"),
    "frames a second": ("frames a second", ".1f"),
}


def main() -> None:
    """Measure, print and write."""
    asked = command_line(__doc__).parse_args()
    repetitions = 1 if asked.small else 3
    record = {"rows": measure(repetitions), "repetitions": repetitions}
    notes = [
        "Seconds from asking for the page, its views in the serving program's memory; frames while "
        "one drags, those of JavaScript coarser where the views are large. No graphics processor. "
        "What the program draws needs no views in the page. Medians of some repetitions."
    ]
    finish(asked.out, "viewer", "The viewer's page", record, COLUMNS, notes)


if __name__ == "__main__":
    main()
