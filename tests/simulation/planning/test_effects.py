"""The claim of the effect plan: what it leaves out changes the image by no more than it says."""

import numpy as np
import pytest
from builders import camera

from lf_flame import InputError, Layer, PlenopticCamera, Scene, Sensor, plan_effects, render
from lf_flame.optics.sensor import STAGES
from lf_flame.simulation.planning.effects import EFFECTS, RAYS


def small(views=4, **changes):
    return PlenopticCamera(**{**camera(views, (10, 12)), **changes})


APERTURE_MM = small().aperture_mm

ROUNDING = 1e-6
"""Of float32 images, relative to the brightest pixel."""


def glow(depth=10.0, size=(1.6, 1.8), centre=(0.05, -0.1), cells=(8, 9), **matter):
    rng = np.random.default_rng(5)
    return Layer(rng.uniform(0.2, 1.0, cells), depth, size, centre, **matter)


def mound(depth):
    """A texture so smooth that it hardly blurs."""
    profile = np.hanning(402)[1:-1]
    return Layer(np.outer(profile, profile), depth, (40.0, 40.0))


def change(scene, camera, one, other, peak=min, **options):
    """Largest and root-mean-square change of the image, relative to its brightest pixel.

    That of the darker of both images, or by `max` of the brighter.
    """
    images = [
        render(scene, camera, effects=forced, seed=1, **options).views.astype(float)
        for forced in (one, other)
    ]
    difference = images[0] - images[1]
    brightest = peak(image.max() for image in images)
    return np.abs(difference).max() / brightest, np.sqrt(np.mean(difference**2)) / brightest


NEEDS = {
    "occlusion": (Scene([glow(20.0), Layer([[0.3]], -10.0, (0.8, 0.9), opaque=True)]), small()),
    "round_aperture": (Scene([glow()]), small(aperture_diameter_mm=APERTURE_MM)),
    "f_number_mismatch": (Scene([glow()]), small(aperture_diameter_mm=1.2 * APERTURE_MM)),
    "vignetting": (Scene([glow()]), small(rim_diameter_mm=80.0, rim_distance_mm=40.0)),
    "lenslet_rotation": (Scene([glow()]), small(lenslet_rotation_rad=0.02)),
    "shot_noise": (Scene([glow()]), small(sensor=Sensor(1000.0))),
}
"""A scene that calls for an effect."""

SPARES = {
    "defocus": (Scene([mound(0.3)]), small()),
    "occlusion": (
        Scene([glow(20.0), Layer([[0.3]], -10.0, (0.2, 0.2), (0.6, 5.5), opaque=True)]),
        small(lenslets=(10, 110)),
    ),
    "self_absorption": (Scene([glow(optical_thickness=1e-4)]), small()),
    "thickness": (Scene([glow(0.0, thickness_mm=1e-4)]), small()),
    "cos4": (Scene([glow()]), small(views=1, pixel_pitch_mm=1e-4, falloff_corrected=False)),
    "round_aperture": (Scene([glow()]), small()),
    "f_number_mismatch": (Scene([glow()]), small(aperture_diameter_mm=APERTURE_MM * (1 - 1e-6))),
    "vignetting": (Scene([glow()]), small(rim_diameter_mm=130.0, rim_distance_mm=40.0)),
    "lenslet_diffraction": (Scene([glow()]), small(wavelength_nm=0.3)),
    "main_lens_diffraction": (Scene([glow()]), small(wavelength_nm=0.1)),
    "lenslet_rotation": (Scene([glow()]), small(lenslet_rotation_rad=1e-6)),
    "lenslet_pitch_error": (Scene([glow()]), small(lenslet_pitch_error=1e-6)),
    "chromatic": (Scene([glow()]), small(chromatic_shift=1e-7)),
    "shot_noise": (Scene([glow()]), small(sensor=Sensor(1e9, full_well_e=1e10, bits=16))),
    "read_noise": (Scene([glow()]), small(sensor=Sensor(1e5, 1e6, read_noise_e=1.0))),
    "quantisation": (Scene([glow()]), small(sensor=Sensor(1e4, full_well_e=1e4, bits=16))),
    "saturation": (Scene([glow()]), small(sensor=Sensor(1e3))),
}
"""A scene that does not call for an effect: of its cause there is little."""

ABSENT = ("occlusion", "round_aperture", "vignetting", "saturation")
"""Effects that cannot be had in small amounts: their spare scenes do without."""


@pytest.mark.slow
@pytest.mark.parametrize("name", EFFECTS)
def test_a_scene_that_does_not_call_for_an_effect_does_not_get_it(name):
    scene, camera = SPARES[name]
    # Out of focus by so little that a bound of first order leaves it out, float32 shows nothing.
    planned = plan_effects(scene, camera, 0.01 if name == "defocus" else 1e-3)[name]
    assert not planned.kept
    quiet = {stage: False for stage in STAGES if stage != name}
    fixed = {"integrator": "rays", "rays": 60} if name == "lenslet_rotation" else {}
    on = name != "round_aperture"  # which has no diameter, and is then refused
    largest, rms = change(scene, camera, {**quiet, name: False}, {**quiet, name: on}, **fixed)
    if name in ABSENT:
        assert largest == planned.bound == 0
    else:
        found = rms if name.endswith("noise") else largest
        assert 0 < found <= planned.bound + ROUNDING


@pytest.mark.parametrize("depth", [3.0, 6.0, -4.0])
def test_a_strong_blur_is_bounded_by_how_far_its_rays_move(depth):
    """A quarter of the box on average, along each axis; a change of both is a third of the sum."""
    scene = Scene([glow(depth, (2.0, 2.0), cells=(20, 20))])
    found, _ = change(scene, small(), None, {"defocus": False})
    assert found <= plan_effects(scene, small())["defocus"].bound < 4.5 * found


@pytest.mark.parametrize("views", [2, 6])
def test_noise_scatters_less_the_more_pixels_there_are(views):
    """The standard deviation of n draws, by one over the root of 2 n, five times."""
    camera = small(views, falloff_corrected=True, sensor=Sensor(1e4, read_noise_e=20.0))
    planned = plan_effects(Scene([Layer([[1.0]], 0.0, (90.0, 90.0))]), camera)["read_noise"]
    pixels = np.prod([views, views, *camera.lenslets])
    scatter = planned.bound / (20.0 / 1e4) - 1
    assert scatter == pytest.approx(5 / np.sqrt(2 * pixels), abs=0.03)


def field(width_mm, *cells, depth=0.0, **matter):
    """Cells from left to right, as high as any field."""
    return Layer([cells], depth, (90.0, width_mm), **matter)


def pyramid(*size, depth=0.0, cells=801, **matter):
    """An even slope from the middle to all sides."""
    slope = 1 - np.abs(np.linspace(-1, 1, cells))
    return Layer(np.outer(slope, slope), depth, size, **matter)


def hole(side_mm, depth):
    """A dark cell amid bright ones."""
    cells = np.ones((5, 5))
    cells[2, 2] = 0.0
    return Layer(cells, depth, (5 * side_mm, 5 * side_mm))


WHITE, FEW = field(90.0, 1.0), {"lenslets": (5, 6)}
CARD = field(40.0, 0.3, 0.0, depth=-1.0, opaque=True, coverage=[[1.0, 0.0]])

# Scene, camera, and how many times as large as the change its bound may be. A defocus that comes
# near its bound stands above.
NEAR = {
    "occlusion": (Scene([field(40.0, 1.0, depth=20.0), CARD]), small(2, **FEW), 1.5),
    "self_absorption": (Scene([field(40.0, 1.0, optical_thickness=0.3)]), small(**FEW), 1.2),
    "thickness": (Scene([field(40.0, 0.0, 1.0, thickness_mm=2.0)]), small(**FEW), 2.2),
    "cos4": (Scene([WHITE]), small(falloff_corrected=False), 1.1),
    "round_aperture": (Scene([WHITE]), small(6, aperture_diameter_mm=APERTURE_MM, **FEW), 1.1),
    "f_number_mismatch": (
        Scene([WHITE]), small(3, aperture_diameter_mm=0.9 * APERTURE_MM, **FEW), 1.75
    ),
    "f_number_mismatch, wide": (
        Scene([WHITE]), small(1, aperture_diameter_mm=1.2 * APERTURE_MM, **FEW), 2.7
    ),
    "vignetting": (Scene([WHITE]), small(rim_diameter_mm=60.0, rim_distance_mm=40.0, **FEW), 1.15),
    "lenslet_diffraction": (Scene([hole(0.2, 10.0)]), small(3, wavelength_nm=200.0, **FEW), 1.6),
    "main_lens_diffraction": (
        Scene([hole(0.4, 0.0)]), small(lenslets=(5, 5), wavelength_nm=550.0), 2.5
    ),
    "lenslet_rotation": (Scene([pyramid(2.0, 40.0)]), small(lenslet_rotation_rad=1e-3), 2.0),
    "lenslet_pitch_error": (
        Scene([pyramid(40.0, 20.0)]), small(5, lenslets=(1, 100), lenslet_pitch_error=1e-3), 2.0
    ),
    "lenslet_pitch_error, without defocus": (
        Scene([field(40.0, 0.0, 1.0, depth=20.0)]),
        small(lenslets=(1, 40), lenslet_pitch_error=1e-3),
        2.0,
    ),
    "chromatic": (Scene([field(40.0, 0.0, 1.0)]), small(chromatic_shift=5e-3, **FEW), 2.2),
}  # fmt: skip
"""One in which an effect changes the image by nearly its bound."""


@pytest.mark.slow
@pytest.mark.parametrize("case", NEAR)
def test_what_is_left_out_changes_the_image_by_nearly_its_bound(case):
    scene, camera, times = NEAR[case]
    name = case.split(",")[0]
    others = {
        "round_aperture": {"f_number_mismatch": False},
        "f_number_mismatch": {"round_aperture": True},
        "f_number_mismatch, wide": {"round_aperture": True},
        "lenslet_pitch_error, without defocus": {"defocus": False},
    }.get(case, {})
    states = [others | {name: on} for on in (False, True)]
    fixed = {"integrator": "rays", "rays": 60} if name in RAYS else {}
    found, _ = change(scene, camera, *states, peak=max, tolerance=0.01, **fixed)
    assert found <= plan_effects(scene, camera, 0.01, others)[name].bound <= times * found


@pytest.mark.slow
def test_all_that_is_left_out_changes_the_image_by_no_more_than_all_bounds():
    matter = {"optical_thickness": 0.01, "thickness_mm": 0.01}
    layer = pyramid(40.0, 40.0, depth=0.2, cells=101, **matter)
    imperfect = {"chromatic_shift": 1e-4, "wavelength_nm": 0.3, "falloff_corrected": False}
    scene, camera = Scene([layer]), small(2, **imperfect, **FEW)
    effects = plan_effects(scene, camera, 0.4).effects
    bounds = {effect.name: effect.bound for effect in effects if effect.bound > 0}
    assert len(bounds) == 7
    assert not [effect.name for effect in effects if effect.kept]
    found, _ = change(scene, camera, None, dict.fromkeys(bounds, True), peak=max, tolerance=0.4)
    assert found <= sum(bounds.values()) <= 2 * found


def test_a_plan_reads_as_a_table():
    scene, camera = NEEDS["occlusion"][0], small(falloff_corrected=False)
    plan = plan_effects(scene, camera, effects={"cos4": True, "defocus": False})
    shown = str(plan)
    for name in EFFECTS:
        assert name in shown
    assert "kept, forced" in next(line for line in shown.splitlines() if line.startswith("cos4"))
    assert "left out, forced" in shown
    assert "1 opaque layer" in shown
    assert plan.integrator == "rays"
    assert "integrator: rays" in shown
    assert render(scene, camera, tolerance=0.05).plan.kept >= {"occlusion", "defocus"}


@pytest.mark.parametrize("name", [*RAYS, "occlusion"])
def test_the_exact_integrator_says_what_it_cannot_do(name):
    scene, camera = NEEDS[name]
    with pytest.raises(InputError, match=f"exact integrator cannot simulate .*{name} here"):
        render(scene, camera, integrator="exact")
    stops = ("round_aperture", "f_number_mismatch")
    off = {name: False} | (dict.fromkeys(stops, False) if name in stops else {})
    image = render(scene, camera, integrator="exact", effects=off)
    assert not image.plan.kept & set(off)


def test_rays_are_traced_on_request_although_no_effect_needs_them():
    scene, camera = Scene([Layer(np.eye(5), 20.0, (1.5, 1.5))]), small()
    exact, traced = render(scene, camera), render(scene, camera, integrator="rays", rays=2)
    assert (exact.plan.integrator, exact.plan.rays) == ("exact", None)
    assert (traced.plan.integrator, traced.plan.rays) == ("rays", 2)
    assert traced.plan.traced == ()
    assert np.abs(exact.views - traced.views).max() > 1e-4  # two rays differ from the integral
    assert plan_effects(scene, camera, integrator="rays").rays > 2


def test_noise_needs_a_seed():
    scene, camera = NEEDS["shot_noise"]
    with pytest.raises(InputError, match="read_noise and shot_noise need a seed"):
        render(scene, camera)
    images = [render(scene, camera, seed=s).views for s in (1, 1, 2)]
    np.testing.assert_array_equal(images[0], images[1])
    assert np.any(images[0] != images[2])


def test_matter_of_a_thick_layer_dims_what_stands_inside_it():
    """As a thin plane it stood behind all that is nearer than its middle."""
    card = Layer([[1.0]], -1e-3, (4.0, 4.0), opaque=True)
    smoke = Layer([[1e-3]], 0.0, (4.0, 4.0), optical_thickness=0.4, thickness_mm=0.01)
    leaning = Layer([[0.0]], 0.0, (4.0, 4.0), opaque=True, tilt_deg=(0.1, 0.0))
    matter = {"self_absorption": True, "occlusion": True}
    for scene in (Scene([card, smoke]), Scene([leaning, Layer([[1.0]], 0.0, (4.0, 4.0))])):
        planned = plan_effects(scene, small(), 0.05, matter)["thickness"]
        on, off = ({**matter, "thickness": thick} for thick in (True, False))
        largest, _ = change(scene, small(), on, off, tolerance=0.05, integrator="rays", rays=12)
        assert 0.1 < largest <= planned.bound


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "matter", "stops"),
    [
        ("self_absorption", {"optical_thickness": 0.25}, {}),
        ("vignetting", {}, {"rim_diameter_mm": 1.42 * APERTURE_MM}),
    ],
)
def test_light_through_neighbouring_lenslets_counts_in_bounds(name, matter, stops):
    """An aperture twice as wide as matched lights each pixel through several lenslets."""
    camera = small(1, lenslets=(6, 8), aperture_diameter_mm=2 * APERTURE_MM, **stops)
    scene = Scene([Layer(np.ones((1, 1)), 10.0, (40.0, 40.0), **matter)])
    states = [{name: on} for on in (False, True)]
    found, _ = change(scene, camera, *states, peak=max, integrator="rays", rays=12)
    assert 0.1 < found <= plan_effects(scene, camera)[name].bound <= 4 * found
