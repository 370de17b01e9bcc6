"""The paper's two kinds of scene, four shapes or four flames on four layers, drawn at random.

A template has the objects and the ranges over which they vary; `draw` gives one scene and the
values that were drawn, from a generator alone. Both templates are part of a data set's
configuration.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from lf_flame._common.config import strict
from lf_flame.errors import InputError
from lf_flame.scenes.flames import HALF_WIDTH, draw_wrinkles, flame_texture
from lf_flame.scenes.scene import Layer, Scene
from lf_flame.scenes.shapes import shape_texture

Pair = tuple[float, float]


@strict
@dataclass(frozen=True)
class ShapeObject:
    """A shape at its mean position: bounding box (height, width) and centre (y, x), in mm."""

    shape: Literal["rectangle", "triangle", "circle", "square"]
    depth_mm: float
    size_mm: Pair
    centre_mm: Pair

    @property
    def name(self) -> str:
        """Name of the shape in tables."""
        return self.shape


@strict
@dataclass(frozen=True)
class ShapeTemplate:
    """Shapes with random position, size and brightness, independent of one another.

    Parameters
    ----------
    objects : list of ShapeObject
        Shapes at their mean positions.
    position_mm : float
        Largest displacement of a centre in both directions, uniform in y and x.
    size : float
        Largest relative change of size in both directions, uniform, with constant proportions.
    brightness : (float, float)
        Range of the radiance, uniform, inside [0, 1].
    opaque : bool, optional
        Whether shapes occlude what is behind them; their depths must then differ.
    """

    objects: list[ShapeObject]
    position_mm: float
    size: float
    brightness: Pair
    opaque: bool = False

    def __post_init__(self):
        _check_ranges(self.brightness, position_mm=self.position_mm, size=self.size)
        if self.size >= 1:
            raise InputError(f"size must be below 1, got {self.size}.")
        depths = [o.depth_mm for o in self.objects]
        if self.opaque and len(set(depths)) < len(depths):
            raise InputError(f"Opaque shapes must be at different depths, got {depths} mm.")

    def draw(self, rng: np.random.Generator | None) -> tuple[Scene, dict[str, np.ndarray]]:
        """Draw a scene; without a generator, the mean scene at full brightness.

        Returns
        -------
        Scene
        dict
            Arrays ``centre_mm`` and ``size_mm``, (objects, 2), and ``brightness``, (objects,).
        """
        n = len(self.objects)
        centres = np.array([o.centre_mm for o in self.objects], float)
        sizes = np.array([o.size_mm for o in self.objects], float)
        brightness = np.ones(n)
        if rng is not None:
            centres += rng.uniform(-self.position_mm, self.position_mm, (n, 2))
            sizes *= rng.uniform(1 - self.size, 1 + self.size, (n, 1))
            brightness = rng.uniform(*self.brightness, n)
        drawn = zip(self.objects, centres, sizes, brightness, strict=True)
        layers = [self._layer(*each) for each in drawn]
        return Scene(layers), {"centre_mm": centres, "size_mm": sizes, "brightness": brightness}

    def _layer(self, shape: ShapeObject, centre: np.ndarray, size: Any, brightness: float) -> Layer:
        cells = shape_texture(shape.shape, size)
        covered = cells if self.opaque else None
        return Layer(
            brightness * cells, shape.depth_mm, size, centre, opaque=self.opaque, coverage=covered
        )


@strict
@dataclass(frozen=True)
class FlameObject:
    """A flame at its mean height: burner (y, x), heights and nominal radius, in mm."""

    name: str
    depth_mm: float
    burner_mm: Pair
    height_mm: float
    height_sd_mm: float
    radius_mm: float

    def __post_init__(self):
        _check_ranges((0, 1), height_sd_mm=self.height_sd_mm)
        if not (self.radius_mm > 0 and self.height_mm > 2**0.5 * self.height_sd_mm):
            raise InputError(
                f"A flame needs radius_mm above 0 and height_mm above the amplitude of its "
                f"flicker, got radius_mm={self.radius_mm}, height_mm={self.height_mm}."
            )


@strict
@dataclass(frozen=True)
class FlameTemplate:
    """Flames with random flicker of height, wrinkles, position and brightness.

    The height of a flame is its mean plus ``sqrt(2) height_sd_mm sin(phase)`` with a uniform phase:
    buoyant flicker seen at a random moment. In the paper the standard deviation hardly grows with
    the mean height, so the flicker is added, not scaled.

    Parameters
    ----------
    objects : list of FlameObject
        Flames at their mean heights.
    position_mm : float
        Largest displacement of a burner in both directions, uniform in y and x.
    sway : float
        Root mean square of the axis's displacement at the tip, relative to the radius.
    swelling : float
        Root mean square of the relative change of the radius at the tip.
    brightness : (float, float)
        Range of the brightest radiance, uniform, inside [0, 1].
    """

    objects: list[FlameObject]
    position_mm: float
    sway: float
    swelling: float
    brightness: Pair

    def __post_init__(self):
        ranges = {"position_mm": self.position_mm, "sway": self.sway, "swelling": self.swelling}
        _check_ranges(self.brightness, **ranges)

    def draw(self, rng: np.random.Generator | None) -> tuple[Scene, dict[str, np.ndarray]]:
        """Draw a scene; without a generator, smooth flames of mean height at full brightness.

        Returns
        -------
        Scene
        dict
            Arrays ``height_mm`` and ``brightness``, shape (objects,), and ``burner_mm``,
            (objects, 2).
        """
        n = len(self.objects)
        burners = np.array([o.burner_mm for o in self.objects], float)
        heights = np.array([o.height_mm for o in self.objects], float)
        brightness = np.ones(n)
        wrinkles: list[np.ndarray | None] = [None] * n
        if rng is not None:
            swing = np.sqrt(2) * np.array([o.height_sd_mm for o in self.objects])
            heights += swing * np.sin(rng.uniform(0, 2 * np.pi, n))
            burners += rng.uniform(-self.position_mm, self.position_mm, (n, 2))
            brightness = rng.uniform(*self.brightness, n)
            wrinkles = [draw_wrinkles(rng) for _ in range(n)]
        layers = [
            self._layer(*drawn)
            for drawn in zip(self.objects, burners, heights, brightness, wrinkles, strict=True)
        ]
        parameters = {"burner_mm": burners, "height_mm": heights, "brightness": brightness}
        return Scene(layers), parameters

    def _layer(
        self,
        flame: FlameObject,
        burner: np.ndarray,
        height: float,
        brightness: float,
        wrinkles: np.ndarray | None,
    ) -> Layer:
        texture = flame_texture(
            height, flame.radius_mm, wrinkles, self.sway * flame.radius_mm, self.swelling
        )
        size = (height, 2 * HALF_WIDTH * flame.radius_mm)
        centre = (burner[0] - height / 2, burner[1])
        return Layer(brightness * texture, flame.depth_mm, size, centre)


Template = ShapeTemplate | FlameTemplate
TEMPLATES: dict[str, type[Template]] = {"shapes": ShapeTemplate, "flames": FlameTemplate}


def _check_ranges(brightness: Pair, **spreads: float) -> None:
    for name, value in spreads.items():
        if not 0 <= value < np.inf:
            raise InputError(f"{name} must be 0 or above, and finite, got {value}.")
    if not 0 <= brightness[0] <= brightness[1] <= 1:
        raise InputError(f"brightness must be two increasing numbers in [0, 1], got {brightness}.")
