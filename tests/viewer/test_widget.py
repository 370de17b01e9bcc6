"""The viewer in a notebook: Python's side alone, and the page's beside a model like Jupyter's."""

import base64
import json

import numpy as np
import pytest

from lf_flame import LightField
from lf_flame.refocus import shift_and_sum
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
  send: (content) => globalThis.ask(content),
  tell: (event, ...what) => { for (const act of listeners[event] ?? []) act(...what); },
};
globalThis.end = widget.render({ model, el: document.getElementById("cell") });
</script>"""


@pytest.fixture
def widget(rng):
    views = rng.uniform(size=(5, 5, 20, 30)).astype(np.float32)
    return LightField(views).view(slopes=(-2, 2), with_map=True)


@pytest.fixture
def cell(tab, widget, tmp_path, monkeypatch):
    """A cell whose page talks to the widget, as a notebook's kernel would."""

    def answer(content):
        sent = []
        monkeypatch.setattr(
            widget, "send", lambda content, buffers: sent.append((content, buffers))
        )
        widget._answer(widget, content, [])
        for content, buffers in sent:
            data = base64.b64encode(buffers[0]).decode()
            tab.page.evaluate(
                """([content, data]) => {
                  const bytes = Uint8Array.from(atob(data), (x) => x.charCodeAt(0));
                  model.tell("msg:custom", content, [new DataView(bytes.buffer)]);
                }""",
                [content, data],
            )

    tab.page.expose_function("ask", lambda content: asked.append(content))
    asked = []
    names = ("metadata", "slope", "aperture", "shape", "viewpoint", "region")
    state = json.dumps({name: getattr(widget, name) for name in names})
    (tmp_path / "cell.html").write_text(PAGE % (script_url("widget.js"), state))
    tab.page.goto((tmp_path / "cell.html").as_uri())
    tab.page.wait_for_function("() => globalThis.lfViewer")
    for _ in range(len(widget._pieces) + 1):
        tab.page.wait_for_timeout(50)
        while asked:
            answer(asked.pop())
    tab.page.evaluate("() => lfViewer.ready")
    tab.settle()
    return tab


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
