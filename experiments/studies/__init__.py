"""Variants of data and training, side by side."""
