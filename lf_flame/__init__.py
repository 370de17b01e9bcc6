"""Plenoptic simulation, refocusing and learned refocusing of burner flames.

Submodules and public names load on first use, so that ``import lf_flame`` needs neither Numba
nor Keras.
"""

import lazy_loader

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__all__ = [name for name in __all__ if name != "models"]  # `import *` must not need Keras
