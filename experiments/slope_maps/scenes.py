"""Scenes of opaque layers, textured, faintly textured and bare, and the slope of each pixel.

The light field comes from the library's renderer. The true slopes come from the geometry alone: a
pixel of the middle view has that of the nearest layer that its chief ray meets.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from lf_flame import PAPER_CAMERA
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.scenes.scene import Layer, Scene
from lf_flame.scenes.shapes import shape_texture
from lf_flame.simulation.rendering import render

CAMERA = replace(PAPER_CAMERA, views=9, lenslets=(144, 192))
"""9 x 9 views."""

SLOPES = (-2.7, 3.1)
"""Between which the layers stand."""

LEVELS = 255
"""Codes of the views: 8 bits."""

NOISE = 0.02
"""Standard deviation, as a part of white, in the noisy half of the light fields."""


RAYS = 4
"""Of a pixel, along each axis: seconds for a scene, in place of minutes for the renderer's own
choice, from which the image differs by about 0.01, in fine textures."""


@dataclass(frozen=True)
class Kind:
    """What the layers of a scene look like.

    Attributes
    ----------
    layers : int
        Before the wall.
    contrast : (float, float)
        Least and largest standard deviation of a layer's texture, as parts of white; evenly in the
        logarithm.
    bare : float
        Share of the layers, but for the wall, that have no texture, only a gradient of light.
    bare_wall : float
        Share of the wall without texture, in patches.
    roughness : float
        The amplitude of textures falls with the frequency to this power: 1 as in nature.
    """

    layers: int
    contrast: tuple[float, float]
    bare: float = 0.0
    bare_wall: float = 0.0
    roughness: float = 1.0


KINDS: Mapping[str, Kind] = {
    "textured": Kind(6, (0.1, 0.2)),
    "faint": Kind(8, (0.01, 0.1)),
    "partly bare": Kind(8, (0.02, 0.2), bare=0.5),
    "bare wall": Kind(8, (0.05, 0.2), bare=0.2, bare_wall=0.6),
    "leaves": Kind(40, (0.01, 0.2), bare=0.3),
}


@dataclass(frozen=True, eq=False)
class Sample:
    """A light field and its true slopes.

    Attributes
    ----------
    views : ndarray of float32, shape (v, u, t, s)
        Codes of 8 bits over 255.
    slopes : ndarray of float64, shape (t, s)
        Of the surface that each pixel of the middle view shows.
    """

    views: np.ndarray
    slopes: np.ndarray


def make_sample(kind: Kind, seed: int, camera: PlenopticCamera = CAMERA) -> Sample:
    """Draw a scene, render it and tell its slopes.

    Parameters
    ----------
    kind : Kind
    seed : int
        Of the layers.
    camera : PlenopticCamera, optional
    """
    layers = draw_layers(kind, camera, np.random.default_rng(seed))
    views = render(Scene(layers), camera, integrator="rays", rays=RAYS).views
    return Sample(_coded(views.astype(np.float64)), true_slopes(layers, camera))


def with_noise(sample: Sample, noise: float, seed: int) -> Sample:
    """Add Gaussian noise of a standard deviation, as a part of white; codes are rounded again."""
    added = noise * np.random.default_rng([seed, 1]).standard_normal(sample.views.shape)
    return Sample(_coded(sample.views + added), sample.slopes)


def _coded(views: np.ndarray) -> np.ndarray:
    return (np.rint(LEVELS * np.clip(views, 0, 1)) / LEVELS).astype(np.float32)


def draw_layers(kind: Kind, camera: PlenopticCamera, rng: np.random.Generator) -> list[Layer]:
    """Draw a far wall and ellipses and rectangles before it, the wall first."""
    depth = camera.slope_to_depth(SLOPES[1])
    wall = np.array(camera.field_mm(depth)) * 1.5
    lenslet = camera.field_mm(depth)[0] / camera.lenslets[0]
    cells = _texture(kind, kind.bare_wall, wall, lenslet, rng)
    layers = [Layer(cells, depth, wall, opaque=True)]
    for _ in range(kind.layers):
        slope = rng.uniform(*SLOPES)
        depth = camera.slope_to_depth(slope)
        field = np.array(camera.field_mm(depth))
        lenslet = field[0] / camera.lenslets[0]
        size = field[0] * rng.uniform(0.15, 0.5, 2) * (3 / (kind.layers / 2 + 2)) ** 0.5
        centre = field * rng.uniform(-0.45, 0.45, 2)
        cells = _texture(kind, float(rng.uniform() < kind.bare), size, lenslet, rng)
        round_one = rng.uniform() < 0.5
        coverage = _ellipse(cells.shape) if round_one else None
        cells = cells if coverage is None else cells * coverage
        layers.append(Layer(cells, depth, size, centre, opaque=True, coverage=coverage))
    return layers


def _ellipse(shape: tuple[int, ...]) -> np.ndarray:
    """Coverage of the ellipse that fills a layer, with as many cells."""
    return shape_texture("circle", tuple(map(float, shape)), 1.0)


def _texture(kind: Kind, bare: float, size, lenslet: float, rng: np.random.Generator) -> np.ndarray:
    """Radiance of a layer in cells of half a lenslet: a gradient of light, and noise of nature."""
    shape = [max(int(np.ceil(2 * length / lenslet)), 2) for length in size]
    rows, columns = (np.linspace(-1, 1, n) for n in shape)
    contrast = np.exp(rng.uniform(*np.log(kind.contrast)))
    patches = _noise_of_nature(shape, 2.0, rng)
    textured = patches > np.quantile(patches, bare) if bare < 1 else 0.0
    tilt = rng.uniform(-0.08, 0.08, 2)
    light = rng.uniform(0.25, 0.75) + tilt[0] * rows[:, None] + tilt[1] * columns
    return np.clip(light + contrast * textured * _noise_of_nature(shape, kind.roughness, rng), 0, 1)


def _noise_of_nature(shape, roughness: float, rng: np.random.Generator) -> np.ndarray:
    """Noise whose amplitude falls with the frequency: mean 0, standard deviation 1."""
    frequencies = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1]))
    frequencies[0, 0] = np.inf
    spectrum = np.fft.rfft2(rng.standard_normal(shape)) / frequencies**roughness
    noise = np.fft.irfft2(spectrum, shape)
    return noise / noise.std()


def true_slopes(layers: list[Layer], camera: PlenopticCamera) -> np.ndarray:
    """Slope of the nearest layer at each pixel of the middle view, from the geometry.

    A layer without a coverage covers its rectangle, and one with a coverage the ellipse in it.
    """
    slopes = np.full(camera.lenslets, np.nan)
    for layer in sorted(layers, key=lambda layer: -layer.depth_mm):
        field = camera.field_mm(layer.depth_mm)
        y, x = (
            (field[k] * ((np.arange(n) + 0.5) / n - 0.5) - layer.centre_mm[k])
            / (layer.size_mm[k] / 2)
            for k, n in enumerate(camera.lenslets)
        )
        if layer.coverage is None:
            inside = (np.abs(y) < 1)[:, None] & (np.abs(x) < 1)
        else:
            inside = (y**2)[:, None] + x**2 < 1
        slopes[inside] = camera.depth_to_slope(layer.depth_mm)
    return slopes
