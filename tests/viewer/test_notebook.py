"""The viewer in a real JupyterLab, where there is one, in a headless browser.

Nothing of the user's own Jupyter is read or changed.
"""

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

CELLS = [
    "import numpy as np\n"
    "from lf_flame import LightField\n"
    "from lf_flame.viewer import show\n"
    "light_field = LightField(np.random.default_rng(0).uniform(size=(5, 5, 60, 90)))\n"
    "widget = show(light_field, slopes=(-2, 2), with_map=False%s)\n"
    "widget",
    "1",
    "2",
]

QUIET = {"disabledExtensions": {"@jupyterlab/apputils-extension:announcements": True}}
"""So that JupyterLab asks the network for no news."""

PATIENCE = 120.0
"""Seconds that JupyterLab may take to start."""


def find_jupyter() -> Path | None:
    """Path of JupyterLab's program: beside this Python, or on the PATH; none if it is missing."""
    found = shutil.which("jupyter-lab", path=Path(sys.executable).parent) or shutil.which(
        "jupyter-lab"
    )
    return Path(found) if found else None


class Notebook:
    """A notebook that is open in a browser's page, and errors that the page told its console."""

    def __init__(self, page):
        self.page = page
        self.complaints: list[str] = []
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on("console", self._hear)

    def _hear(self, message) -> None:
        if message.type == "error":
            self.complaints.append(f"{message.text} ({message.location['url']})")

    def open(self, url: str) -> None:
        """Open a notebook's address, and wait for its kernel."""
        self.page.goto(url)
        self.page.wait_for_function(
            "() => globalThis.jupyterapp?.shell.currentWidget?.context?.sessionContext"
            ".session?.kernel?.status === 'idle'",
            timeout=1000 * PATIENCE,
        )

    def run_cells(self) -> None:
        """Run all cells, and wait for the viewer that they show."""
        self.page.evaluate("() => jupyterapp.commands.execute('notebook:run-all-cells')")
        self.page.wait_for_function("() => globalThis.lfViewer", timeout=1000 * PATIENCE)
        self.page.evaluate("() => lfViewer.ready.then(() => lfViewer.drawn())")

    def run(self, code: str) -> str:
        """Run code in the notebook's kernel; give what it prints, and errors in it."""
        return self.page.evaluate(
            """async (code) => {
              const { context } = jupyterapp.shell.currentWidget;
              const { kernel } = context.sessionContext.session;
              const future = kernel.requestExecute({ code });
              let text = "";
              future.onIOPub = ({ content: { text: said, ename, evalue } }) => {
                text += said ?? (ename ? `${ename}: ${evalue}` : "");
              };
              await future.done;
              return text;
            }""",
            code,
        )


@contextmanager
def open_notebook(browser, jupyter: Path, cells: list[str]) -> Iterator[Notebook]:
    """Open a new notebook of cells of code."""
    with TemporaryDirectory() as aside:
        folder = Path(aside)
        (folder / "notebooks").mkdir()
        (folder / "notebooks" / "light_field.ipynb").write_text(_notebook(cells), encoding="utf-8")
        with _lab(jupyter, folder) as (url, token):
            page = browser.new_page(viewport={"width": 1100, "height": 860})
            notebook = Notebook(page)
            notebook.open(f"{url}doc/tree/light_field.ipynb?token={token}")
            yield notebook
            page.close()


def _notebook(cells: list[str]) -> str:
    common = {"cell_type": "code", "metadata": {}, "outputs": [], "execution_count": None}
    listed = [common | {"id": f"cell-{k}", "source": code} for k, code in enumerate(cells)]
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    metadata = {"kernelspec": kernel}
    return json.dumps({"cells": listed, "metadata": metadata, "nbformat": 4, "nbformat_minor": 5})


@contextmanager
def _lab(jupyter: Path, folder: Path) -> Iterator[tuple[str, str]]:
    """Run JupyterLab on this machine alone; gives its address and its token."""
    places = {name: folder / name for name in ("CONFIG", "DATA", "RUNTIME")}
    (places["CONFIG"] / "labconfig").mkdir(parents=True)
    (places["CONFIG"] / "labconfig" / "page_config.json").write_text(json.dumps(QUIET))
    environment = {f"JUPYTER_{name}_DIR": str(place) for name, place in places.items()}
    words = [
        str(jupyter), "--no-browser", "--allow-root", "--ip=127.0.0.1", "--port=0",
        f"--ServerApp.root_dir={folder / 'notebooks'}", "--LabApp.expose_app_in_browser=True",
        "--LabApp.extension_manager=readonly",
    ]  # fmt: skip
    # Without what leads this Python to its packages: JupyterLab has its own.
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    environment |= {"IPYTHONDIR": str(folder / "ipython"), "HOME": str(folder)}
    with (folder / "log").open("w") as log:
        process = subprocess.Popen(
            words, env=kept | environment, cwd=folder, stdout=log, stderr=log
        )
        try:
            yield _wait_for(process, places["RUNTIME"], folder / "log")
        finally:
            process.terminate()
            process.wait(timeout=60)


def _wait_for(process: subprocess.Popen, runtime: Path, log: Path) -> tuple[str, str]:
    """Read where a JupyterLab listens, as soon as it says so."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end and process.poll() is None:
        for path in runtime.glob(f"jpserver-{process.pid}.json"):
            text = path.read_text()
            if text.endswith("}"):
                said = json.loads(text)
                return said["url"], said["token"]
        time.sleep(0.2)
    last = log.read_text().strip().splitlines()[-1:]
    pytest.fail(f"JupyterLab does not start: {''.join(last) or 'it says nothing'}.")


pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(find_jupyter() is None, reason="needs JupyterLab"),
]


@pytest.fixture(params=["", ", interpolation='sinc'"], ids=["views", "planes"])
def notebook(chromium, request):
    """A notebook that shows a light field; what the page complains of fails the test."""
    cells = [CELLS[0] % request.param, *CELLS[1:]]
    with open_notebook(chromium, find_jupyter(), cells) as notebook:
        notebook.run_cells()
        yield notebook
        assert notebook.complaints == []


def test_it_draws_and_shares_its_state_both_ways(notebook):
    page = notebook.page
    by_python = "planes" if notebook.run("print(len(widget._data.questions))") == "2\n" else "views"
    name = page.evaluate("() => lfViewer.renderer.name")
    assert (name == "the program") == (by_python == "planes")
    drawn = page.evaluate("() => lfViewer.drawn().then(() => lfViewer.renderer.read().length)")
    assert drawn == 60 * 90

    assert notebook.run("widget.slope = 0.8; widget.viewpoint = [1, -0.5]") == ""
    page.wait_for_function("() => lfViewer.state.slope === 0.8 && lfViewer.state.centre[0] === 1")
    page.evaluate("() => lfViewer.set({ slope: -0.4, region: [1, 5, 2, 9], width: 0.5 })")
    page.wait_for_timeout(500)
    told = notebook.run("print(widget.slope, widget.region, widget.aperture)")
    assert told == "-0.4 [1, 5, 2, 9] 0.5\n"

    slider = page.get_by_role("slider", name="Slope")
    slider.focus()
    slider.press("ArrowDown")  # which JupyterLab would take for the next cell
    slider.press("ArrowDown")
    assert page.evaluate("() => lfViewer.state.slope") == pytest.approx(-0.42, abs=1e-6)
    assert page.evaluate("() => document.activeElement.type") == "range"
