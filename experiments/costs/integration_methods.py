"""Methods of integrating the light of a scene over the rays of each pixel."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from experiments.costs.rendering_scenes import Study
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.scenes.scene import Scene
from lf_flame.simulation.exact import integrate
from lf_flame.simulation.optical_pass import OpticalPass
from lf_flame.simulation.rays import trace
from lf_flame.simulation.slabs import slice_scene

PER_AXIS = (1, *(n * 2**k for k in range(9) for n in (2, 3)))
"""Rays per pixel and axis."""


@dataclass(frozen=True)
class Method:
    """A method of integration, from a study and a setting to an image.

    `per_pixel` gives the rays of a setting for each pixel; None where there are none. The share is
    that of a study's time: the slow ones need it to get anywhere. The error of a picture with edges
    falls as ``rays**-theory``; with the second exponent, if there is one, where a layer hides
    another.
    """

    label: str
    draw: Callable[[Study, float], np.ndarray]
    settings: Sequence[float] = (0,)
    per_pixel: Callable[[float], float] | None = None
    share: float = 0.0
    theory: float | None = None
    theory_hidden: float | None = None


def _backward(study: Study, per_axis: float, finite_width: bool) -> np.ndarray:
    image, optics = _blank(study.camera), OpticalPass(study.camera)
    trace(_planes(study.scene), optics, "views", per_axis, image, finite_width=finite_width)
    return image


def _exact(study: Study, _setting: float) -> np.ndarray:
    image = _blank(study.camera)
    integrate(_planes(study.scene), OpticalPass(study.camera), "views", image)
    return image


def _planes(scene: Scene) -> list:
    """Planes of a scene, front to back, each layer one."""
    return slice_scene(scene, {}, absorption=False, dimming={"occlusion"})


def _blank(camera: PlenopticCamera) -> np.ndarray:
    return np.zeros((camera.views, camera.views, *camera.lenslets), np.float32)


BACKWARD = partial(Method, settings=PER_AXIS, per_pixel=lambda n: n**2, share=0.5)

METHODS = {
    "midpoint": BACKWARD(
        "backward, midpoint rule", partial(_backward, finite_width=False), theory=1 / 2
    ),
    "thin": BACKWARD(
        "backward, finite-width rays", partial(_backward, finite_width=True), theory=1.0,
        theory_hidden=1 / 2,
    ),
    "exact": Method("exact integrator", _exact),
}  # fmt: skip
"""The methods of integration. Theory: n midpoints along an axis miss an edge by up to 1/n; boxes
miss it by the square of that, except for those in which two layers have an edge, one of n along an
axis."""
