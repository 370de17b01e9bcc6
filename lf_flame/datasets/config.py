"""Configuration of a data set, read from a TOML file."""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np

from lf_flame._common.config import build, strict
from lf_flame._common.input_files import read_toml
from lf_flame.datasets.encodings import InputEncoding, block_of
from lf_flame.datasets.templates import TEMPLATES, Template
from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.scenes.scene import Scene
from lf_flame.simulation.planning.plan import EffectPlan, plan_effects

MOST_SAMPLES = 1_000_000
"""Maximum number of samples in a data set."""


@strict
@dataclass(frozen=True)
class DatasetConfig:
    """Configuration of a data set; `read_config` reads it from a TOML file.

    Parameters
    ----------
    kind : {"shapes", "flames"}
        Kind of the template.
    seed : int
        Seed; sample i is drawn from ``numpy.random.default_rng([seed, i])``.
    image : (int, int)
        Height and width of the targets; the lenslets must be a multiple of it.
    samples : dict
        Number of light fields for each preset.
    camera : PlenopticCamera
        Camera of the light fields.
    template : ShapeTemplate or FlameTemplate
        Objects and the ranges over which they vary.
    effects : dict of str to bool, optional
        Effects to force on (True) or off (False), by name.
    input : InputEncoding, optional
        Encoding of the network's input. Default: that of the paper.
    route : {"rays", "exact", "direct"}, optional
        Method for targets and inputs. "rays", the default: each light field is rendered with traced
        rays and refocused with shift-and-sum, as in the paper; "exact": the same, with the
        integrator that the effect plan chooses; "direct": directly from the scene where the plan
        allows, else as "exact".
    shuffled_depths : bool, optional
        Whether the objects of each sample are at the template's depths in random order, scaled so
        that the central view stays the same. Unless objects occlude others, the effect plan is that
        of the objects at their own depths.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.datasets import read_config
    >>> rng = np.random.default_rng([1, 7])  # sample 7 of seed 1
    >>> scene, _ = read_config("dataset.toml").draw(rng)
    >>> [layer.depth_mm for layer in scene.layers]
    [20.0, 10.0, 0.0, -10.0]
    """

    kind: Literal["shapes", "flames"]
    seed: int
    image: tuple[int, int]
    samples: dict[str, int]
    camera: PlenopticCamera
    template: Template
    effects: dict[str, bool] = field(default_factory=dict)
    input: InputEncoding = InputEncoding()
    route: Literal["rays", "exact", "direct"] = "rays"
    shuffled_depths: bool = False

    def __post_init__(self):
        lenslets = self.camera.lenslets
        sides = zip(lenslets, self.image, strict=True)
        if min(self.image) < 1 or any(n % m for n, m in sides):
            raise InputError(
                f"image must divide the camera's lenslets {lenslets} into whole numbers, got "
                f"{self.image}."
            )
        if self.camera.views < self.input.views_per_side:
            raise InputError(
                f"input {self.input.kind!r} needs {self.input.views_per_side} views along each "
                f"axis, the camera has {self.camera.views}."
            )
        counts = self.samples.values()
        if self.seed < 0 or not 1 <= min(counts, default=0) <= max(counts) <= MOST_SAMPLES:
            raise InputError(
                f"seed must be 0 or above and samples from 1 to {MOST_SAMPLES} for each preset, "
                f"got seed={self.seed}, samples={self.samples}."
            )

    def sample_count(self, preset: str) -> int:
        """Count the light fields of a preset."""
        if preset not in self.samples:
            raise InputError(f"preset must be one of {', '.join(self.samples)}, got {preset!r}.")
        return self.samples[preset]

    @cached_property
    def plan(self) -> EffectPlan:
        """Effect plan of the mean scene; see `plan_of` for that of a sample."""
        scene, _ = self.draw(None)
        return plan_effects(scene, self.camera, effects=self.effects)

    def plan_of(self, scene: Scene) -> EffectPlan:
        """Effect plan of a scene: its own if objects may occlude others, else that of all scenes.

        Objects that only add light need the same effects in all scenes.
        """
        if any(layer.opaque for layer in scene.layers):
            return plan_effects(scene, self.camera, effects=self.effects)
        return self.plan

    @property
    def block(self) -> tuple[int, int]:
        """Number of lenslets averaged into one pixel, along (t, s)."""
        return block_of(self.camera.lenslets, self.image)

    @property
    def depths_mm(self) -> list[float]:
        """Depths of the objects, in the order of the targets."""
        return [o.depth_mm for o in self.template.objects]

    def draw(self, rng: np.random.Generator | None) -> tuple[Scene, dict[str, np.ndarray]]:
        """Draw a scene; without a generator, the mean scene with all objects at their own depths.

        Returns
        -------
        Scene
            Scene that was drawn.
        dict
            Random values of the template; with shuffled depths also ``depth_mm``, (objects,).
        """
        scene, parameters = self.template.draw(rng)
        if not self.shuffled_depths:
            return scene, parameters
        depths = np.array(self.depths_mm)
        if rng is not None:
            depths = rng.permutation(depths)
            scene = scene.at_depths(depths, self.camera)
        return scene, {**parameters, "depth_mm": depths}

    def encode(self, light_field: LightField) -> np.ndarray:
        """Encode a light field for the network: float32, 0 to 1, (height, width, channels)."""
        return self.input.encode(light_field, self.image)


def read_config(path: str | Path) -> DatasetConfig:
    """Read a data-set configuration from a TOML file.

    Raises
    ------
    InputError
        If the file cannot be read, or has an unknown, missing or impossible value.

    Examples
    --------
    >>> from lf_flame.datasets import read_config
    >>> config = read_config("dataset.toml")
    >>> config.kind, config.image
    ('shapes', (24, 48))
    """
    values = read_toml(path)
    return config_from_json(values, path)


def config_from_json(values: dict, source: str | Path) -> DatasetConfig:
    """Build a configuration from parsed TOML, or from the JSON values stored with a data set."""
    if isinstance(values.get("input"), dict):
        values["input"].pop("image", None)  # null, in older data sets
    template = TEMPLATES.get(str(values.get("kind")))
    if template is not None and "template" in values:
        # First alone, by its kind, so that messages about it fit that kind.
        build(template, values["template"], f"{source}: template")
    return build(DatasetConfig, values, source)
