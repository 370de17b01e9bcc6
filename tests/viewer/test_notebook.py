"""The viewer in a real JupyterLab, where there is one."""

import pytest

from experiments.screenshots.notebook import find_jupyter, open_notebook

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

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        find_jupyter() is None,
        reason="needs JupyterLab, see python -m experiments screenshots --help",
    ),
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
