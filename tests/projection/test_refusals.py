"""What images straight from a scene cannot be, each in one sentence."""

import numpy as np
from builders import camera
from sentences import refusals

from lf_flame import Layer, PlenopticCamera, Scene, plan_effects
from lf_flame.projection import Projector

CAMERA = PlenopticCamera(**camera(5, (12, 18)))
GLOW = Layer([[1.0]], 8.0, (1.0, 1.0))
FAR = Layer([[1.0]], 0.0, (1.0, 1.0), (90.0, 0.0))
PLAN = plan_effects(Scene([GLOW]), CAMERA)


def projected():
    return Projector(Scene([GLOW]), CAMERA, PLAN)


test_it_is_refused_in_a_sentence = refusals(
    [
        (
            lambda: projected().refocus(0.0, "sinc"),
            "interpolation must be one of linear, ",
        ),
        (lambda: projected().refocus(0.0, block=(5, 3)), "Blocks of 5 x 3 lenslets do not divide"),
        (lambda: projected().refocus(0.0, weights=np.ones((3, 3))), "shape of the views, 5 x 5"),
        (lambda: projected().refocus([np.nan]), "slopes must be one or more finite numbers"),
        (lambda: projected().align_views(0.0, [(5, 0)]), r"There is no view \(5, 0\)"),
        (lambda: Projector(Scene([FAR]), CAMERA, PLAN), "lies outside the field"),
    ]
)
