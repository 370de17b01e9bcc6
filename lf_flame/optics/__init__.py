"""The camera: ray transfer matrices, ray bundles, sensor, diffraction, and what a slope is."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
