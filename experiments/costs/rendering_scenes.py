"""Scenes and cameras on which the simulator's costs are measured."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lf_flame.datasets.config import read_config
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.sensor import Sensor
from lf_flame.scenes.flames import HALF_WIDTH, flame_texture
from lf_flame.scenes.scene import Layer, Scene
from lf_flame.scenes.shapes import shape_texture

CONFIGS = ("data_gen/shapes.toml", "data_gen/flames.toml")
"""Data sets whose scenes are taken if no others are given."""

CENTRAL_VIEWS = 5
"""Views along an axis, out of the camera's own, on which the methods of integration are
compared."""


@dataclass(frozen=True)
class Study:
    """A scene on which the methods of integration are compared.

    Attributes
    ----------
    name, title : str
        In the tables, and over the panel of the figure.
    scene : Scene
    camera : PlenopticCamera
    """

    name: str
    title: str
    scene: Scene
    camera: PlenopticCamera

    @property
    def pixels(self) -> int:
        """Pixels of the image."""
        return self.camera.views**2 * math.prod(self.camera.lenslets)

    @property
    def hides(self) -> bool:
        """Whether a layer hides another."""
        return any(layer.opaque for layer in self.scene.layers)


@dataclass(frozen=True)
class Trial:
    """A scene and a camera that call for an effect."""

    scene: Scene
    camera: PlenopticCamera


def study_scenes(shapes: Path, flames: Path) -> list[Study]:
    """Set up the scenes of the study from the templates of both data sets.

    Optics, pixels, objects and depths are the data sets'. So that slow methods get somewhere, the
    objects stand on the axis, one in front of the other, and no more is recorded than the central
    views of the lenslets that see them.

    Parameters
    ----------
    shapes, flames : Path
        Data-set configurations.
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


def effect_trials(camera: PlenopticCamera, height_mm: float = 6.0) -> dict[str, Trial]:
    """Set up, for each effect, a small flame before a camera in which the effect matters.

    Parameters
    ----------
    camera : PlenopticCamera
        Its optics and views; the lenslets follow from the scene.
    height_mm : float, optional
        Height of the flame, which decides the size of the images.
    """
    texture = flame_texture(height_mm, height_mm / 8)
    size = (height_mm, 2 * HALF_WIDTH * height_mm / 8)
    near, far = Layer(texture, 10.0, size), Layer(texture, 30.0, size)
    sooty = replace(near, optical_thickness=0.2 * texture)
    lone, camera = Scene([near]), _framed(camera, [near, far])

    def before(scene: Scene = lone, **changes) -> Trial:
        return Trial(scene, replace(camera, **changes))

    width = camera.aperture_mm
    return {
        "defocus": before(),
        "occlusion": before(Scene([near, _disc(height_mm / 4, -10.0)])),
        "self_absorption": before(Scene([sooty, far])),
        "thickness": before(Scene([replace(near, thickness_mm=height_mm / 4)])),
        "cos4": before(falloff_corrected=False),
        "round_aperture": before(aperture_diameter_mm=width),
        "f_number_mismatch": before(aperture_diameter_mm=1.1 * width),
        "vignetting": before(rim_diameter_mm=width, rim_distance_mm=40.0),
        "lenslet_diffraction": before(wavelength_nm=550.0),
        "main_lens_diffraction": before(wavelength_nm=550.0),
        "lenslet_rotation": before(lenslet_rotation_rad=2e-3),
        "lenslet_pitch_error": before(lenslet_pitch_error=2e-3),
        "chromatic": before(chromatic_shift=0.01),
        "shot_noise": before(sensor=Sensor(8000.0)),
        "read_noise": before(sensor=Sensor(8000.0, read_noise_e=20.0)),
        "quantisation": before(sensor=Sensor(8000.0, bits=8)),
        "saturation": before(sensor=Sensor(8000.0, full_well_e=6000.0)),
    }


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
