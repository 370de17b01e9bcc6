"""Emission by depth, axisymmetric flames and soot temperature, measured against own rays."""
