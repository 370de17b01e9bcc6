"""A pass of light through the camera: the effects that are kept, one colour, one lenslet."""

from dataclasses import dataclass, field

import numpy as np

from lf_flame._common.arrays import centred
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.ray_bundle import Footprint, trace_footprint, trace_stop
from lf_flame.simulation.layouts import arrange
from lf_flame.simulation.ray_tables import FalloffTable


@dataclass(frozen=True)
class OpticalPass:
    """A camera as the kept effects leave it, for one colour and one neighbouring lenslet.

    Parameters
    ----------
    camera : PlenopticCamera
    focal_mm : float, optional
        Focal length of the main lens for the colour of this pass.
    share : float, optional
        Share of the light in this pass.
    defocus : bool, optional
        Whether a pixel's own width, hence a patch of the main lens, is integrated over.
    falloff : bool, optional
        Whether pixels dim by cos^4.
    lenslet_scale, lenslet_skew : float, optional
        Diagonal and other element of the lenslet grid's rotation and stretch.
    stops : tuple of (float, float), optional
        Distance in front of the main lens and radius of round stops, in mm.
    neighbour : (int, int), optional
        Light that comes through the lenslet this many rows and columns further on.
    """

    camera: PlenopticCamera
    focal_mm: float | None = None
    share: float = 1.0
    defocus: bool = True
    falloff: bool = False
    lenslet_scale: float = 1.0
    lenslet_skew: float = 0.0
    stops: tuple[tuple[float, float], ...] = ()
    neighbour: tuple[int, int] = field(default=(0, 0))

    def footprint(self, depth_mm: float, axis: int) -> Footprint:
        """Bundles of all pixels on a layer."""
        return trace_footprint(self.camera, depth_mm, axis, *self._grid(axis))

    def stop(self, distance_mm: float, axis: int) -> Footprint:
        """Bundles of all pixels on a stop."""
        return trace_stop(self.camera, distance_mm, axis, *self._grid(axis))

    def _grid(self, axis: int) -> tuple:
        return self.focal_mm, self.lenslet_scale, self.neighbour[axis]

    def skew_mm(self, axis: int) -> np.ndarray:
        """How far the rotated array moves each lenslet along `axis`, by its place on the other."""
        other = 1 - axis
        place = centred(self.camera.lenslets[other]) + self.neighbour[other]
        sign = 1 if axis == 0 else -1
        return sign * self.lenslet_skew * self.camera.lenslet_pitch_mm * place

    def squared_tangents(self, axis: int) -> np.ndarray:
        """Squared tangent of each pixel's central ray behind the main lens, shape (view, lenslet).

        The patch of the main lens that a pixel sees is `view_step_mm` wide; the light of the
        whole cone dims as that of its central ray, to second order in the cone's width.
        """
        camera = self.camera
        lenslet = centred(camera.lenslets[axis])[None, :] * camera.lenslet_pitch_mm
        patch = centred(camera.views)[:, None] * camera.view_step_mm
        # The patch is a sensor position, which the lenslet turns over.
        return ((lenslet + patch) / camera.image_distance_mm) ** 2

    def falloff_table(self, layout: str) -> FalloffTable | None:
        """Squared tangents in the order of an image, or None without cos^4."""
        if not self.falloff:
            return None
        return FalloffTable(*(arrange(self.squared_tangents(axis), layout) for axis in (0, 1)))
