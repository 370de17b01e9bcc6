"""Refocusing: shift the sub-aperture views and average them.

Slopes are in lenslets per view step, positive = behind the focal plane (`lf_flame.optics.camera`):
``refocused[t, s] = mean over v, u of L[v, u, t + slope (v - vc), s + slope (u - uc)]``
with vc, uc the middle of the views (Ng et al. 2005; paper, equation 2). It is a true mean: a
constant light field keeps its value.
"""

from lf_flame.refocus._arguments import farthest_slope
from lf_flame.refocus.alignment import align_views
from lf_flame.refocus.aperture import (
    annular_aperture,
    f_number_aperture,
    round_aperture,
    sparse_aperture,
)
from lf_flame.refocus.depth_from_focus import FocusMap, all_in_focus, depth_from_focus
from lf_flame.refocus.fourier import fourier_refocus, fourier_slice
from lf_flame.refocus.methods import refocus
from lf_flame.refocus.sharpness import SlopeSearch, find_sharpest_slope, find_sharpest_slopes
from lf_flame.refocus.shift import shift_and_sum
from lf_flame.refocus.surface import (
    planar_slopes,
    refocus_surface,
    region_slopes,
    tilted_plane,
)

__all__ = [
    "FocusMap",
    "SlopeSearch",
    "align_views",
    "all_in_focus",
    "annular_aperture",
    "depth_from_focus",
    "f_number_aperture",
    "farthest_slope",
    "find_sharpest_slope",
    "find_sharpest_slopes",
    "fourier_refocus",
    "fourier_slice",
    "planar_slopes",
    "refocus",
    "refocus_surface",
    "region_slopes",
    "round_aperture",
    "shift_and_sum",
    "sparse_aperture",
    "tilted_plane",
]
