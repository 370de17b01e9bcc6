"""Effects by themselves and with others, against the reference tracer."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from experiments.effects.tracer import trace_pixels
from lf_flame import PAPER_CAMERA, Layer, PlenopticCamera, Scene, Sensor, render

BASE = replace(PAPER_CAMERA, views=5, lenslets=(12, 15))
MATCHED = BASE.image_distance_mm * 0.112 / 0.4
SHORT = replace(BASE, main_lens_focal_mm=20.0, focus_distance_mm=200.0, lenslets=(4, 100))
"""A lens so short that the ends of its array are seen at 15 degrees."""

TINY = replace(BASE, views=3, lenslets=(8, 10))
"""For scenes of many slabs or colours."""


def glow(depth=6.0, size=(1.4, 1.7), centre=(0.05, -0.05), cells=(5, 6), seed=5, **matter):
    """A coarse texture, whose cells and edges every effect moves."""
    rng = np.random.default_rng(seed)
    if matter.pop("sooty", False):
        matter["optical_thickness"] = rng.uniform(0, 1.5, cells)
    return Layer(rng.uniform(0.2, 1.0, cells), depth, size, centre, **matter)


def net(depth, size=(0.8, 1.0)):
    """An opaque layer with a hole, a veiled cell, and some light of its own."""
    return Layer(
        [[0.3, 0.0, 0.1], [0.0, 0.05, 0.2]], depth, size, (-0.05, 0.08), opaque=True,
        coverage=[[1.0, 0.0, 1.0], [1.0, 0.5, 1.0]],
    )  # fmt: skip


BROAD = glow(15.0, (9.0, 100.0), cells=(9, 60))
"""As broad as the field of the short lens."""

ROUND = {"aperture_diameter_mm": MATCHED}
WIDE = {"aperture_diameter_mm": 1.3 * MATCHED}
RIM = {"rim_diameter_mm": 62.0, "rim_distance_mm": 80.0}
TURNED = {"lenslet_rotation_rad": 0.024}
STRETCHED = {"lenslet_pitch_error": 0.02}
FALLOFF = {"falloff_corrected": False}
COLOUR = {"chromatic_shift": 0.02}


@dataclass(frozen=True)
class Case:
    """A scene, a camera, how it is rendered, and the error that may be left, of the peak."""

    layers: list
    changes: dict = field(default_factory=dict)
    camera: PlenopticCamera = BASE
    tolerance: float = 1e-3
    rays: int | None = 60
    allowed: float = 5e-4


# Stops, pitches and falloff alone have closed forms, in `test_absolute_stops`. Pairs only of
# effects that meet in the code; all come together in one test below.
CASES = {
    "defocus": Case([glow(10.0)], rays=None, allowed=1e-5),
    "occlusion": Case([glow(10.0), net(-5.0)], rays=None, allowed=1e-5),
    "absorption": Case([glow(10.0), glow(2.0, seed=6, sooty=True)], rays=None, allowed=1e-5),
    "thickness": Case([glow(1.0, thickness_mm=4.5)], tolerance=4e-3, rays=None),
    "thick absorption": Case(
        [glow(2.0, sooty=True, thickness_mm=1.5)], {}, TINY, 0.004, 60, allowed=2e-3
    ),
    "turned": Case([glow()], TURNED),
    "colour": Case([glow()], COLOUR, tolerance=4e-3, rays=None),
    "occlusion, round, rim": Case([glow(10.0), net(-5.0)], ROUND | RIM, rays=80),
    "occlusion, shrunk": Case(
        [glow(10.0), net(-5.0)], {"lenslet_pitch_error": -0.04}, rays=None, allowed=1e-5
    ),
    "thickness, occlusion inside": Case(
        [glow(2.0, thickness_mm=3.0), net(2.5)], {}, TINY, 0.03, 40, allowed=8e-3
    ),
    "falloff, turned, stretched": Case(
        [BROAD], FALLOFF | STRETCHED | {"lenslet_rotation_rad": 0.01}, SHORT
    ),
    "leaning, turned, stretched, wide": Case(
        [glow(2.0, (2.4, 2.7), tilt_deg=(40, 0))], TURNED | STRETCHED | WIDE, TINY, 4e-3, 32, 1e-2
    ),
    "turned, rim": Case([glow()], TURNED | RIM, TINY),
    "turned, stretched, wide": Case([glow()], TURNED | STRETCHED | WIDE),
}


def draw_pixels(camera, count, seed):
    """Pixels (v, u, t, s), a third of them in corners of micro-images."""
    rng, k = np.random.default_rng(seed), camera.views
    pixels = rng.integers(0, (k, k, *camera.lenslets), (count, 4))
    corners = count // 3
    pixels[:corners, :2] = rng.choice([0, k - 1], (corners, 2))
    return pixels


def rendered(scene, camera, case):
    options = {"integrator": "rays", "rays": case.rays} if case.rays else {}
    return render(scene, camera, case.tolerance, **options).views.astype(float)


def compared(case, count=12, rays=2**11):
    """Difference from the tracer in some pixels, its standard error, and the brightest pixel."""
    scene, camera = Scene(case.layers), replace(case.camera, **case.changes)
    pixels = draw_pixels(camera, count, seed=len(case.layers) + camera.views)
    traced, error = trace_pixels(scene, camera, pixels, rays=rays)
    image = rendered(scene, camera, case)
    return image[tuple(pixels.T)] - traced, error, image.max()


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_an_effect_is_right(name):
    case = CASES[name]
    difference, error, peak = compared(case)
    assert np.median(error) < 7e-4 * peak
    assert np.all(np.abs(difference) <= 5 * error + case.allowed * peak)


@pytest.mark.slow
def test_all_effects_at_once_are_right():
    everything = WIDE | RIM | TURNED | STRETCHED | FALLOFF | {"chromatic_shift": 1e-3}
    camera = replace(TINY, views=2, lenslets=(2, 3), **everything)
    layers = [glow(25.0), glow(4.0, seed=6, sooty=True, thickness_mm=0.02), net(-12.0)]
    pixels = np.argwhere(np.ones((2, 2, 2, 3)))
    traced, error = trace_pixels(Scene(layers), camera, pixels, rays=2**10)
    found = render(Scene(layers), camera, 0.8, "rays", 20)
    assert len(found.plan.kept) == 11
    image = found.views.ravel()
    assert np.sqrt(np.mean(error**2)) < 3e-3 * image.max()
    assert np.sqrt(np.mean((image - traced) ** 2)) <= 0.01 * image.max()


@pytest.mark.slow
def test_what_exceeds_the_full_well_is_cut_off_pixel_by_pixel():
    """Behind lenslets that overlap, where no single bundle would fill the well."""
    camera = replace(BASE, **WIDE)
    scene = Scene([glow()])
    pixels = draw_pixels(camera, 16, seed=3)
    traced, error = trace_pixels(scene, camera, pixels, rays=2**12)
    well = float(np.quantile(traced, 0.7))
    sensor = Sensor(1000.0, full_well_e=1000.0 * well)
    only = {"shot_noise": False, "read_noise": False, "quantisation": False, "saturation": True}
    image = render(scene, replace(camera, sensor=sensor), 1e-3, "rays", 60, only).views
    difference = image[tuple(pixels.T)] - np.minimum(traced, well)
    assert np.all(np.abs(difference) <= 5 * error + 5e-4 * image.max())
    assert (traced > well).sum() > 3
