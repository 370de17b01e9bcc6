"""Tomography: from one light field to the emission at each depth, with errors and temperature.

`lf_flame.tomography.resolution` shows what a light field of one camera cannot resolve.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
