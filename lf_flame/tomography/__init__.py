"""From one light field to the light of each depth: resolution, operator, inversion, temperature.

What no light field of one camera can give is said by `lf_flame.tomography.resolution`.

Names load on first use: operator and fit need the extra ``lf_flame[tomography]``, not the rest.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
