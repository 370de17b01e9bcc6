"""Viewers for light fields with the same scripts: a local page, a single file, a notebook."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
