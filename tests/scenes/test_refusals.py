"""Refusals of scenes, each in one sentence."""

from functools import partial
from pathlib import Path

import numpy as np
from builders import scene_toml
from sentences import each, refusals

from lf_flame import Layer, Scene
from lf_flame.scenes.dead_leaves import DeadLeaves
from lf_flame.scenes.flames import flame_texture
from lf_flame.scenes.scene_files import LayerEntry, read_camera, read_scene
from lf_flame.scenes.shapes import shape_texture


def layer(**values):
    return Layer(**{"texture": [[1.0]], "depth_mm": 0.0, "size_mm": (1.0, 1.0), **values})


def file(read, old, new):
    """Call that reads a file of a camera of f/3.57 in which a line is another."""

    def call():
        Path("scene.toml").write_text(scene_toml(15, (9, 9)).replace(old, new))
        return read(Path("scene.toml"))

    return call


PITCH = "lenslet_pitch_mm = 0.112"

test_it_is_refused_in_a_sentence = refusals(
    [
        *each(
            layer,
            ({"texture": np.ones(3)}, "texture must be a grey image"),
            ({"texture": [[1.0], [1.0, 2.0]]}, "texture must be real numbers"),
            ({"optical_thickness": "thick"}, "optical_thickness must be real numbers"),
            ({"size_mm": "8 x 8"}, "size_mm must be real numbers"),
            ({"depth_mm": "near"}, "depth_mm, thickness_mm must be real numbers"),
            ({"texture": [[np.nan]]}, "finite and not negative"),
            ({"texture": [[-1.0]]}, "finite and not negative"),
            ({"size_mm": (0.0, 1.0)}, "size_mm of a layer must be from 1e-250 to 1e"),
            ({"centre_mm": (np.inf, 0)}, "centre_mm must be two finite"),
            ({"depth_mm": np.nan}, "depth_mm, thickness_mm must be two finite"),
            ({"size_mm": (1e-308, 1.0)}, "must be from 1e-250"),
            ({"centre_mm": (1e17, 0.0)}, "larger than the rounding of centre_mm"),
            ({"tilt_deg": (90, 0)}, "within 85 degrees"),
        ),
        (partial(LayerEntry, 0.0, (1, 1), image="../a.png"), "scene file's folder, got '../a"),
        (partial(Scene, []), r"layers, one or more, got \[\]"),
        (partial(Scene, [1]), r"layers, one or more, got \[1\]"),
        (lambda: Scene(layer()), "list of layers, one or more, got Layer"),
        (partial(shape_texture, "star", (1.0, 1.0)), "Unknown shape 'star'"),
        (partial(shape_texture, "circle", (1.0, 1.0), 0.0), r"above 0, got \(1.0, 1.0\) and 0.0"),
        (partial(flame_texture, 20.0, 0.0), r"above 0, got \(20.0, 0.0, 0.1\)"),
        (partial(flame_texture, np.nan, 3.0, cell_mm=0.0), "above 0, got .nan, 3.0, 0.0"),
        *each(
            DeadLeaves,
            ({"leaves": 0}, "Leaves must be 1 or more"),
            ({"smallest": 9.0, "largest": 5.0}, "lengths increase"),
            ({"contrast": -0.1}, "contrast be 0 or above"),
            ({"slopes": (1.0, -1.0)}, "two increasing numbers"),
            ({"wavelength": (1.0, 5.0)}, "wavelength from 2 pixels, got"),
        ),
        *(
            (file(read, PITCH, new), said)
            for read in (read_camera, read_scene)
            for new, said in (
                (f"{PITCH}\naperture_diameter_mm = 301.0", "301 mm, as .* faster than f/0.5;"),
                (f"{PITCH[:-5]}112.0", r"7.78e\+04 mm, which matches the lenslets, is f/0.0019,"),
            )
        ),
    ]
)
