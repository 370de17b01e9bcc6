"""Refusals of optics, each in one sentence."""

from dataclasses import replace
from functools import partial

import numpy as np
from sentences import each, refusals

from lf_flame import PAPER_CAMERA
from lf_flame.optics.sensor import Sensor, expose
from lf_flame.optics.slope_conventions import to_slope

NAN, INF = np.nan, np.inf
RNG = np.random.default_rng(1)
ONES = np.ones((4, 4))
test_it_is_refused_in_a_sentence = refusals(
    [
        *each(
            partial(replace, PAPER_CAMERA),
            ({"main_lens_focal_mm": -150.0}, "main_lens_focal_mm must be a positive.*-150"),
            ({"lenslet_pitch_mm": NAN}, "lenslet_pitch_mm must be a positive"),
            ({"focus_distance_mm": 140.0}, "must exceed main_lens_focal_mm.*got 140"),
            ({"views": 0}, "views must be one whole number"),
            ({"views": 15.5}, "views must be one whole number"),
            ({"views": "9"}, "views must be one whole number .* got views='9'"),
            ({"main_lens_focal_mm": "150"}, "main_lens_focal_mm must be a positive.*'150'"),
            ({"lenslets": (270.5, 10)}, "lenslets two"),
            ({"lenslets": 270}, "lenslets two"),
            ({"views": 10**20}, "of 1 to 100000 each"),
            ({"lenslets": (0, 5)}, "lenslets two, of 1 to 100000"),
            ({"pixel_pitch_mm": 0.1}, "pixel_pitch_mm must be at most 0.0074"),
            ({"aperture_diameter_mm": 312.0}, "at most 311.* 4 times what matches .* got 312"),
            ({"chromatic_shift": -5e-4}, "chromatic_shift must lie between 0 and 0.2, got"),
            ({"lenslet_rotation_rad": 0.1005}, "lenslet_rotation_rad must lie between -0.1 and"),
            ({"lenslet_pitch_error": -0.1005}, "lenslet_pitch_error must lie between -0.1 and"),
        ),
        (partial(PAPER_CAMERA.depth_to_slope, -326.0), "above -326"),
        *each(
            PAPER_CAMERA.check_views,
            (((9, 9),), "15 x 15 views.* has 9 x 9"),
            (((15, 14),), "15 x 15 views.* has 15 x 14"),
        ),
        *each(
            PAPER_CAMERA.check_depths,
            *(
                (([0.0, depth],), r"above -326 mm .* up to 3.26e\+06 mm")
                for depth in (-326.0, -1e9, 1e9, 1e308, INF, NAN)
            ),
        ),
        *each(
            partial(Sensor, full_well_e=1e4),
            ({"exposure_e": 0.0}, "exposure_e must be 1e-12 to 1e\\+12 electrons, got 0.0"),
            ({"exposure_e": NAN}, "exposure_e must be"),
            ({"exposure_e": 1e3, "full_well_e": -1.0}, "full_well_e must be 1e-12 to.*got -1.0"),
            ({"exposure_e": 1e3, "full_well_e": INF}, "full_well_e must be.*got inf"),
            ({"exposure_e": 1e3, "read_noise_e": -0.1}, "read_noise_e must be 0 to.*got -0.1"),
            ({"exposure_e": 1e3, "bits": 0}, "bits must be a whole number from 1 to 16, got 0"),
            ({"exposure_e": 1e3, "bits": 17}, "bits must be.*got 17"),
            ({"exposure_e": 1e3, "bits": 9.5}, "bits must be.*got 9.5"),
        ),
        *each(
            expose,
            ((ONES, Sensor(1.0), {"blooming"}, RNG), "Unknown sensor stage 'blooming'; use"),
            ((ONES * NAN, Sensor(1.0), set(), RNG), "finite radiance, got 16 NaN"),
        ),
        *each(
            to_slope,
            ((1.0, "lytro"), "must be one of motion, hci.*got 'lytro'"),
            ((1.0, "lftoolbox"), "2 or more, got views=None"),
            ((1.0, "plenpy", 1), "2 or more, got views=1"),
            ((1.0, "plenopticam-refined", 2.5), "2 or more, got views=2.5"),
        ),
    ]
)
