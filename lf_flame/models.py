"""The paper's network: a frozen ResNet-50 and its decoder."""

from lf_flame.learning.decoder import build_decoder, build_refocus_resnet50

__all__ = ["build_decoder", "build_refocus_resnet50"]
