"""Refusals of the measures of flames and the steps of videos, each in one sentence."""

from functools import partial

import numpy as np
from sentences import refusals

from lf_flame.flame_video import find_flicker, find_steps, measure_flame

NAN, INF = np.nan, np.inf
FLAME = np.outer(np.hanning(60), np.hanning(80))
TWENTY = np.arange(20)

REFUSED = [
    (partial(measure_flame, np.ones((4, 4, 3))), "grey image"),
    (partial(measure_flame, np.ones((4, 4), complex)), "grey image"),
    (partial(measure_flame, np.ones((4, 9))), "5 x 5"),
    (partial(measure_flame, np.full((5, 5), NAN)), "finite"),
    *(
        (partial(measure_flame, FLAME, **{name: value}), f"{name} must")
        for name, values in {
            "level": (0.0, 1.0, NAN), "pixel_mm": (0.0, INF), "burner_row": (60.0, NAN)
        }.items()
        for value in values
    ),
    (partial(find_flicker, TWENTY, np.ones(19)), "two equal series"),
    (partial(find_flicker, np.ones((9, 2)), np.ones((9, 2))), "two equal series"),
    *(
        (partial(find_flicker, times, np.ones(20)), "increase")
        for times in (TWENTY[::-1], np.zeros(20), np.full(20, NAN), TWENTY * 1e-310)
    ),
    (partial(find_flicker, TWENTY * 1e305, np.ones(20)), "at most"),
    (partial(find_flicker, TWENTY, np.where(TWENTY < 15, 1, NAN)), "at least 16 frames .*, got 15"),
    *(
        (partial(find_flicker, TWENTY, np.ones(20), resolvable=value), "resolvable must be an amp")
        for value in (-1.0, NAN, INF)
    ),
    (partial(find_steps, "refocus@10mm"), "refocus@10mm needs the camera"),
    (
        partial(find_steps, "refocus@x"),
        r"at a depth, such as refocus@10mm, .* as refocus@0\.5, got 'x'",
    ),
    (partial(find_steps, "height,decode"), "decode only first, got 'height,decode'"),
    (partial(find_steps, "height,height"), "once, .*, got 'height,height'"),
    (partial(find_steps, "emission"), "needs the camera, and depths"),
    (partial(find_steps, "../height"), r"Steps must be among .*, got '\.\./height'"),
]  # fmt: skip

test_it_is_refused_in_a_sentence = refusals(REFUSED)
