"""The viewer in a notebook: what Python sends to the page."""

import numpy as np
import pytest

from lf_flame import LightField
from lf_flame.viewer import show

widgets = pytest.importorskip("lf_flame.viewer.widget", reason="needs anywidget")


@pytest.fixture
def widget(rng):
    views = rng.uniform(size=(5, 5, 20, 30)).astype(np.float32)
    return show(LightField(views), slopes=(-2, 2), with_map=True)


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
