"""Flames in videos: height and contour of a flame in an image, and how it flickers."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
