"""From one light field to the light of each depth: resolution, operator, inversion.

What no light field of one camera can give is said by `lf_flame.tomography.resolution`. Needs the
extra ``lf_flame[tomography]``.
"""

from lf_flame.tomography.frequency_gram import FrequencyGram
from lf_flame.tomography.frustum_grid import FrustumGrid
from lf_flame.tomography.projection_operator import ProjectionOperator
from lf_flame.tomography.pyrometry import Temperatures, two_colour_temperature
from lf_flame.tomography.reconstruction import Reconstruction, reconstruct
from lf_flame.tomography.resolution import depth_blur, depth_modes, depth_singular_values

__all__ = [
    "FrequencyGram",
    "FrustumGrid",
    "ProjectionOperator",
    "Reconstruction",
    "Temperatures",
    "depth_blur",
    "depth_modes",
    "depth_singular_values",
    "reconstruct",
    "two_colour_temperature",
]
