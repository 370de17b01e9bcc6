"""Axisymmetric flames: the axis, the half section by Abel's integral, and tests of roundness."""
