"""Refocusing systems that can be run side by side: a light field in, refocused images out."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
