"""Refocused images directly from a scene, without a light field.

Where light only adds, the way from scene to image is linear and separable. A plane with cells of
radiance ``X`` gives view (v, u) as ``K[v] X K[u]'`` (`lf_flame.simulation.exact`); shift-and-sum
shifts and averages lines of K, and blocks average them again. A refocused image is therefore
``B X B'``, with ``B`` the mean over v of ``K[v]``, shifted by ``slope (v - vc)`` and averaged over
blocks. Both B are narrow bands, and no light field is formed.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
