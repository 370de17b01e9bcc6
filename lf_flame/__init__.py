"""Plenoptic simulation, refocusing and learned refocusing of burner flames.

Packages, from the ground up: `optics`, `scenes`, `simulation`, `formats`, `refocus`, `calibration`,
`projection`, `tomography`, `flame_video`, `viewer`, `datasets`, `learning`, `systems`. They and
all public names load on first use, so that ``import lf_flame`` needs neither Numba nor Keras.

>>> import lf_flame
>>> camera = lf_flame.PAPER_CAMERA
>>> round(camera.depth_to_slope(10.0), 2)
1.17
"""

import lazy_loader

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
