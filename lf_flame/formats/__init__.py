"""Reading light fields of other programs and cameras, and writing light fields for them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
