"""A demonstration scene: flames above a burner, in front of a wall."""

from dataclasses import replace

import numpy as np

from lf_flame.lightfield import LightField
from lf_flame.optics.camera import PAPER_CAMERA
from lf_flame.scenes.dead_leaves import DeadLeaves
from lf_flame.scenes.flames import HALF_WIDTH, draw_wrinkles, flame_texture
from lf_flame.scenes.scene import Layer, Scene
from lf_flame.simulation.rendering import render

DEMO_CAMERA = replace(PAPER_CAMERA, views=9, lenslets=(180, 270))
"""Camera with the paper's optics but fewer views and lenslets, to be rendered in seconds."""

WALL_MM, BURNER_MM = 15.0, -10.0
"""Depths of the wall and the burner, which have a pattern."""

DEPTHS_MM = (-14.0, 20.0)
"""Range of depths over which the focus can be moved."""

CELL_MM = 0.1


def demo_scene() -> Scene:
    """Scene of three flames: in the focal plane, behind it and in front of it.

    Behind them is a wall at 15 mm; its lower part is dark, where the burner is, nearer, at -10 mm.
    No object occludes another, so that defocus is the only effect.

    Examples
    --------
    >>> from lf_flame.viewer import demo_scene
    >>> len(demo_scene().layers)
    5
    """
    rng = np.random.default_rng(1)
    wall = _pattern((20.0, 46.0), 0.3, rng)
    burner = _pattern((5.0, 34.0), 0.63, rng)
    return Scene(
        [
            Layer(wall, depth_mm=WALL_MM, size_mm=(20.0, 46.0), centre_mm=(-4.0, 0.0)),
            _flame(15.0, 2.2, 8.0, -9.0, rng),
            _flame(13.0, 2.0, 0.0, 0.0, rng),
            _flame(11.0, 1.8, -6.0, 8.0, rng),
            Layer(burner, depth_mm=BURNER_MM, size_mm=(5.0, 34.0), centre_mm=(9.3, 0.0)),
        ]
    )


def _pattern(size_mm: tuple[float, float], brightness: float, rng: np.random.Generator):
    """Draw overlapping leaves, with texture everywhere."""
    leaves = DeadLeaves(leaves=900, smallest=3.0, largest=30.0, slopes=(0.0, 0.0), contrast=0.2)
    height, width = (round(length / CELL_MM) for length in size_mm)
    return brightness * leaves.draw((1, 1), (height, width), rng).views[0, 0]


def _flame(height: float, radius: float, depth: float, right: float, rng) -> Layer:
    texture = flame_texture(height, radius, draw_wrinkles(rng))
    size = (height, 2 * HALF_WIDTH * radius)
    return Layer(0.6 * texture, depth_mm=depth, size_mm=size, centre_mm=(6.8 - height / 2, right))


def demo_light_field() -> LightField:
    """Render the demonstration scene, as `DEMO_CAMERA` sees it.

    Examples
    --------
    >>> from lf_flame.viewer import demo_light_field
    >>> demo_light_field()
    LightField(9 x 9 views of 180 x 270 pixels, grey)
    """
    return render(demo_scene(), DEMO_CAMERA)
