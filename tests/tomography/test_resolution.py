"""What can be resolved in depth, against rays by hand."""

import numpy as np
import pytest

from lf_flame import PAPER_CAMERA, PlenopticCamera
from lf_flame.tomography import depth_blur
from lf_flame.tomography.resolution import angular_width, finest_period


def test_the_angle_is_that_of_the_aperture():
    """15 pixels' images on the lens; the aperture that matches the lenslets is 77.8 mm wide."""
    aperture = 0.112 / 0.4 / (1 / 150 - 1 / 326)
    # The micro-image pitch is larger than the lenslets' by 0.4 mm / 277.84 mm.
    wanted = aperture * (1 + 0.4 * (1 / 150 - 1 / 326)) / 326
    assert angular_width(PAPER_CAMERA) == pytest.approx(wanted, rel=1e-12)


def test_the_blur_of_the_paper_camera():
    """The figures of the rule 1 / (k theta), from an aperture of 77.8 mm at 326 mm."""
    periods = np.array([0.26, 0.5, 1, 2, 5, 10])
    assert depth_blur(PAPER_CAMERA, periods) == pytest.approx(periods * 326 / 77.9, rel=2e-3)
    assert finest_period(PAPER_CAMERA) == pytest.approx(2 * 0.1314, rel=1e-3)


@pytest.mark.parametrize(("f_number", "blur"), [(4.0, 12.0), (16.0, 48.0)])
def test_a_stated_aperture_limits_the_angle(f_number, blur):
    """Detail of 0.5 mm at 600 mm, through 25 and 6.25 mm: 0.0417 and 0.0104 rad."""
    camera = PlenopticCamera(
        main_lens_focal_mm=100.0, focus_distance_mm=600.0, lenslet_focal_mm=0.48,
        lenslet_pitch_mm=0.12, views=9, lenslets=(20, 20), f_number=f_number,
    )  # fmt: skip
    assert angular_width(camera) == pytest.approx(100 / f_number / 600, rel=1e-12)
    assert depth_blur(camera, 0.5) == pytest.approx(blur, rel=1e-12)
