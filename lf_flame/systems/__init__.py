"""Refocusing systems that can be run side by side: a light field in, refocused images out."""
