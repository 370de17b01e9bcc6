"""What light fields, scenes, plans and searches show in a notebook."""

import base64
import io
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from lf_flame import Layer, LightField, Scene, plan_effects
from lf_flame.refocus import find_sharpest_slope


class Strict(HTMLParser):
    """Refuses tags that are not closed."""

    def __init__(self, text):
        super().__init__()
        self.open, self.seen = [], []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        self.seen.append((tag, dict(attributes)))
        if tag not in ("img", "polyline"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        if tag != "polyline":
            assert self.open.pop() == tag


def shown(thing):
    """What a notebook gets: small, whole and without scripts."""
    text = thing._repr_html_()
    assert len(text.encode()) < 60_000
    assert "<script" not in text
    return text, Strict(text).seen


@pytest.mark.parametrize(
    "shape", [(3, 3, 8, 9), (2, 4, 300, 700), (3, 3, 200, 300, 3), (1, 1, 2, 2, 4)]
)
def test_a_light_field_shows_its_central_view_and_size(rng, shape):
    text, seen = shown(LightField(rng.uniform(size=shape)))
    assert f"{shape[0]} x {shape[1]} views of {shape[2]} x {shape[3]} pixels" in text
    assert seen[0][0] == "img"
    assert seen[0][1]["alt"] == "Central view"


def test_a_dark_light_field_is_no_error():
    _, seen = shown(LightField(np.zeros((2, 2, 4, 4))))
    png = base64.b64decode(seen[0][1]["src"].partition(",")[2])
    assert not np.asarray(Image.open(io.BytesIO(png))).any()


def test_a_scene_shows_its_layers_where_they_are():
    white = np.ones((4, 4))
    behind = Layer(white, depth_mm=20.0, size_mm=(8.0, 6.0), centre_mm=(-3.0, 0.0))
    before = Layer(white, depth_mm=-10.0, size_mm=(4.0, 6.0), centre_mm=(5.0, 0.0), opaque=True)
    scene = Scene([behind, before])
    text, seen = shown(scene)
    assert "opaque" in text
    lines = [attributes["points"] for tag, attributes in seen if tag == "polyline"]
    (far, near) = (np.array(re.findall(r"[\d.]+", x), float).reshape(2, 2) for x in lines)
    assert far[0, 0] > near[0, 0]  # farther to the right
    assert far[:, 1].max() < near[:, 1].min()  # centre_mm counts downward, the drawing's y too
    heights = [abs(np.diff(x[:, 1])[0]) for x in (far, near)]
    assert heights[0] == pytest.approx(2 * heights[1], rel=0.02)


def test_a_plan_shows_each_effect_and_why(small_camera):
    scene = Scene([Layer(np.ones((4, 4)), depth_mm=5.0, size_mm=(2.0, 2.0))])
    plan = plan_effects(scene, small_camera)
    text, seen = shown(plan)
    assert len([tag for tag, _ in seen if tag == "tr"]) == len(plan.effects) + 1
    assert "defocus" in text


def test_a_search_shows_its_curve(rng):
    texture = rng.uniform(size=(40, 60))
    views = [[np.roll(texture, (v, u), (0, 1)) for u in (-1, 0, 1)] for v in (-1, 0, 1)]
    search = find_sharpest_slope(np.array(views))
    text, seen = shown(search)
    assert f"{search.slope:+.3f}" in text
    curve = next(attributes["points"] for tag, attributes in seen if tag == "polyline")
    points = np.array(re.findall(r"[\d.]+", curve), float).reshape(-1, 2)
    assert len(points) == len(search.slopes)
    assert points[:, 1].argmin() == search.sharpness.argmax()
