"""Refocusing systems side by side."""
