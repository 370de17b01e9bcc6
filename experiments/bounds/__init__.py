"""The bounds of the effect plan against images of random scenes, recorded."""
