"""What happens behind the lenses, through rendered images: diffraction and the sensor."""

import math

import numpy as np
import pytest
from builders import OPTICS

from lf_flame import Layer, PlenopticCamera, Scene, Sensor, render

F, A0, FOCAL, PITCH = OPTICS.values()
I0 = F * A0 / (A0 - F)


def spark(lenslets):
    """A cell on the focal plane that fills the square seen by the middle lenslet, and no other."""
    cells = np.zeros(lenslets)
    cells[lenslets[0] // 2, lenslets[1] // 2] = 1.0
    side = PITCH * A0 / I0
    return Scene([Layer(cells, 0.0, (lenslets[0] * side, lenslets[1] * side))])


@pytest.mark.slow
def test_the_main_lens_spreads_light_over_an_airy_disc():
    """First dark ring at 1.22 lambda N, 83.8 % of the light inside it, and none lost."""
    diameter, nm, lenslets = 0.16, 500.0, (81, 81)
    camera = PlenopticCamera(
        **OPTICS,
        views=3,
        lenslets=lenslets,
        aperture_diameter_mm=diameter,
        wavelength_nm=nm,
    )
    # As if all views were lit: what is looked at is the diffraction.
    only = {"round_aperture": False, "f_number_mismatch": False, "lenslet_diffraction": False}
    images = [
        render(spark(lenslets), camera, effects=only | {"main_lens_diffraction": on}).views
        for on in (True, False)
    ]
    blurred, sharp = (image[1, 1].astype(float) for image in images)
    assert np.count_nonzero(sharp) == 1
    ring = 1.22 * nm * 1e-6 * I0 / diameter / PITCH
    # Of Airy's light a share 2 / (pi^2 r) lies outside r spreads; here r = 40.5 / cos lenslets.
    outside = 2 / math.pi**2 / (40.5 / (ring / 1.22)) * np.sinc(1 / 4)
    assert blurred.sum() / sharp.sum() == pytest.approx(1 - outside, abs=1e-3)
    assert ring > 9
    y, x = np.indices(lenslets) - 40
    r = np.hypot(y, x)
    profile = [blurred[np.abs(r - k / 4) <= 0.5].mean() for k in range(4 * 14)]
    assert np.argmin(profile[: 4 * 13]) / 4 == pytest.approx(ring, abs=0.25)
    assert min(profile[: 4 * 13]) < 5e-3 * profile[0]
    assert blurred[r < ring].sum() == pytest.approx(0.838, abs=0.003)


EXPOSURE, READ = 4000.0, 12.0


def recorded(level, sensor, seed, **off):
    """Electrons that the numbers of a white field stand for, of all pixels."""
    camera = PlenopticCamera(
        **OPTICS,
        views=5,
        lenslets=(24, 30),
        sensor=sensor,
    )
    scene = Scene([Layer([[level]], 0.0, (60.0, 60.0))])
    forced = dict.fromkeys(("shot_noise", "read_noise", "saturation", "quantisation"), True) | off
    return render(scene, camera, effects=forced, seed=seed).views.astype(float).ravel() * EXPOSURE


def test_the_noise_is_cut_off_at_the_full_well():
    """Half the pixels clip where the mean is the well; far above it all do, without noise."""
    sensor = Sensor(EXPOSURE, full_well_e=2000.0, bits=12, read_noise_e=READ)
    at_well = recorded(0.5, sensor, 3, quantisation=False)
    sigma = math.hypot(math.sqrt(2000.0), READ)
    # Mean of min(x, well) of a normal law about the well: sigma / sqrt(2 pi) below it.
    assert at_well.mean() == pytest.approx(2000 - sigma / math.sqrt(2 * math.pi), abs=1.0)
    assert np.mean(at_well < 1999.99) == pytest.approx(0.5, abs=0.02)
    above = recorded(0.8, sensor, 4)
    np.testing.assert_allclose(above, 2000.0, rtol=1e-6)
