"""Light at its extremes: long sums, thick absorbers, brightness, darkness, threads and layouts.

Each test also runs a formula that suggests itself, `naive` here, and shows that it fails what
ours passes. A warning fails any test.
"""

import math
import os
import subprocess
import sys
from dataclasses import replace
from decimal import Decimal, localcontext
from pathlib import Path

import numpy as np
import pytest

from lf_flame import (
    PAPER_CAMERA,
    InputError,
    Layer,
    Scene,
    Sensor,
    plan_effects,
    render,
)
from lf_flame.simulation.exact import integrate
from lf_flame.simulation.optical_pass import OpticalPass
from lf_flame.simulation.rays import trace
from lf_flame.simulation.rendering import FEW_PORTIONS, render_plan
from lf_flame.simulation.slabs import slice_scene

UNIT32 = 2.0**-24
"""Unit roundoff of float32, in which images are stored."""

CAMERA = replace(PAPER_CAMERA, views=4, lenslets=(10, 12))
ONE_PIXEL = replace(CAMERA, views=1, lenslets=(1, 1))

RAYS = {"integrator": "rays", "rays": 5}
METHODS = pytest.mark.parametrize("method", [{}, RAYS], ids=["exact", "rays"])

WIDE = (300.0, 300.0)
"""Size of a layer that fills the field at all depths used here."""


def cells(rows=8, columns=9):
    return np.random.default_rng(5).uniform(0.2, 1.0, (rows, columns))


def glow(depth=10.0, brightness=1.0, **matter):
    return Layer(cells() * brightness, depth, (1.6, 1.8), (0.05, -0.1), **matter)


def card(depth=-20.0, brightness=1.0, opaque=True):
    return Layer(cells(3, 4) * brightness, depth, (0.8, 0.9), (0.1, 0.2), opaque=opaque)


def rendered(layers, camera=CAMERA, **options):
    return render(Scene(layers), camera, **options).views.astype(float)


def one_pixel(planes, method):
    """Value of a sensor with one pixel that looks at planes of light."""
    many = method == "rays" and len(planes) > FEW_PORTIONS  # as `render` chooses
    image = np.zeros((1, 1, 1, 1), np.float64 if many else np.float32)
    if method == "exact":
        integrate(planes, OpticalPass(ONE_PIXEL), "views", image)
    else:
        trace(planes, OpticalPass(ONE_PIXEL), "views", 1, image)
    return float(image[0, 0, 0, 0])


def as_planes(layer, slabs=1, dimming=()):
    return slice_scene(Scene([layer]), {layer: slabs}, absorption=True, dimming=set(dimming))


@pytest.mark.parametrize("method", ["exact", pytest.param("rays", marks=pytest.mark.slow)])
def test_many_slabs_in_one_pixel_keep_their_digits(method):
    """Naive: add the light of each slab to a float32 image."""
    slabs = 512
    flame = Layer([[0.1]], 5.0, WIDE, thickness_mm=2.0)
    naive = np.add.accumulate(np.full(slabs, 0.1 / slabs, np.float32))[-1]
    assert abs(naive / 0.1 - 1) > 10 * UNIT32
    assert abs(one_pixel(as_planes(flame, slabs), method) / 0.1 - 1) <= 2 * UNIT32


def test_many_colours_keep_their_digits():
    """Naive: add the light of each colour to a float32 image."""
    camera = replace(CAMERA, lenslets=(2, 3), chromatic_shift=1e-3)
    layers = [Layer([[0.02]], 5.0, (20.0, 20.0)), Layer([[0.1]], 6.0, WIDE)]
    colours = 64
    plan = plan_effects(Scene(layers), camera, effects={"chromatic": True})
    found = render_plan(Scene(layers), camera, replace(plan, colours=colours))
    naive = np.add.accumulate(np.full(colours, 0.12 / colours, np.float32))[-1]
    assert abs(naive / 0.12 - 1) > 10 * UNIT32
    assert np.abs(found.views.astype(float) / 0.12 - 1).max() <= 2 * UNIT32


THICKNESSES = [0.0, 1e-300, 1e-17, 1e-12, 1e-8, 1e-5, 0.3, 50.0, 1e4]


def exact_share(tau):
    """``(1 - exp(-tau)) / tau`` to 40 digits or more."""
    if tau < 1e-20:
        return Decimal(1)
    with localcontext(prec=60):
        return (1 - (-Decimal(tau)).exp()) / Decimal(tau)


@METHODS
def test_absorbers_of_any_thickness_before_a_bright_ground(method):
    """Its own light and that from behind, and both in cells of different thickness.

    Naive: ``(1 - exp(-tau)) / tau`` in float32. From 1e-8 down the flame gives no light at all.
    """
    taus = np.array(THICKNESSES)
    truth = np.array([float(exact_share(tau)) for tau in taus]) + 2 * np.exp(-taus)
    ground, on = Layer([[2.0]], 20.0, WIDE), {"self_absorption": True}
    for tau, expected in zip(taus, truth, strict=True):
        flame = Layer([[1.0]], 0.0, WIDE, optical_thickness=tau)
        image = rendered([flame, ground], effects=on, **method)
        np.testing.assert_allclose(image, expected, rtol=2 * UNIT32)
    # three lenslets to a cell: in the middle one every ray of a pixel meets the same cell
    camera = replace(CAMERA, lenslets=(9, 9))
    size = camera.field_mm(0.0)
    flame = Layer(np.ones((3, 3)), 0.0, size, optical_thickness=taus.reshape(3, 3))
    image = rendered([flame, ground], camera, effects=on, **method)[:, :, 1::3, 1::3]
    np.testing.assert_allclose(image, np.broadcast_to(truth.reshape(3, 3), image.shape), rtol=1e-6)
    single = taus.astype(np.float32)
    with np.errstate(invalid="ignore"):
        naive = (1 - np.exp(-single)) / single + 2 * np.exp(-single)
    assert not abs(naive[3] / truth[3] - 1) <= 1e3 * UNIT32
    assert np.isnan(naive[0])


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
    """The same plan, the same polygons or rays, and the same bits for a power of two.

    Naive: the change between two images as a float32 mean square: 0, or infinite.
    """
    scenes = [
        [glow(brightness=b, optical_thickness=0.2), card(brightness=b)] for b in (1.0, brightness)
    ]
    plain, other = (render(Scene(layers), camera, tolerance=0.1) for layers in scenes)
    assert other.plan.kept == plain.plan.kept
    assert other.plan.integrator == plain.plan.integrator
    assert plain.plan.integrator == ("exact" if camera is CAMERA else "rays")
    expected = plain.views.astype(float) * brightness
    if math.frexp(brightness)[0] == 0.5:
        np.testing.assert_array_equal(other.views, expected)
    else:  # float32 is rounded once, and after each axis of diffraction again
        np.testing.assert_allclose(other.views, expected, rtol=8 * UNIT32,
                                   atol=1e-6 * UNIT32 * expected.max())  # fmt: skip
    coarse, fine = (rendered(scenes[1], camera, **(RAYS | {"rays": n})) for n in (3, 5))
    assert np.abs(fine - coarse).max() > 1e-4 * fine.max()
    with np.errstate(over="ignore", under="ignore"):
        naive = np.mean(np.square((fine - coarse).astype(np.float32)))
    assert naive in (0, np.inf)


def test_light_beyond_float32_is_refused():
    with pytest.raises(InputError, match="at most 1e.36 for float32 images to hold it"):
        glow(brightness=1e39)
    assert np.all(
        np.isfinite(rendered([glow(brightness=1e36), card(brightness=1e36)], tolerance=0.1))
    )


BLACK = {
    "glow": [Layer(np.zeros((3, 4)), 5.0, (1.0, 1.0))],
    "before and behind": [
        Layer([[0.0]], 5.0, (1.0, 1.0), opaque=True),
        Layer([[0.0]], 15.0, (2.0, 2.0), optical_thickness=0.4, thickness_mm=2.0),
    ],
}


@pytest.mark.slow
@pytest.mark.parametrize("layers", BLACK.values(), ids=BLACK)
@pytest.mark.parametrize("options", [{}, RAYS], ids=str)
def test_darkness_stays_dark(layers, options):
    """Through all imperfections and a sensor without read noise.

    Naive: an effect matters if it changes the image by more than a part of the brightest pixel,
    as a quotient: 0 / 0. And shot noise that is normal with ``sqrt(mean + 1)``: it lights the dark.
    """
    sensor = Sensor(1e12, read_noise_e=0.0)
    for camera in (CAMERA, FULL, replace(FULL, chromatic_shift=0.01, sensor=sensor),
                   replace(CAMERA, lenslet_rotation_rad=0.01, sensor=sensor)):  # fmt: skip
        assert not np.any(rendered(layers, camera, seed=1, **options))
        plan = plan_effects(Scene(layers), camera)
        assert not plan.traced
        assert all(effect.bound == 0 for effect in plan.effects if effect.name != "quantisation")
    with np.errstate(invalid="ignore"):
        naive = np.float64(0.0) / np.float64(0.0)
    assert not naive <= 1e-3
    naive = np.sqrt(0 + 1) * np.random.default_rng(1).standard_normal(100)
    assert np.abs(naive).max() > 1


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
    """Naive: noise drawn pixel after pixel in the order of the memory."""
    camera, layers, options = SETUPS[name]
    views, raw = (
        render(Scene(layers), camera, seed=3, layout=layout, **options)
        for layout in ("views", "raw")
    )
    np.testing.assert_array_equal(views.views, raw.views)
    np.testing.assert_array_equal(views.to_raw(), raw.to_raw())
    assert raw.to_raw().base is not None  # contiguous as it is
    one, other = (image * 500.0 for image in (views.views.clip(0), raw.to_raw().clip(0)))
    naive = [np.random.default_rng(3).poisson(image) for image in (one, other)]
    assert np.any(naive[0].transpose(2, 0, 3, 1).reshape(other.shape) != naive[1])


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
def test_bits_are_the_same_for_one_to_eight_threads(rng):
    """Naive: each thread adds its rays to a float32 image of its own, or draws its own noise."""
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
    rays = rng.uniform(size=(640, 100)).astype(np.float32)
    naive = {
        sum(part.sum(axis=0) for part in np.array_split(rays, n)).tobytes() for n in range(1, 9)
    }
    assert len(naive) > 1
    noise = {
        b"".join(g.normal(size=640 // n).tobytes() for g in np.random.default_rng(3).spawn(n))
        for n in (1, 2, 4, 8)
    }
    assert len(noise) > 1
