"""The paper's network: a frozen ResNet-50 and its decoder, loaded on first use (Keras)."""

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from lf_flame.learning.decoder import build_decoder as build_decoder
    from lf_flame.learning.decoder import build_refocus_resnet50 as build_refocus_resnet50
else:
    NAMES = {"learning.decoder": ["build_decoder", "build_refocus_resnet50"]}
    __getattr__, __dir__, __all__ = lazy_loader.attach("lf_flame", None, NAMES)
