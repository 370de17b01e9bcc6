"""What refocusing refuses, each in one sentence."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from sentences import refusals

from lf_flame import PAPER_CAMERA, Layer, LightField, Scene, render
from lf_flame.errors import InputError
from lf_flame.refocus import (
    align_views,
    all_in_focus,
    aperture_weights,
    find_sharpest_slope,
    fourier_refocus,
    fourier_slice,
    refocus,
    refocus_surface,
    region_slopes,
    round_aperture,
    shift_and_sum,
)

FLAT = np.ones((3, 3, 4, 5))
SQUARE = np.ones((3, 3, 4, 4))
WIDE = np.ones((3, 3, 12, 14))
NAN, INF = np.nan, np.inf
LEVEL = np.zeros((4, 5))

ALIGNMENT = [
    ({"view_indices": [(0, 3)]}, r"no view \(0, 3\) in a light field of 3 x 3 views"),
    ({"view_indices": [(0, -1)]}, r"no view \(0, -1\)"),
    ({"view_indices": []}, "pairs of row and column"),
    ({"view_indices": [(0.5, 1)]}, "pairs of row and column"),
    ({"block": (3, 3)}, "Blocks of 3 x 3 lenslets do not divide an image of 4 x 5"),
    ({"block": (0, 1)}, "Blocks of 0 x 1"),
    ({"slopes": NAN}, "slopes must be"),
]
APERTURES = [
    ({"shape": "star"}, "shape must be one of round, square, got 'star'"),
    ({"centre": (NAN, 0)}, "must be finite"),
    ({"width": "round"}, "width, ring and centre of an aperture must be real numbers, got"),
    ({"ring": 0.2j}, "must be real numbers, got"),
    ({"width": 0.1, "centre": (4, 0)}, "No view lies in an aperture of width 0.1 at 4, 0"),
]
WEIGHTS = [
    (np.ones((2, 3)), r"shape of the views, 3 x 3, got an array of shape \(2, 3\)"),
    (np.zeros((3, 3)), "at least one above 0"),
    (-np.eye(3), "0 or above"),
    (np.full((3, 3), NAN), "finite"),
    ("round", "^weights must be real numbers, got .*[.]$"),
    (np.ones((3, 3)) * 1j, "^weights must be real numbers, got .*[.]$"),
    ([[1], [1, 2]], "^weights must be real numbers, got .*[.]$"),
]
VIEWS = [
    (np.ones((3, 3, 4)), 1.0, r"views\[v, u, t, s\]"),
    (SQUARE * NAN, 1.0, "must be finite, got 144"),
    (np.ones((0, 3, 4, 4)), 1.0, "at least one element"),
    (SQUARE, [INF], "slopes must be one or more finite"),
    (SQUARE, [], "slopes must be one or more finite"),
]
METHODS = [
    ({"method": "magic"}, "one of auto, space, fourier, slice, got 'magic'"),
    ({"interpolation": "sinc", "method": "space"}, "'space' does not offer 'sinc'"),
    ({"interpolation": "linear", "method": "slice"}, "'slice' does not offer 'linear'"),
    ({"interpolation": "spline"}, "linear, nearest, cubic, sinc, got 'spline'"),
]
MAPS = [
    ([0, 1], {}, "three or more in equal steps"),
    ([0, 1, 3], {}, "three or more in equal steps"),
    ([0, 1, 2], {"window": 0.0}, "window must"),
]
SURFACES = [
    (FLAT, np.zeros((5, 4)), {}, "4 x 5 lenslets"),
    (FLAT, 1.0, {}, "4 x 5 lenslets"),
    (FLAT, LEVEL * NAN, {}, "finite, got 20 NaN"),
    (FLAT * NAN, LEVEL, {}, "finite, got 180 NaN"),
    (FLAT * np.float64(1e60), LEVEL, {}, "too large for float32"),
    (FLAT, LEVEL, {"interpolation": "sinc"}, "got 'sinc'"),
    (FLAT, LEVEL, {"weights": [1.0]}, "weights must"),
]
REGIONS = [
    ([((0, 9, 0, 5), 1.0)], {}, r"got \(0, 9, 0, 5\)"),
    ([], {"soften": -1.0}, "soften must"),
    ([], {"soften": INF}, "soften must .* got inf"),
    ([], {"background": INF}, "got 20 NaN or infinite slopes"),
]
MASKS = [
    (np.ones((2, 2, 2, 2)), r"valid must have the shape .* \(2, 2, 2, 3\), got .* \(2, 2, 2, 2\)"),
    (np.full((2, 2, 2, 3), 0.5), r"valid must be True \(1\)"),
    (np.full((2, 2, 2, 3), "yes"), r"valid must be True \(1\)"),
]


def searches_a_peak_that_still_rises():
    """A scene that is sharpest at 2.3, searched up to 1."""
    texture = np.random.default_rng(1).uniform(size=(5, 5))
    camera = replace(PAPER_CAMERA, views=5, lenslets=(40, 40))
    find_sharpest_slope(render(Scene([Layer(texture, 20.0, (2.0, 2.0))]), camera), RISING)


RISING = np.arange(0, 1.01, 0.1)


def searches_a_dark_corner(noise):
    """Nothing but noise beside a bright texture."""
    rng = np.random.default_rng(2)
    views = np.tile(rng.uniform(size=(96, 96)), (7, 7, 1, 1))
    views[..., :40] = 0
    lit = views + noise * rng.standard_normal(views.shape)
    find_sharpest_slope(lit, region=(10, 40, 2, 20))


REFUSED = [
    *(
        (partial(align_views, FLAT, **{"slopes": 0.5, "view_indices": [(1, 1)], **options}), said)
        for options, said in ALIGNMENT
    ),
    *(
        (partial(round_aperture, (3, 3), width), "finite width above 0")
        for width in (0.0, -1.0, INF, NAN)
    ),
    (partial(aperture_weights, (3, 3), 0.5, 0.7), "below its outer width"),
    *((partial(aperture_weights, (5, 5), **options), said) for options, said in APERTURES),
    *(
        (partial(make, WIDE, [0.0, 0.5, 1.0], weights=weights), said)
        for weights, said in WEIGHTS
        for make in (refocus, shift_and_sum, fourier_refocus, all_in_focus)
    ),
    *(
        (partial(make, views, slopes), said)
        for views, slopes, said in VIEWS
        for make in (shift_and_sum, fourier_refocus)
    ),
    (
        partial(shift_and_sum, SQUARE, 0, interpolation="sinc"),
        "one of linear, nearest, cubic, got 'sinc'",
    ),
    *((partial(refocus, SQUARE, 1, **options), said) for options, said in METHODS),
    (partial(fourier_refocus, SQUARE, 1, edges="mirror"), "wrap, clamp, got 'mirror'"),
    (partial(fourier_slice, SQUARE, 1, edges="mirror"), "wrap, clamp, got 'mirror'"),
    (partial(fourier_slice, SQUARE, 1, width=3), r"one of \(2, 4, 6, 8\) samples, got 3"),
    (
        partial(fourier_slice, SQUARE, 50.0, edges="clamp"),
        "one image size at most, .*up to 50 for 4 x 4",
    ),
    (partial(fourier_slice, SQUARE * NAN, 1.0), "must be finite, got 144"),
    (partial(fourier_refocus, SQUARE * INF, 1.0), "must be finite, got 144"),
    (
        partial(find_sharpest_slope, WIDE, region=(0, 4, 0, 15)),
        "region must be .* inside the 12 x 14",
    ),
    (partial(find_sharpest_slope, WIDE, region=(0, 4)), "region must be"),
    (
        partial(find_sharpest_slope, np.ones((5, 5, 40, 50)), [-1e307, 0, 1e307]),
        r"within -20 to 20, .* more than the image, got -[\d.e+]",
    ),
    (partial(find_sharpest_slope, SQUARE * NAN), "must be finite, got 144"),
    (searches_a_peak_that_still_rises, "a slope beyond 1, the end at which the views agree"),
    (partial(searches_a_dark_corner, 0.3), r"too little texture or light.* \(noise by 2.0%\)"),
    (partial(searches_a_dark_corner, 1e-4), "texture or light, a squared gradient .*e-0"),
    (partial(find_sharpest_slope, WIDE, region=(0, 50, 0, 10)), "region must be"),
    (partial(find_sharpest_slope, WIDE, [0, 1, 3]), "equal steps"),
    *((partial(all_in_focus, WIDE, slopes, **options), said) for slopes, options, said in MAPS),
    (partial(all_in_focus, SQUARE * NAN, [0, 1, 2]), "must be finite"),
    (partial(all_in_focus, SQUARE, [0, 1, 2], interpolation="s"), "got 's'"),
    *(
        (partial(refocus_surface, views, slopes, **options), said)
        for views, slopes, options, said in SURFACES
    ),
    *(
        (partial(region_slopes, (4, 5), regions, **{"background": 0.0, **options}), said)
        for regions, options, said in REGIONS
    ),
    *((partial(LightField, np.ones((2, 2, 2, 3)), valid=mask), said) for mask, said in MASKS),
]


test_it_is_refused_in_a_sentence = refusals(REFUSED)


@pytest.mark.jit  # 0 times infinity, which shows it, is a warning in plain Python
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", [(0, 0, 0, 0), (2, 3, 7, 8), (1, 0, 4, 0)])
def test_a_single_pixel_that_is_not_finite_is_found(place, value, dtype):
    """Even one that no shift brings into the image."""
    views = np.ones((3, 4, 8, 9), dtype)
    views[place] = value
    for slope in (-2.0, 0.0, 2.5):
        with pytest.raises(InputError, match="must be finite, got 1 NaN or infinite"):
            shift_and_sum(views, slope)
