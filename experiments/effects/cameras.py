"""Cameras on which the effects are measured: the paper's and two that were sold."""

from dataclasses import replace

from lf_flame.optics.camera import PAPER_CAMERA, PlenopticCamera

LENSLETS = (20, 24)
"""Lenslet rows and columns that are recorded: a window in the middle of each array."""

CAMERAS = {
    "paper": replace(PAPER_CAMERA, lenslets=LENSLETS),
    # As they say of themselves in the metadata of their files (devices.mla.lensPitch and
    # .sensorOffset.z, devices.sensor.pixelPitch, devices.lens.focalLength), here of the sample
    # files of imageio, tests/test_lytro.py. Their hexagonal lenslets are taken as square ones;
    # focused on a hand's and on an arm's length.
    "Lytro F01": PlenopticCamera(
        main_lens_focal_mm=6.84,
        focus_distance_mm=150.0,
        lenslet_focal_mm=0.025,
        lenslet_pitch_mm=0.014,
        views=10,
        lenslets=LENSLETS,
        pixel_pitch_mm=0.0014,
    ),
    "Lytro Illum": PlenopticCamera(
        main_lens_focal_mm=24.2,
        focus_distance_mm=500.0,
        lenslet_focal_mm=0.037,
        lenslet_pitch_mm=0.020,
        views=14,
        lenslets=LENSLETS,
        pixel_pitch_mm=0.0014,
    ),
}
"""Cameras by name, without imperfections; each trial adds its own."""
