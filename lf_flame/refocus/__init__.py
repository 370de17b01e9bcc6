"""Refocusing: shift the sub-aperture views and average them.

Slopes are in lenslets per view step, positive = behind the focal plane (`lf_flame.camera`):
``refocused[t, s] = mean over v, u of L[v, u, t + slope (v - vc), s + slope (u - uc)]``
with vc, uc the middle of the views (Ng et al. 2005; paper, equation 2). It is a true mean: a
constant light field keeps its value.
"""

from lf_flame.refocus.fourier import fourier_refocus
from lf_flame.refocus.sharpness import SlopeSearch, find_sharpest_slope
from lf_flame.refocus.shift import shift_and_sum

__all__ = ["SlopeSearch", "find_sharpest_slope", "fourier_refocus", "shift_and_sum"]
