"""The camera: ray transfer matrices, ray bundles, sensor, diffraction, and what a slope is."""
