"""Scenes and cameras on which the simulator's costs are measured."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lf_flame.datasets.config import read_config
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.scenes.scene import Layer, Scene
from lf_flame.scenes.shapes import shape_texture

CENTRAL_VIEWS = 5
"""Views along an axis, out of the camera's own, on which the methods of integration are
compared."""


@dataclass(frozen=True)
class Study:
    """A scene on which methods are compared; its title stands over a panel of the figure."""

    name: str
    title: str
    scene: Scene
    camera: PlenopticCamera

    @property
    def pixels(self) -> int:
        """Pixels of the image."""
        return self.camera.views**2 * math.prod(self.camera.lenslets)


def study_scenes(shapes: Path, flames: Path) -> list[Study]:
    """Set up the scenes of the study from the templates of both data sets.

    Optics, pixels, objects and depths are the data sets'. So that slow methods get somewhere, the
    objects stand on the axis, one in front of the other, and no more is recorded than the central
    views of the lenslets that see them.
    """
    config = read_config(shapes)
    layers = [
        replace(layer, centre_mm=(0.0, 0.0)) for layer in config.template.draw(None)[0].layers
    ]
    depths = ", ".join(f"{layer.depth_mm:g}" for layer in layers)
    title = f"{len(layers)} shapes at {depths} mm"
    found = [Study("shapes", title, Scene(layers), _central(config.camera, layers))]
    config = read_config(flames)
    smallest = min(config.template.draw(None)[0].layers, key=lambda layer: layer.size_mm[0])
    flame = replace(smallest, centre_mm=(0.0, 0.0))
    camera = _central(config.camera, [flame])
    found.append(Study("flame", f"a flame at {flame.depth_mm:g} mm", Scene([flame]), camera))
    disc = _disc(flame.size_mm[0] / 3, flame.depth_mm - 20.0)
    title = "the same flame, a disc 20 mm in front of it"
    found.append(Study("hidden", title, Scene([flame, disc]), camera))
    return found


def _disc(diameter_mm: float, depth_mm: float) -> Layer:
    """Make a black disc on the axis."""
    size = (diameter_mm, diameter_mm)
    coverage = shape_texture("circle", size, diameter_mm / 20)
    return Layer(np.zeros(coverage.shape), depth_mm, size, opaque=True, coverage=coverage)


def _central(camera: PlenopticCamera, layers: Sequence[Layer]) -> PlenopticCamera:
    views = min(camera.views, CENTRAL_VIEWS)
    return _framed(replace(camera, views=views, pixel_pitch_mm=camera.pixel_mm), layers)


def _framed(camera: PlenopticCamera, layers: Sequence[Layer]) -> PlenopticCamera:
    """Record as many lenslets as it takes for all views to see all of layers on the axis."""
    lenslets = []
    for axis in (0, 1):
        needed = 1
        for layer in layers:
            lenslet_mm = camera.field_mm(layer.depth_mm)[axis] / camera.lenslets[axis]
            aside = abs(layer.depth_mm) / camera.focus_distance_mm * camera.view_step_mm
            seen_mm = layer.size_mm[axis] + aside * camera.views
            needed = max(needed, math.ceil(seen_mm / lenslet_mm) + 2)
        lenslets.append(needed)
    return replace(camera, lenslets=tuple(lenslets))
