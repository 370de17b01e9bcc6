"""Decisions on which effects of a scene are simulated, and how finely, before a pixel is made."""
