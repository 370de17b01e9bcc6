"""Images in and out of focus, sums, absorbers, stops, noise, units, orders and threads."""

import math
from dataclasses import replace
from decimal import Decimal, localcontext
from fractions import Fraction

import numba
import numpy as np

from experiments.hard_cases.case import UNIT, UNIT32, Values, hard_case
from experiments.hard_cases.optics import ExactCamera, exact_footprint, exact_share
from lf_flame import InputError, Layer, PlenopticCamera, Scene, Sensor, render
from lf_flame._common.arrays import centred
from lf_flame.optics.camera import PAPER_CAMERA
from lf_flame.optics.ray_bundle import trace_footprint
from lf_flame.optics.sensor import expose
from lf_flame.simulation.exact import integrate
from lf_flame.simulation.optical_pass import OpticalPass
from lf_flame.simulation.rays import trace
from lf_flame.simulation.slabs import self_absorbed, slice_scene

CAMERA = replace(PAPER_CAMERA, views=4, lenslets=(10, 12))
ONE_PIXEL = replace(CAMERA, views=1, lenslets=(1, 1))

WIDE = (300.0, 300.0)
"""Size of a layer that fills the field at all depths used here."""


shares_below = np.frompyfunc(exact_share, 3, 1)


def cells(rows: int = 8, columns: int = 9, seed: int = 5) -> np.ndarray:
    """Draw a rough texture."""
    return np.random.default_rng(seed).uniform(0.2, 1.0, (rows, columns))


def rendered(layers, camera: PlenopticCamera = CAMERA, **options) -> np.ndarray:
    """Render layers by the package."""
    return render(Scene(layers), camera, **options).views.astype(float)


def exact_image(layer: Layer, camera: PlenopticCamera = CAMERA) -> np.ndarray:
    """Every cell of a layer weighed by its share of every bundle, in rational arithmetic."""
    shares = []
    for axis in (0, 1):
        centres, lenslet, pixel = exact_footprint(camera, layer.depth_mm, axis)
        count = layer.texture.shape[axis]
        size, centre = Fraction(layer.size_mm[axis]), Fraction(layer.centre_mm[axis])
        edges = [centre + size * Fraction(2 * k - count, 2 * count) for k in range(count + 1)]
        below = shares_below(np.array(edges) - centres[..., None], abs(lenslet), abs(pixel))
        shares.append(np.diff(below, axis=-1).astype(float))
    return np.einsum("vti,ij,usj->vuts", shares[0], layer.texture, shares[1], optimize=True)


def filling(texture, depth: float, part: float, camera: PlenopticCamera = CAMERA) -> Layer:
    """Make a layer as large as a part of all that the pixels see at a depth."""
    sizes = []
    for axis in (0, 1):
        centres, lenslet, pixel = exact_footprint(camera, depth, axis)
        sizes.append(part * float(np.ptp(centres) + abs(lenslet) + abs(pixel)))
    return Layer(texture, depth, tuple(sizes))


def planes(layer: Layer, slabs: int = 1, dimming=()) -> list:
    """Cut a layer into slabs that may dim what is behind them."""
    return slice_scene(Scene([layer]), {layer: slabs}, absorption=True, dimming=set(dimming))


@hard_case(
    "light in a lenslet whose edge the object's edge meets, shifted by 1e-13 mm",
    "floor of each ray's height",
    "weights by area",
    1e-11,
)
def on_the_edge() -> Values:
    unit, obvious, ours = CAMERA.field_mm(0.0)[0] / 10, [], []
    focused = CAMERA.object_to_array(0.0)[0]
    slopes = centred(64) * CAMERA.aperture_mm / CAMERA.focus_distance_mm / 64
    for shift in (-1e-13, 0.0, 1e-13):
        cell = Layer([[1.0]], 0.0, (2 * unit, 2 * unit), (shift, shift))
        height = focused[0] * (unit + shift) + focused[1] * slopes
        for options in ({}, {"integrator": "rays", "rays": 24}):
            ours.append(rendered([cell], **options)[:, :, 4, 5].mean())
            obvious.append(np.mean(np.floor(height / CAMERA.lenslet_pitch_mm) >= -1))
    return Values(np.ones(6), obvious, ours)


def at_the_middle(layer: Layer, camera: PlenopticCamera = CAMERA) -> np.ndarray:
    """Look up the cell on which each bundle is centred; 0 beside the layer."""
    index = []
    for axis in (0, 1):
        edges, centres = layer.cell_edges_mm(axis), exact_footprint(camera, layer.depth_mm, axis)[0]
        index.append(np.clip(np.searchsorted(edges, centres.astype(float)), 0, len(edges)))
    return np.pad(layer.texture, 1)[index[0][:, None, :, None], index[1][None, :, None, :]]


@hard_case(
    "a point of 1 nm, and cells finer than a bundle, of the brightest pixel",
    "cell at the bundle's middle",
    "exact integrals",
    4 * UNIT32,
)
def fine_cells() -> Values:
    layers = [
        Layer([[1.0]], 10.0, (1e-6, 1e-6), (0.01, 0.02)),
        Layer(cells(40, 40), 10.0, (1.0, 1.0)),
    ]
    exact = np.stack([exact_image(layer) for layer in layers])
    obvious = np.stack([at_the_middle(layer) for layer in layers])
    peaks = exact.max(axis=(1, 2, 3, 4), keepdims=True)
    return Values(exact, obvious, np.stack([rendered([layer]) for layer in layers]), peaks)


@hard_case(
    "focal plane whose image is 1.5e8 mm away, in its own image",
    "B = a0 + i0 (1 - a0/f)",
    "chain from the focal plane: B is 0",
    1e-6,
)
def far_image() -> Values:
    camera = replace(CAMERA, focus_distance_mm=150.0 * (1 + 1e-6))
    layer = filling(cells(4, 5), 0.0, 0.7, camera)
    exact = exact_image(layer, camera)
    f, a0, i0 = camera.main_lens_focal_mm, camera.focus_distance_mm, camera.image_distance_mm
    blur = (a0 + i0 * (1 - a0 / f)) / camera.lenslet_focal_mm * camera.pixel_mm
    centre = (float(blur * (1 - camera.views) / 2),) * 2  # of the first view
    obvious = exact.copy()
    obvious[0, 0] = exact_image(replace(layer, centre_mm=centre), camera)[0, 0]
    return Values(exact, obvious, rendered([layer], camera), exact.max())


@hard_case(
    "share of the light that a stop of 1 mm to 1 nm passes",
    "a ray passes with all of its breadth",
    "the part of its box that passes",
    1e-4,
    10,
)
def closed_stop() -> Values:
    exact, obvious, ours = [], [], []
    for diameter in (1.0, 1e-3, 1e-6):
        camera = replace(CAMERA, views=5, pixel_pitch_mm=None, aperture_diameter_mm=diameter)
        width = ExactCamera(camera).step * Fraction(camera.lenslet_pitch_mm) * camera.views
        exact.append(math.pi / 4 * diameter**2 / float(width) ** 2)
        places = centred(5 * 9) * camera.aperture_mm / (5 * 9)
        obvious.append(np.mean(np.hypot(*np.meshgrid(places, places)) <= diameter / 2))
        layer = filling([[1.0]], 10.0, 3.0, camera)
        ours.append(rendered([layer], camera, integrator="rays", rays=9)[:, :, 5, 6].mean())
    return Values(np.array(exact), obvious, ours)


@hard_case(
    "a scene in metres, of the brightest pixel",
    "defocus counts above 0.01 mm",
    "sizes compared with each other",
    4 * UNIT32,
)
def in_metres() -> Values:
    exact = exact_image(Layer(cells(), 10.0, (1.6, 1.8)))
    metres = replace(
        CAMERA,
        main_lens_focal_mm=0.15,
        focus_distance_mm=0.326,
        lenslet_focal_mm=0.4e-3,
        lenslet_pitch_mm=0.112e-3,
    )
    layer = Layer(cells(), 0.01, (1.6e-3, 1.8e-3))
    blurs = trace_footprint(metres, 0.01, 0).pixel_width_mm > 0.01
    obvious = rendered([layer], metres, effects={"defocus": bool(blurs)})
    return Values(exact, obvious, rendered([layer], metres), exact.max())


@hard_case(
    "light of two layers at one depth, of the brightest pixel",
    "a table by depth",
    "every layer",
    4 * UNIT32,
)
def one_depth() -> Values:
    layers = [Layer(cells(4, 4, seed=k), 7.0, (1.0, 1.0), (0.0, 0.1 * k)) for k in (1, 2)]
    exact = sum(exact_image(layer) for layer in layers)
    by_depth = {layer.depth_mm: layer for layer in layers}
    return Values(exact, rendered(list(by_depth.values())), rendered(layers), exact.max())


@hard_case(
    "a card before a flame, named last or first, of its brightness",
    "painted in the order of the list",
    "sorted by depth",
    4 * UNIT32,
)
def order_of_layers() -> Values:
    card, glow = Layer([[0.25]], -20.0, WIDE, opaque=True), Layer([[1.0]], 10.0, WIDE)
    obvious, ours = [], []
    for order in ([glow, card], [card, glow]):
        painted = 0.0
        for layer in order:
            value = float(layer.texture[0, 0])
            painted = value if layer.opaque else painted + value
        obvious.append(painted)
        ours.append(rendered(order)[0, 0, 5, 5])
    return Values(np.full(2, 0.25), obvious, ours)


@hard_case("20 million rays into one pixel", "float32 sum", "float64 sums", UNIT32)
def many_rays() -> Values:
    image = np.zeros((1, 1, 1, 1), np.float32)
    trace(planes(Layer([[0.1]], 5.0, WIDE)), OpticalPass(ONE_PIXEL), "views", 4472, image)
    rays = np.full(4472**2, 0.1, np.float32)
    obvious = np.add.accumulate(rays, out=rays)[-1] / rays.size
    return Values(0.1, obvious, image[0, 0, 0, 0])


def share_that_leaves(tau: float) -> float:
    """``(1 - exp(-tau)) / tau``, to more digits than there are."""
    if tau < 1e-20:
        return 1.0
    with localcontext(prec=60):
        return float((1 - (-Decimal(tau)).exp()) / Decimal(tau))


@hard_case(
    "light that leaves an absorber of optical thickness 0, 1e-17 ... 1e4",
    "(1 - exp(-tau))/tau",
    "expm1",
    4 * UNIT,
)
def thin_absorber() -> Values:
    taus = np.array([0.0, 1e-300, 1e-17, 1e-12, 1e-8, 1e-5, 0.3, 50.0, 1e4])
    exact = np.array([share_that_leaves(tau) for tau in taus])
    return Values(exact, (1 - np.exp(-taus)) / taus, self_absorbed(taus))


@hard_case(
    "light of flames of optical thickness 0.3 to 1e4 in 2 to 1000 slabs",
    "explicit steps",
    "Beer's law for each slab",
    8 * UNIT32,
)
def slabs_of_an_absorber() -> Values:
    exact, obvious, ours = [], [], []
    for tau in (0.3, 5.0, 50.0, 1e4):
        flame = Layer([[0.7]], 5.0, WIDE, optical_thickness=tau, thickness_mm=2.0)
        for slabs in (2, 8, 128, 1000):
            image, cut = (
                np.zeros((1, 1, 1, 1), np.float32),
                planes(flame, slabs, {"self_absorption"}),
            )
            trace(cut, OpticalPass(ONE_PIXEL), "views", 1, image)
            exact.append(0.7 * share_that_leaves(tau))
            obvious.append(0.7 / slabs * np.sum(np.exp(-tau / slabs * np.arange(slabs))))
            ours.append(image[0, 0, 0, 0])
    return Values(np.array(exact), obvious, ours)


@hard_case(
    "light of a transparent flame in 8 slabs",
    "widths between random ends of 8 strata",
    "slabs of one width",
    UNIT32,
)
def slabs_of_a_flame() -> Values:
    flame, image = Layer([[1.0]], 5.0, WIDE, thickness_mm=2.0), np.zeros((1, 1, 1, 1), np.float32)
    integrate(planes(flame, 8), OpticalPass(ONE_PIXEL), "views", image)
    ends = (np.arange(8) + np.random.default_rng(0).uniform(size=(4000, 8))) / 8
    obvious = np.diff(ends, prepend=0.0, axis=1).sum(axis=1).mean()
    return Values(1.0, obvious, image[0, 0, 0, 0])


@hard_case("light of brightness 1e39", "cast to float32", "refused", 0.0)
def beyond_float32() -> Values:
    try:
        ours = f"{rendered([Layer([[1e39]], 5.0, WIDE)]).max():g}"
    except InputError:
        ours = "refused"
    return Values("refused", f"{np.float64(1e39).astype(np.float32):g}", ours)


@hard_case(
    "fewest electrons of pixels between none and 1e9", "mean + sqrt(mean) z", "Poisson's law", 0.0
)
def fewest_electrons() -> Values:
    electrons = np.repeat([0.0, 1e-30, 1e-3, 1.0, 1e4, 1e9], 1000)
    rng = np.random.default_rng(2)
    obvious = electrons + np.sqrt(electrons) * rng.standard_normal(len(electrons))
    ours = expose(electrons, Sensor(1.0), {"shot_noise"}, np.random.default_rng(2))
    return Values(0.0, min(0.0, obvious.min()), ours.min(), scale=1.0)


@hard_case(
    "saturated pixels of two brightnesses",
    "scaled to the brightest",
    "cut at the full well",
    2 * UNIT32,
)
def saturated() -> Values:
    exact, obvious, ours = [], [], []
    for brightness in (1.0, 1e30):
        layer = Layer([[brightness, 10 * brightness]], 5.0, WIDE)
        for exposure in (1e5, 1e12):
            camera = replace(CAMERA, sensor=Sensor(exposure, full_well_e=1e4, read_noise_e=5.0))
            light = rendered([layer])
            exact.append(np.full(light.shape, 1e4 / exposure))
            obvious.append(exact[-1] * light / light.max())
            ours.append(rendered([layer], camera, seed=1))
    return Values(np.array(exact), np.array(obvious), np.array(ours))


@hard_case(
    "different images of one scene, by any number of threads",
    "a float32 image per thread, then added",
    "each pixel summed by one thread",
    0.0,
)
def threads() -> Values:
    rays = np.random.default_rng(0).uniform(size=(640, 100)).astype(np.float32)
    parts = {sum(x.sum(axis=0) for x in np.array_split(rays, n)).tobytes() for n in range(1, 9)}
    layers, images, before = [Layer(cells(), 10.0, (1.6, 1.8))], set(), numba.get_num_threads()
    for count in range(1, numba.config.NUMBA_NUM_THREADS + 1):
        numba.set_num_threads(count)
        images.add(rendered(layers, integrator="rays", rays=5).tobytes())
    numba.set_num_threads(before)
    return Values(1.0, len(parts), len(images))
