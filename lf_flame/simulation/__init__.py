"""From a scene and a camera to a light field, with the effects that the scene calls for."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
