"""The viewer in a notebook: Python's side alone, and the page's beside a model like Jupyter's."""

import base64
import json

import numpy as np
import pytest

from lf_flame import LightField
from lf_flame.refocus import aperture_weights, refocus, shift_and_sum
from lf_flame.viewer import show
from lf_flame.viewer.scripts import script_url

widgets = pytest.importorskip("lf_flame.viewer.widget", reason="needs anywidget")

PAGE = """<!DOCTYPE html><title>notebook</title><div id="cell"></div>
<script type="module">
import widget from "%s";
const listeners = {};
const state = %s;
globalThis.sent = [];
globalThis.model = {
  get: (name) => state[name],
  set: (name, value) => { state[name] = value; },
  save_changes: () => sent.push({ ...state }),
  on: (event, act) => { (listeners[event] ??= []).push(act); },
  send: async (content) => {
    for (const [answer, data] of await globalThis.ask(content)) {
      const buffers = data.map((text) => {
        const bytes = Uint8Array.from(atob(text), (x) => x.charCodeAt(0));
        return new DataView(bytes.buffer);
      });
      model.tell("msg:custom", answer, buffers);
    }
  },
  tell: (event, ...what) => { for (const act of listeners[event] ?? []) act(...what); },
};
globalThis.end = widget.render({ model, el: document.getElementById("cell") });
</script>"""


@pytest.fixture
def widget(rng):
    views = rng.uniform(size=(5, 5, 20, 30)).astype(np.float32)
    return show(LightField(views), slopes=(-2, 2), with_map=True)


@pytest.fixture
def filled(tab, tmp_path, monkeypatch):
    """Show a widget in a cell whose page talks to it, as a notebook's kernel would."""

    def fill(widget):
        def answer(content):
            sent = []
            monkeypatch.setattr(widget, "send", lambda *what: sent.append(what))
            widget._answer(widget, content, [])
            return [(told, [base64.b64encode(x).decode() for x in data]) for told, data in sent]

        tab.page.expose_function("ask", answer)
        names = ("metadata", "slope", "aperture", "shape", "viewpoint", "region")
        state = json.dumps({name: getattr(widget, name) for name in names})
        (tmp_path / "cell.html").write_text(PAGE % (script_url("widget.js"), state))
        tab.page.goto((tmp_path / "cell.html").as_uri())
        tab.page.wait_for_function("() => globalThis.lfViewer")
        tab.page.evaluate("() => lfViewer.ready")
        tab.settle()
        return tab

    return fill


@pytest.fixture
def cell(filled, widget):
    return filled(widget)


def test_the_cell_shows_the_light_field(cell, widget):
    image = shift_and_sum(widget._exhibit.light_field, [0.0])[0]
    assert np.abs(cell.canvas() - np.rint(255 * image)[..., None]).max() <= 1


def test_what_python_sets_is_drawn(cell, widget):
    cell.page.evaluate(
        """() => { model.set("slope", 0.75); model.set("viewpoint", [1, -0.5]);
                   model.set("aperture", 0.4); model.tell("change:slope"); }"""
    )
    cell.settle()
    state = cell.page.evaluate("() => lfViewer.state")
    assert (state["slope"], state["centre"], state["width"]) == (0.75, [1, -0.5], 0.4)
    assert cell.page.evaluate("() => sent") == []  # nothing goes back that came from there


def test_what_is_dragged_reaches_python(cell):
    cell.page.get_by_role("slider", name="Slope").fill("1.25")
    assert cell.page.evaluate("() => sent.at(-1).slope") == 1.25
    cell.set(region=[1, 5, 2, 9], centre=[0.5, 0])
    last = cell.page.evaluate("() => sent.at(-1)")
    assert (last["region"], last["viewpoint"]) == ([1, 5, 2, 9], [0.5, 0])


def test_only_what_it_shows_is_sent(widget, monkeypatch):
    sent = []
    monkeypatch.setattr(widget, "send", lambda *what: sent.append(what))
    for content in ({"ask": "views/99"}, {"ask": "../setup.cfg"}, {}, None, {"ask": ["views/0"]}):
        widget._answer(widget, content, [])
    assert sent == []
    widget._answer(widget, {"ask": "views/0"}, [])
    assert len(sent[0][1][0]) == 20 * 30 * 2


def test_senseless_traits_are_refused(widget):
    traitlets = pytest.importorskip("traitlets")
    for name, value in (("shape", "star"), ("viewpoint", [1.0]), ("region", [1, 2])):
        with pytest.raises(traitlets.TraitError):
            setattr(widget, name, value)


def test_python_makes_planes_by_messages(rng, monkeypatch):
    views = rng.uniform(size=(3, 4, 12, 14)).astype(np.float32)
    widget = show(LightField(views), slopes=(-2, 2), with_map=False, interpolation="sinc")
    sent = []
    monkeypatch.setattr(widget, "send", lambda *what: sent.append(what))
    query = "plane?slope=0.5&shape=square&width=1&ring=0&v=0&u=0&block=1"
    for asked in (query, query.replace("0.5", "nan"), "views/0", "plane"):
        widget._answer(widget, {"ask": asked}, [])
    (content, [buffer]), (refused, none), (other, _) = sent
    assert content == {"answer": query}
    image = np.frombuffer(buffer, "<f4").reshape(12, 14)
    np.testing.assert_allclose(image, refocus(views, [0.5], interpolation="sinc")[0], atol=1e-6)
    assert refused["error"] == "slope must be a plain number."
    assert none == []
    assert other["error"].startswith("The query must contain each of slope, shape")


def test_a_cell_shows_planes_that_python_makes(filled, rng):
    views = rng.uniform(size=(5, 5, 20, 30)).astype(np.float32)
    cell = filled(show(LightField(views), slopes=(-2, 2), with_map=False, interpolation="cubic"))
    assert cell.page.evaluate("() => lfViewer.renderer.name") == "the program"
    cell.set(slope=0.61, width=0.5)
    image = refocus(
        views, [0.61], interpolation="cubic", weights=aperture_weights((5, 5), 0.5, shape="square")
    )
    assert np.abs(cell.canvas() - np.rint(255 * image[0].clip(0, 1))[..., None]).max() <= 1
    words = cell.page.evaluate("() => lfViewer.source.plane('slope=1').catch((x) => x.message)")
    assert words.startswith("The query must contain each of")
