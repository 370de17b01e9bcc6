"""Errors of slope maps, and of plain methods, on scenes whose slopes follow from geometry."""
