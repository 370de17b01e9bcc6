"""Scene files written by hand: TOML with layers, and a camera if it is not the paper's."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from lf_flame._common.config import build, strict
from lf_flame._common.images import read_pixels, read_shape, to_unit
from lf_flame._common.input_files import check_memory, read_record, read_toml
from lf_flame.errors import InputError
from lf_flame.optics.camera import PAPER_CAMERA, PlenopticCamera
from lf_flame.scenes.flames import HALF_WIDTH, flame_texture
from lf_flame.scenes.scene import Layer, Scene
from lf_flame.scenes.shapes import shape_texture

PIXEL_BYTES, VALUE_BYTES = 36, 14
"""Bytes of memory that a layer takes for a pixel of an image and for each value of a pixel, while
it is made: for copies of the image, for radiance, coverage and absorption."""


@strict
@dataclass(frozen=True)
class LayerEntry:
    """One ``[[layers]]`` entry of a scene file: the fields of `Layer`, with a shape or an image.

    The colours of an image are averaged to grey, transparent pixels darken, and 8-bit and 16-bit
    values are scaled to [0, 1]; its path is relative to the scene file. The brightness is the
    radiance of white. The optical thickness is that of the brightest cell; in others it is
    proportional to their light, because soot that glows also absorbs.
    """

    depth_mm: float
    size_mm: tuple[float, float]
    centre_mm: tuple[float, float] = (0.0, 0.0)
    shape: Literal["rectangle", "square", "circle", "triangle", "flame"] | None = None
    image: str | None = None
    brightness: float = 1.0
    opaque: bool = False
    optical_thickness: float = 0.0
    thickness_mm: float = 0.0
    tilt_deg: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self):
        if (self.shape is None) == (self.image is None):
            raise InputError(
                f"a layer needs a shape or an image, got shape={self.shape!r}, image={self.image!r}"
            )
        if (path := Path(self.image or "")).is_absolute() or ".." in path.parts:
            raise InputError(f"image must lie in the scene file's folder, got {self.image!r}.")
        if not self.brightness >= 0:
            raise InputError(f"brightness must be 0 or above, got {self.brightness}.")

    def memory(self, folder: Path) -> int:
        """Count the bytes needed to make the layer, from the header of its image file."""
        if self.image is None:
            return 0
        rows, columns, channels = read_shape(folder / self.image)
        return rows * columns * (PIXEL_BYTES + VALUE_BYTES * channels)

    def layer(self, folder: Path) -> Layer:
        """Make the layer; its image file is relative to `folder`."""
        if self.image is not None:
            texture, coverage = _read_grey(folder / self.image)
        elif self.shape == "flame":
            texture = flame_texture(self.size_mm[0], self.size_mm[1] / (2 * HALF_WIDTH))
            coverage = np.minimum(texture / 1e-3, 1.0)  # its glow falls off, and never ends
        else:
            coverage = shape_texture(str(self.shape), self.size_mm)
            texture = coverage.copy()
        soot: np.ndarray | float = 0.0
        if self.optical_thickness:
            soot = self.optical_thickness * texture / max(texture.max(), 1e-300)
        return Layer(
            np.multiply(texture, self.brightness, out=texture),
            self.depth_mm,
            self.size_mm,
            self.centre_mm,
            opaque=self.opaque,
            coverage=coverage if self.opaque else None,
            optical_thickness=soot,
            thickness_mm=self.thickness_mm,
            tilt_deg=self.tilt_deg,
        )


@strict
@dataclass(frozen=True)
class SceneFile:
    """Content of a whole scene file; effects are forced on or off by name."""

    layers: list[LayerEntry]
    camera: PlenopticCamera = PAPER_CAMERA
    effects: dict[str, bool] = field(default_factory=dict)


def read_scene(path: str | Path) -> tuple[Scene, PlenopticCamera, dict[str, bool]]:
    """Read a scene, its camera and its effects from a TOML file.

    The file has a table ``[camera]`` and tables ``[[layers]]``. The effects are those that it
    forces on (True) or off (False), by name.

    Raises
    ------
    InputError
        If the file cannot be read, or a value in it cannot be used.

    Examples
    --------
    >>> from lf_flame.scenes import read_scene
    >>> scene, camera, effects = read_scene("scene.toml")
    >>> len(scene.layers), camera.views
    (1, 9)
    """
    entries = build(SceneFile, read_toml(path), path)
    _check_aperture(entries.camera, path)
    layers: list[Layer] = []
    need = 0
    for number, entry in enumerate(entries.layers, 1):
        try:
            need += entry.memory(Path(path).parent)
            check_memory(need, "what the scene shows up to here")
            layers.append(entry.layer(Path(path).parent))
        except InputError as error:
            raise InputError(f"{path}: layer {number}: {error}") from None
    return Scene(layers), entries.camera, entries.effects


def read_camera(path: str | Path) -> PlenopticCamera:
    """Read a camera from the ``[camera]`` table of a TOML file, or from a simulation's record.

    Raises
    ------
    InputError
        If the file cannot be read, has no camera, a value cannot be used, or no lens has such an
        aperture.

    Examples
    --------
    >>> from lf_flame.scenes import read_camera
    >>> read_camera("scene.toml").views
    9
    """
    values = read_record(path) if Path(path).suffix == ".json" else read_toml(path)
    if "law" in values and "camera" not in values:
        raise InputError(
            f"{path} is a measured calibration; this needs the lens's data, a table [camera], "
            f"which `lf-flame calibrate --lenslet-mm` writes as camera.toml."
        )
    if "camera" not in values:
        raise InputError(f"{path} has no camera: it must contain a table of that name.")
    camera = build(PlenopticCamera, values["camera"], f"{path}: camera")
    _check_aperture(camera, path)
    return camera


def _check_aperture(camera: PlenopticCamera, path: str | Path) -> None:
    """Refuse a camera that no lens can have, such as one with a length that is not in mm."""
    width_mm = camera.aperture_diameter_mm or camera.aperture_mm
    f_number = camera.main_lens_focal_mm / width_mm
    if f_number < 0.5:  # the fastest lens in air, by Abbe's sine condition
        which = "as stated" if camera.aperture_diameter_mm else "which matches the lenslets"
        raise InputError(
            f"{path}: camera: an aperture of {width_mm:.4g} mm, {which}, is f/{f_number:.2g}, and "
            f"no lens is faster than f/0.5; all lengths are in mm."
        )


def _read_grey(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Radiance of an image's pixels, and their coverage: transparent 0."""
    image = np.atleast_3d(to_unit(read_pixels(path), path)).astype(np.float64)
    if image.ndim > 3 or image.shape[2] > 4:  # pages, for example
        raise InputError(f"{path} must be one image, got an array of shape {image.shape}.")
    if image.shape[2] not in (2, 4):
        return image.mean(axis=2), np.ones(image.shape[:2])
    alpha = image[..., -1]
    return (image[..., :-1] * alpha[..., None]).mean(axis=2), alpha
