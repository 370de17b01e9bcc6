"""A data set that is made in a moment, for tests of what lies around it."""

DATA = {
    "kind": "shapes",
    "seed": 5,
    "image": [10, 16],
    "samples": {"smoke": 2},
    "camera": {
        "main_lens_focal_mm": 150.0,
        "focus_distance_mm": 326.0,
        "lenslet_focal_mm": 2.4,
        "lenslet_pitch_mm": 0.672,
        "views": 3,
        "lenslets": [10, 16],
    },
    "template": {
        "position_mm": 1.0,
        "size": 0.1,
        "brightness": [0.8, 1.0],
        "objects": [{"shape": "square", "depth_mm": 10, "size_mm": [4, 4], "centre_mm": [0, 0]}],
    },
}
