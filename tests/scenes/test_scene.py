"""Scenes, flames and the two templates."""

import re
from dataclasses import FrozenInstanceError, fields, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad

from lf_flame import InputError, Layer, PlenopticCamera, Scene
from lf_flame.datasets.config import read_config
from lf_flame.optics.sensor import Sensor
from lf_flame.scenes.flames import HALF_WIDTH, projected_glow
from lf_flame.scenes.scene_files import LayerEntry, read_scene
from lf_flame.scenes.shapes import shape_texture

DATA_GEN = Path(__file__).parents[2] / "data_gen"


@pytest.mark.parametrize("hollow", [0.0, 3.0])
def test_projection_is_the_line_integral_of_the_glow(hollow):
    b = 2.4
    for x in (0.0, 1.0, 2.5, 4.0):

        def glow(along, x=x):
            r2 = (x**2 + along**2) / b**2
            return (1 + hollow * r2) * np.exp(-r2)

        integral, _ = quad(glow, -30, 30)
        assert projected_glow(np.array(x), b, hollow) == pytest.approx(integral, rel=1e-9)


def test_heights_have_the_papers_means_and_deviations():
    template = read_config(DATA_GEN / "flames.toml").template
    heights = []
    for index in range(3000):
        rng = np.random.default_rng([1, index])
        # what `draw` does first, without the textures, which cost far more
        swing = np.sqrt(2) * np.array([o.height_sd_mm for o in template.objects])
        means = np.array([o.height_mm for o in template.objects])
        heights.append(means + swing * np.sin(rng.uniform(0, 2 * np.pi, 4)))
    drawn = template.draw(np.random.default_rng([1, 7]))[1]["height_mm"]
    np.testing.assert_array_equal(drawn, heights[7])  # so the loop above is the template's law
    mean, deviation = np.mean(heights, axis=0), np.std(heights, axis=0)
    np.testing.assert_allclose([mean.min(), mean.max()], [14.47, 29.48], atol=0.1)
    assert np.all((deviation > 1.41 - 0.04) & (deviation < 1.48 + 0.04))


@pytest.mark.parametrize("name", ["shapes", "flames"])
def test_templates_stand_where_the_paper_puts_them(name):
    config = read_config(DATA_GEN / f"{name}.toml")
    assert config.depths_mm == [20.0, 10.0, 0.0, -10.0]
    scene, _ = config.template.draw(None)
    for layer in scene.layers:
        field = config.camera.field_mm(layer.depth_mm)
        for axis in (0, 1):
            assert np.abs(layer.cell_edges_mm[axis]).max() < field[axis] / 2


@pytest.mark.slow
@pytest.mark.parametrize("name", ["shapes", "flames"])
def test_draws_stay_in_their_ranges_and_depend_on_the_seed_alone(name):
    template = read_config(DATA_GEN / f"{name}.toml").template
    both = [template.draw(np.random.default_rng([5, i])) for i in range(40)]
    draws = [drawn for _, drawn in both]
    again = template.draw(np.random.default_rng([5, 3]))[1]
    for key, values in again.items():
        np.testing.assert_array_equal(values, draws[3][key])
    place = "centre_mm" if name == "shapes" else "burner_mm"
    mean = template.draw(None)[1][place]
    moved = np.abs([draw[place] - mean for draw in draws])
    assert 0.8 * template.position_mm < moved.max() <= template.position_mm
    brightness = np.array([draw["brightness"] for draw in draws])
    assert brightness.min() >= template.brightness[0]
    assert brightness.max() <= template.brightness[1]
    for scene, drawn in both:  # what is drawn is what the scene shows
        sizes, centres = drawn.get("size_mm"), drawn[place]
        if name == "flames":  # their burner is their lower edge
            radii = [o.radius_mm for o in template.objects]
            sizes = np.transpose([drawn["height_mm"], 2 * HALF_WIDTH * np.array(radii)])
            centres = centres - sizes / 2 * [1, 0]
        np.testing.assert_allclose([x.size_mm for x in scene.layers], sizes)
        np.testing.assert_allclose([x.centre_mm for x in scene.layers], centres)
        peaks = [x.texture.max() for x in scene.layers]
        np.testing.assert_allclose(peaks, drawn["brightness"])


@pytest.mark.slow
def test_shapes_grow_by_one_factor_each_and_keep_their_proportions():
    template = read_config(DATA_GEN / "shapes.toml").template
    mean = template.draw(None)[1]["size_mm"]
    draws = [template.draw(np.random.default_rng([5, i]))[1]["size_mm"] for i in range(60)]
    factors = np.array(draws) / mean
    np.testing.assert_allclose(factors[..., 0], factors[..., 1], rtol=1e-14)
    grown = factors[..., 0] - 1
    for side in (-1, 1):
        assert 0.97 * template.size < (side * grown).max() <= template.size
    assert np.abs(np.diff(grown, axis=1)).max() > template.size  # not all shapes alike


def test_layer_keeps_its_own_texture():
    texture = np.ones((2, 2))
    layer = Layer(texture, 0.0, (1.0, 1.0))
    texture[:] = 5
    assert layer.texture.max() == 1
    with pytest.raises(ValueError, match="read-only"):
        layer.texture[0, 0] = 2


@pytest.mark.parametrize("given", [0.25, [[0.25, 0.25]], np.full((1, 2), 0.25, np.float32)])
def test_layer_keeps_one_type_of_what_is_given_in_many(given):
    layer = Layer([[1, 2]], 3, [1, 2], np.array([0, 0.5]), optical_thickness=given)
    for cells in (layer.texture, layer.optical_thickness):
        assert cells.dtype == np.float64
        assert cells.shape == (1, 2)
    assert layer.optical_thickness.max() == 0.25
    assert (layer.size_mm, layer.centre_mm) == ((1.0, 2.0), (0.0, 0.5))
    assert (layer.opaque, layer.coverage, layer.thickness_mm) == (False, None, 0.0)


def test_a_replaced_value_is_checked_and_the_others_stay():
    layer = Layer([[1.0]], 3.0, (1.0, 2.0), (0.0, 0.5), optical_thickness=0.25, thickness_mm=2.0)
    moved = replace(layer, depth_mm=4.0, optical_thickness=0.5)
    assert moved.optical_thickness == [[0.5]]
    others = [field.name for field in fields(Layer) if field.init]
    others = [name for name in others if name not in ("depth_mm", "optical_thickness")]
    assert all(getattr(moved, name) == getattr(layer, name) for name in others)
    with pytest.raises(InputError, match="thickness_mm 0 or above"):
        replace(layer, thickness_mm=-1.0)
    with pytest.raises(FrozenInstanceError):
        layer.depth_mm = 4.0
    scene = replace(Scene([layer]), layers=[moved, layer])
    assert scene.layers == (moved, layer)


def card(width, x, depth=3.0, **options):
    return Layer([[1.0]], depth, (1.0, width), (0.0, x), **{"opaque": True, **options})


def test_two_cards_at_one_depth_may_touch_but_not_overlap():
    """Edges at 0.3 = 0.1 + 0.2 and 0.7 - 0.4, which differ by a rounding."""
    assert len(Scene([card(0.2, 0.2), card(0.8, 0.7)]).layers) == 2
    with pytest.raises(InputError, match="Layers 1 and 3 .* extents overlap at depth 3"):
        Scene([card(0.2, 0.2), card(0.5, 4.0), card(0.8, 0.7 - 1e-6)])
    Scene([card(0.2, 0.2), card(0.8, 0.5, depth=3.1)])
    Scene([card(0.2, 0.2), card(0.8, 0.5, opaque=False)])
    for order in (1, -1):  # all of one is a hole
        Scene([card(0.2, 0.2), card(0.8, 0.5, coverage=[[0.0]])][::order])


@pytest.mark.parametrize("size", [(12.0, 12.0), (0.1, 0.1), (0.1, 3.0), (7.3, 0.4), (5.0, 9.1)])
def test_cells_of_shapes_count_the_points_inside(size):
    """Exactly, by looking at all 8 x 8 points of each cell."""
    circle, triangle = shape_texture("circle", size), shape_texture("triangle", size)
    rows, columns = circle.shape
    y = (2 * np.arange(8 * rows) + 1)[:, None] / (8 * rows) - 1
    x = (2 * np.arange(8 * columns) + 1) / (8 * columns) - 1
    for found, inside in ((circle, y**2 + x**2 <= 1), (triangle, abs(x) <= (y + 1) / 2)):
        counted = inside.reshape(rows, 8, columns, 8).mean(axis=(1, 3))
        np.testing.assert_array_equal(found, counted)


EXAMPLE = DATA_GEN / "scenes" / "example.toml"


def test_the_example_shows_every_key():
    shown = set(re.findall(r"^(?:# )?(\w+) = ", EXAMPLE.read_text(), re.MULTILINE))
    names = {x.name for kind in (PlenopticCamera, Sensor, LayerEntry) for x in fields(kind)}
    assert names - {"sensor", "image"} <= shown
    assert 'image = "' in EXAMPLE.read_text()
    assert "[camera.sensor]" in EXAMPLE.read_text()


def test_all_keys_of_the_example_can_be_used(tmp_path):
    text = re.sub(r"^# (\[|\w+ = )", r"\1", EXAMPLE.read_text(), flags=re.MULTILINE)
    text = re.sub(r"^f_number = .*$", "", text, flags=re.MULTILINE).replace("0.0124", "0.007")
    (tmp_path / "scene.toml").write_text(text)
    _, camera, effects = read_scene(tmp_path / "scene.toml")
    assert camera.rim_diameter_mm == 140
    assert camera.sensor.bits == 12
    assert effects == {"read_noise": False}


def test_wrong_keys_are_told_all_at_once_with_those_that_are_like_them(tmp_path):
    text = EXAMPLE.read_text().replace("views = 9", "veiws = 9").replace("depth_mm", "depht_mm")
    text = re.sub(r"^lenslet_pitch_mm = .*$", "", text, flags=re.MULTILINE)
    (tmp_path / "scene.toml").write_text(text + "\nxyzzy = 3\n")
    with pytest.raises(InputError) as found:
        read_scene(tmp_path / "scene.toml")
    said = str(found.value)
    assert "camera.veiws is not a known key (perhaps views)" in said
    assert "camera.lenslet_pitch_mm is missing; camera.views is missing" in said
    for layer in (1, 2, 3):
        assert f"layers #{layer}.depht_mm is not a known key (perhaps depth_mm" in said
    assert "layers #3.xyzzy is not a known key (known keys: depth_mm, size_mm," in said
