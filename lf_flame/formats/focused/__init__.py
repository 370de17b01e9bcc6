"""Raw pictures of cameras with focused lenslets: calibration, virtual depth, views."""
