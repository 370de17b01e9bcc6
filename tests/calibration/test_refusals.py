"""What calibration refuses, each in one sentence."""

from functools import cache

import numpy as np
from checkerboards import Bench
from sentences import each, refusals

from lf_flame import LightField
from lf_flame.calibration import CameraLaw, fit_targets, measure_target
from lf_flame.calibration.fit import Measurements, fit_law

BENCH, SMALL, ZERO = Bench(), Bench(lenslets=(30, 34)), 410.0


def fit(depths, sign=1, order=slice(None)):
    """Fit a law to what a thin lens shows of targets, at depths stated in another order or sign."""
    depths = np.array(depths)
    slopes, scales = BENCH.slope(depths + ZERO), BENCH.scale(depths + ZERO)
    errors = np.full(len(depths), 2e-4), np.full(len(depths), 3e-5)
    stated = sign * depths[order]
    shown = Measurements(stated, slopes, errors[0], scales, errors[1])
    return fit_law(shown, views=5, lenslets=(44, 52))


FIVE = [-30.0, -14.0, 0.0, 12.0, 30.0]


@cache
def numbers():
    law = vars(fit(FIVE).law)
    return {name: value for name, value in law.items() if name != "standard_deviations"}


def law(**changes):
    return CameraLaw(**{**numbers(), **changes})


def picture(distance, square, cut=slice(None), turned=False, **options):
    """Call that measures a picture of the bench, some of its rows of views, or turned round."""

    def call():
        views = BENCH.picture(distance, square, **options).views
        return measure_target(LightField((views.transpose(1, 0, 2, 3) if turned else views)[cut]))

    return call


def of_two_cameras():
    targets = [measure_target(one.picture(400.0, 4.0)) for one in (SMALL, BENCH)]
    return fit_targets([0.0, 1.0], targets, square_mm=4.0)


test_it_is_refused_in_a_sentence = refusals(
    [
        *each(
            fit,
            (([0.0, 10.0],), "3 or more different distances"),
            (([0.0, 10.0, 10.0],), "3 or more different distances"),
            (([0.0, 10.0, np.nan],), "3 or more different distances"),
            (([0.0, 1e-9, 2e-9],), "far apart|positive away|camera law|range"),
            ((FIVE, 1, [0, 3, 2, 1, 4]), "which picture was taken at which depth"),
            ((FIVE, -1), "positive away from the camera"),
        ),
        *each(
            law,
            ({"slope_mm": 5.0}, "slope_mm of opposite signs, .*, 5.0, "),
            ({"slope_at_infinity": 0.0}, "slope_mm of opposite signs, .* got 0.0, "),
            ({"scale": -1e-3}, "scale above 0, .*, -0.001, "),
            ({"depth_range_mm": (5.0, -5.0)}, r"depth_range_mm increasing, .*\(5.0, -5.0\)"),
            ({"depth_range_mm": (-500.0, 5.0)}, r"beyond centre_mm, got .*\(-500.0, 5.0\)"),
            ({"views": 0}, "views"),
            ({"distortion": np.nan}, "numbers of a law must be finite"),
            ({"aperture_diameter_mm": 0.0}, "aperture_diameter_mm"),
            ({"standard_deviations": {"aperture_diameter_mm": 12.5}}, "directly below .law."),
            ({"fall_off": ((1.0, 1.0), (1.0, 1.0))}, "fall_off"),
            ({"fall_off": ((0.0,) * 5,) * 5}, "fall_off"),
            ({"fall_off": ((np.nan,) * 5,) * 5}, "fall_off"),
            ({"fall_off": ((1.0,) * 5,) * 4 + ((1.0,),)}, "fall_off"),
        ),
        (of_two_cameras, "one camera"),
        *each(
            measure_target,
            ((LightField(np.random.default_rng(1).uniform(size=(5, 5, 40, 40))),), "3 x 3 corners"),
            ((LightField(np.ones((5, 5, 40, 40))),), "at least 3 x 3 corners"),
            ((LightField(np.ones((3, 3, 9, 9))),), "corners"),
        ),
        (picture(400.0, 22.0), "at least 3 x 3 corners in rows"),
        (picture(400.0, 6.5, dots=True), "check that it is a checkerboard"),
        (picture(400.0, 5.0, slice(1)), "needs 3 x 3 views or more"),
        (picture(430.0, 5.0, slice(None, None, -1)), "by row and column"),
        (picture(430.0, 5.0, turned=True), "by row and column"),
    ]
)
