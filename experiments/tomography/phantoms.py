"""Flames whose emission by depth is known, and light fields of them with noise."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from experiments.paths import DATA_SETS
from lf_flame import LightField, render
from lf_flame.datasets.config import read_config
from lf_flame.datasets.sampling import draw_sample
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.sensor import Sensor, expose
from lf_flame.scenes.flames import HOLLOW_AT_BURNER, flame_texture, projected_glow, radius_profile
from lf_flame.scenes.scene import Layer, Scene
from lf_flame.tomography import FrustumGrid

BLOCK = 3
"""Lenslets to a pixel along each axis: 90 x 180 pixels, as the paper's images."""

EXACT = 1e-6
"""Tolerance at which phantoms are rendered."""


def paper_flames(index: int = 0) -> tuple[Scene, PlenopticCamera]:
    """Draw the four flames of a sample of the paper's flame data set, side by side."""
    config = read_config(DATA_SETS[1])
    scene, _ = draw_sample(config, index)
    return scene, config.camera


def overlapping_flames(depths_mm: Sequence[float], cell_mm: float = 0.1) -> Scene:
    """Four flames of unlike size behind each other, so that every pixel holds several depths."""
    heights, places = (28.0, 22.0, 18.0, 25.0), (-3.0, 2.5, -1.0, 4.0)
    return Scene(
        [
            Layer(
                flame_texture(height, 2.4, cell_mm=cell_mm),
                depth,
                (height, 2 * 3.2 * 2.4),
                (14.0 - height / 2, place),
            )
            for depth, height, place in zip(depths_mm, heights, places, strict=True)
        ]
    )


def shrunk(scene: Scene, ratio: float) -> Scene:
    """Make a scene smaller about the middle of the focal plane, in depth too."""
    return Scene(
        [
            replace(
                layer,
                depth_mm=ratio * layer.depth_mm,
                size_mm=np.multiply(ratio, layer.size_mm),
                centre_mm=np.multiply(ratio, layer.centre_mm),
            )
            for layer in scene.layers
        ]
    )


def in_even_matter(scene: Scene, thickness: float, half_mm: float) -> Scene:
    """Let layers absorb evenly within so much of the middle, an equal share of the thickness each.

    Where they glow alike, ``(1 - exp(-thickness)) / thickness`` of the light is left.
    """
    wide = []
    for layer in scene.layers:
        cell = np.divide(layer.size_mm, layer.texture.shape)
        short = half_mm + np.abs(layer.centre_mm) - np.divide(layer.size_mm, 2)
        down, across = np.maximum(np.ceil(short / cell), 0).astype(int)
        texture = np.pad(layer.texture, [(down, down), (across, across)])
        tau = np.full(texture.shape, thickness / len(scene.layers))
        size = cell * texture.shape
        wide.append(replace(layer, texture=texture, size_mm=size, optical_thickness=tau))
    return Scene(wide)


def in_own_matter(scene: Scene, thickness: float) -> Scene:
    """Let layers absorb as they glow, at their brightest an equal share of the thickness each."""
    share = thickness / len(scene.layers)
    return Scene(
        [
            replace(layer, optical_thickness=share * layer.texture / layer.texture.max())
            for layer in scene.layers
        ]
    )


def round_glow(h: np.ndarray, radius: np.ndarray, radius_mm: float) -> np.ndarray:
    """Emission per mm of a round flame, ``R(r) = (1 + c (r/b)^2) exp(-(r/b)^2)`` by height.

    As `lf_flame.scenes.flames` projects it in closed form; scaled so that its projection along the
    line of sight is 1 at its brightest. Dark below 0 and from 1 on of the share h of its height;
    radii in mm.
    """
    inside = (h >= 0) & (h < 1)
    held = np.where(inside, h, 0.5)
    b, hollow = radius_mm * radius_profile(held), HOLLOW_AT_BURNER * (1 - held)
    squared = (radius / b) ** 2
    return np.where(inside, (1 + hollow * squared) * np.exp(-squared), 0) / _peak(radius_mm)


def _peak(radius_mm: float) -> float:
    h = np.linspace(0, 1, 1001)[:-1, None]
    x = np.linspace(0, 2 * radius_mm, 400)
    b = radius_mm * radius_profile(h)
    return float(projected_glow(x, b, HOLLOW_AT_BURNER * (1 - h)).max())


def volume_flame(
    height_mm: float,
    radius_mm: float,
    slab_mm: float,
    reach_mm: float,
    cell_mm: float = 0.2,
    across_mm: float = 0.0,
) -> Scene:
    """Cut the round flame of `round_glow` into slabs along the line of sight."""
    rows = round(height_mm / cell_mm)
    columns = round(2 * reach_mm / cell_mm)
    h = (1 - (np.arange(rows) + 0.5) / rows)[:, None]
    x = ((np.arange(columns) + 0.5) / columns * 2 - 1) * reach_mm
    count = round(2 * reach_mm / slab_mm)
    depths = (np.arange(count) + 0.5) * slab_mm - reach_mm
    size = (height_mm, 2 * reach_mm)
    return Scene(
        [
            Layer(
                slab_mm * round_glow(h, np.hypot(x, depth), radius_mm),
                float(depth),
                size,
                (0.0, across_mm),
            )
            for depth in depths
        ]
    )


def two_blobs(radius_mm: float, distance_mm: float) -> Scene:
    """Two Gaussian blobs, ``exp(-(r / radius)^2)``, one behind the other about the focal plane.

    In slabs of a quarter of the radius; scaled so that one alone projects to 1.
    """
    step, reach = radius_mm / 4, 2.5 * radius_mm
    across = np.linspace(-reach, reach, 51)
    lateral = np.exp(-((across[:, None] ** 2 + across**2) / radius_mm**2))
    offsets = (np.arange(-10, 10) + 0.5) * step
    share = np.exp(-((offsets / radius_mm) ** 2))
    return Scene(
        [
            Layer(lateral * weight / share.sum(), middle + offset, (2 * reach, 2 * reach))
            for middle in (-distance_mm / 2, distance_mm / 2)
            for offset, weight in zip(offsets, share, strict=True)
        ]
    )


def truth_on(grid: FrustumGrid, scene: Scene) -> np.ndarray:
    """Emission of layers, each in the plane nearest to it, on the pixels of the central view."""
    planes = np.zeros(grid.shape)
    for layer in scene.layers:
        nearest = int(np.argmin(np.abs(np.subtract(grid.depths_mm, layer.depth_mm))))
        planes[nearest] += grid.average(layer, nearest)
    return grid.crop(planes)


def thickness_on(grid: FrustumGrid, scene: Scene) -> np.ndarray:
    """Optical thickness of a scene's layers, laid as `truth_on` lays their emission."""
    matter = [replace(layer, texture=layer.optical_thickness) for layer in scene.layers]
    return truth_on(grid, Scene(matter))


class Recorder:
    """Records a scene once, then with as much noise as is asked for."""

    def __init__(self, scene: Scene, camera: PlenopticCamera):
        self.clean = render(scene, camera, tolerance=EXACT)
        views, (t, s) = self.clean.views, camera.lenslets
        blocks = views.reshape(*views.shape[:2], t // BLOCK, BLOCK, s // BLOCK, BLOCK)
        self.peak = float(blocks.mean(axis=(3, 5)).max())

    def with_noise(self, share: float, rng: np.random.Generator) -> LightField:
        """Add Gaussian noise of a share of the brightest pixel of 90 x 180 to those pixels."""
        views = self.clean.views
        lenslet = np.float32(share * self.peak * BLOCK)  # the mean of 3 x 3 has a third of it
        return LightField(views + lenslet * rng.standard_normal(views.shape, dtype=np.float32))

    def with_electrons(self, electrons: float, rng: np.random.Generator) -> LightField:
        """Count photo-electrons, so many in the brightest pixel of 90 x 180."""
        sensor = Sensor(exposure_e=electrons / BLOCK**2 / self.peak)
        return LightField(expose(self.clean.views, sensor, {"shot_noise"}, rng))
