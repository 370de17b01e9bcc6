"""Light at its extremes: long sums, thick absorbers, brightness, darkness, threads and layouts.

More cases, each beside the formula that suggests itself, are in `experiments/hard_cases`. A warning
fails any test.
"""

import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lf_flame import PAPER_CAMERA, InputError, Layer, Scene, Sensor, plan_effects, render

UNIT32 = 2.0**-24
"""Unit roundoff of float32, in which images are stored."""

CAMERA = replace(PAPER_CAMERA, views=4, lenslets=(10, 12))
RAYS = {"integrator": "rays", "rays": 5}


def cells(rows=8, columns=9):
    return np.random.default_rng(5).uniform(0.2, 1.0, (rows, columns))


def glow(depth=10.0, brightness=1.0, **matter):
    return Layer(cells() * brightness, depth, (1.6, 1.8), (0.05, -0.1), **matter)


def card(depth=-20.0, brightness=1.0, opaque=True):
    return Layer(cells(3, 4) * brightness, depth, (0.8, 0.9), (0.1, 0.2), opaque=opaque)


def rendered(layers, camera=CAMERA, **options):
    return render(Scene(layers), camera, **options).views.astype(float)


FULL = replace(
    CAMERA,
    aperture_diameter_mm=76.0,
    rim_diameter_mm=80.0,
    rim_distance_mm=40.0,
    wavelength_nm=500.0,
    falloff_corrected=False,
    lenslet_pitch_error=1e-3,
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("camera", "brightness"), [(CAMERA, 1e30), (FULL, 2.0**-99)], ids=["plain", "full"]
)
def test_images_scale_with_the_brightness(camera, brightness):
    """The same plan, and the same bits for a power of two."""
    scenes = [
        [glow(brightness=b, optical_thickness=0.2), card(brightness=b)] for b in (1.0, brightness)
    ]
    plain, other = (render(Scene(layers), camera, tolerance=0.1) for layers in scenes)
    assert other.plan.kept == plain.plan.kept
    assert other.plan.integrator == plain.plan.integrator
    expected = plain.views.astype(float) * brightness
    if math.frexp(brightness)[0] == 0.5:
        np.testing.assert_array_equal(other.views, expected)
    else:  # float32 is rounded once, and after each axis of diffraction again
        np.testing.assert_allclose(other.views, expected, rtol=8 * UNIT32,
                                   atol=1e-6 * UNIT32 * expected.max())  # fmt: skip


def test_light_beyond_float32_is_refused():
    with pytest.raises(InputError, match="at most 1e.36"):
        glow(brightness=1e39)
    assert np.all(
        np.isfinite(rendered([glow(brightness=1e36), card(brightness=1e36)], tolerance=0.1))
    )


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, RAYS], ids=str)
def test_darkness_stays_dark(options):
    """Through all imperfections and a sensor without read noise: no 0 / 0, no noise."""
    layers = [
        Layer([[0.0]], 5.0, (1.0, 1.0), opaque=True),
        Layer([[0.0]], 15.0, (2.0, 2.0), optical_thickness=0.4, thickness_mm=2.0),
    ]
    sensor = Sensor(1e12, read_noise_e=0.0)
    for camera in (CAMERA, FULL, replace(FULL, chromatic_shift=0.01, sensor=sensor),
                   replace(CAMERA, lenslet_rotation_rad=0.01, sensor=sensor)):  # fmt: skip
        assert not np.any(rendered(layers, camera, seed=1, **options))
        plan = plan_effects(Scene(layers), camera)
        assert not plan.traced
        assert all(effect.bound == 0 for effect in plan.effects if effect.name != "quantisation")


SETUPS = {
    "exact": (CAMERA, [glow(), card(opaque=False)], {}),
    "rays": (CAMERA, [glow(), card(opaque=False)], RAYS),
    "occlusion": (CAMERA, [glow(), card()], RAYS),
    "rotated": (replace(CAMERA, lenslet_rotation_rad=0.02), [glow(), card(opaque=False)], RAYS),
    "full": (FULL, [glow(), card()], RAYS),
    "sensor": (replace(CAMERA, sensor=Sensor(500.0)), [glow(), card(opaque=False)], {}),
}


@pytest.mark.parametrize(
    "name",
    [
        "exact",
        "rays",
        "occlusion",
        "rotated",
        pytest.param("full", marks=pytest.mark.slow),
        "sensor",
    ],
)
def test_both_layouts_hold_the_same_bits(name):
    """Noise too is drawn pixel by pixel, not in the order of the memory."""
    camera, layers, options = SETUPS[name]
    views, raw = (
        render(Scene(layers), camera, seed=3, layout=layout, **options)
        for layout in ("views", "raw")
    )
    np.testing.assert_array_equal(views.views, raw.views)
    np.testing.assert_array_equal(views.to_raw(), raw.to_raw())
    assert raw.to_raw().base is not None  # contiguous as it is


THREADS = """
import hashlib, numba, test_light as light
for threads in (1, 2, 5, 8):
    numba.set_num_threads(threads)
    print(threads, *(
        hashlib.sha256(light.rendered(layers, camera, seed=3, **options).tobytes()).hexdigest()
        for camera, layers, options in light.SETUPS.values()
    ))
"""


@pytest.mark.slow
@pytest.mark.jit
def test_bits_are_the_same_for_one_to_eight_threads():
    run = subprocess.run(
        [sys.executable, "-c", THREADS],
        env={**os.environ, "NUMBA_NUM_THREADS": "8", "PYTHONPATH": str(Path(__file__).parent)},
        capture_output=True,
        text=True,
        check=True,
    )
    lines = [line.split() for line in run.stdout.splitlines()]
    assert [int(line[0]) for line in lines] == [1, 2, 5, 8]
    assert len({tuple(line[1:]) for line in lines}) == 1
    assert len(lines[0]) == 1 + len(SETUPS)
