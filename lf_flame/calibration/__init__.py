"""Calibration of a light-field camera in mm, from pictures of a flat target at known distances."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
