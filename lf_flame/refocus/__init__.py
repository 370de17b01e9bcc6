"""Refocusing: shift the sub-aperture views and average them.

Slopes are in lenslets per view step, positive = behind the focal plane (`lf_flame.optics.camera`):
``refocused[t, s] = mean over v, u of L[v, u, t + slope (v - vc), s + slope (u - uc)]``
with vc, uc the centre of the views (Ng et al. 2005; paper, equation 2). It is a true mean: a
constant light field keeps its value.

Names load on first use: refocusing needs Numba, searches and surfaces more of SciPy.
"""

import sys
import types

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


class _CallableModule(types.ModuleType):
    """A package that is also its main function: ``lf_flame.refocus(light_field, 1.0)``."""

    def __call__(self, *args, **options):
        """Refocus; see `lf_flame.refocus.refocus`."""
        return self.refocus(*args, **options)


sys.modules[__name__].__class__ = _CallableModule
