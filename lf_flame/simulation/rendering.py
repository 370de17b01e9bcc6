"""Rendering: a scene through a plenoptic camera into a light field.

The effect plan (`lf_flame.simulation.planning.plan`) says what is simulated and by which of two
integrators (`lf_flame.simulation.integration`, `lf_flame.simulation.rays`); both share one chain of
ray transfer. A pixel holds the mean radiance over its ray bundle: a uniform layer that fills the
field gives its own brightness in every pixel, before cos^4, stops and sensor. The mean is over the
true lenslet: one made larger by a pitch error collects more light, and the pixel is divided by its
area.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from lf_flame._common.input_files import check_memory
from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.optics.camera import ROW_SPACING, PlenopticCamera
from lf_flame.optics.ray_bundle import trace_stop
from lf_flame.optics.sensor import STAGES, expose
from lf_flame.scenes.scene import Scene
from lf_flame.simulation.diffraction import (
    blur_on_sensor,
    blur_planes,
    blur_whole_lenslets,
    tiled_sensor,
)
from lf_flame.simulation.integration import gather
from lf_flame.simulation.optical_pass import OpticalPass, as_views, optical_passes
from lf_flame.simulation.planning.plan import EffectPlan, plan_effects
from lf_flame.simulation.slabs import Plane, check_field, slice_scene

CROSSING = ("f_number_mismatch", "lenslet_rotation", "lenslet_pitch_error", "lenslet_diffraction")
"""Effects by which light leaves its own lenslet, which hexagonal arrays do not simulate."""


def render(
    scene: Scene,
    camera: PlenopticCamera,
    tolerance: float | None = None,
    integrator: str = "auto",
    rays: int | None = None,
    effects: Mapping[str, bool] | None = None,
    seed: int | Sequence[int] | None = None,
    layout: str = "views",
) -> LightField:
    """Simulate the light field that a camera records of a scene.

    Parameters
    ----------
    scene : Scene
        Layers to render.
    camera : PlenopticCamera
        Camera that records them.
    tolerance : float, optional
        Largest acceptable error: root mean square over the image, relative to its brightest pixel.
        Effects are left out, smallest bound first, while the sum of their bounds is within a
        quarter of it; the numbers of rays, slabs (depth steps of thick layers) and colours are
        chosen accordingly. Default: 1e-3, or a quarter of the noise of the camera's sensor, if that
        is more.
    integrator : {"auto", "exact", "rays"}, optional
        Method of integration: in closed form, or by rays. "auto" takes the closed form unless an
        effect needs rays: stops, a rotated array, layers that occlude or absorb.
    rays : int, optional
        Number of rays per pixel along each axis for the ray integrator. Default: by the tolerance.
        With a fixed number, diffraction by the lenslets takes light to be uniform over each pixel
        (over each of 4 x 4 parts of a pixel, if pixels do not fill the sensor).
    effects : mapping of str to bool, optional
        Effects to simulate (True) or leave out (False) regardless of their size, by name
        (`lf_flame.simulation.planning.effects.EFFECTS`).
    seed : int or sequence of int, optional
        Seed of the sensor's noise; required if the plan includes noise.
    layout : {"views", "raw"}, optional
        Whether the views or the raw image of the sensor are contiguous in memory. The other one is
        a NumPy view of the same pixels.

    Returns
    -------
    LightField
        ``views[v, u, t, s]``, float32, in the unit of the textures, with its ``plan``. Views that
        the stops cut, or that contain light of two lenslets, have weight 0, as in a decoded raw
        image.

    Raises
    ------
    InputError
        If a layer is outside the field of view or behind the lens, or if the tolerance, an effect
        or the integrator cannot be used.

    Examples
    --------
    >>> from lf_flame.scenes import read_scene
    >>> from lf_flame import render
    >>> scene, camera, effects = read_scene("scene.toml")
    >>> light_field = render(scene, camera, effects=effects)
    >>> light_field
    LightField(9 x 9 views of 20 x 30 pixels, grey)
    """
    plan = plan_effects(scene, camera, tolerance, effects, integrator=integrator, rays=rays)
    return render_plan(scene, camera, plan, seed, layout)


def render_plan(
    scene: Scene,
    camera: PlenopticCamera,
    plan: EffectPlan,
    seed: int | Sequence[int] | None = None,
    layout: str = "views",
) -> LightField:
    """Render with a given plan, for instance one plan for all scenes of a data set.

    The parameters are those of `render`; a plan made for another scene has to fit the number of
    layers.
    """
    if layout not in ("views", "raw"):
        raise InputError(f"layout must be views or raw, got {layout!r}.")
    check_memory(12 * camera.views**2 * math.prod(camera.lenslets), "The light field")
    noisy = plan.kept & {"shot_noise", "read_noise"} if camera.sensor else set()
    if noisy and seed is None:
        raise InputError(f"{' and '.join(sorted(noisy))} need a seed; give one, or force them off.")
    planes = planned_planes(scene, camera, plan)
    seen, layout_gathered = camera, layout
    if _diffracts(camera, plan, "lenslet"):
        seen, layout_gathered = tiled_sensor(camera, plan.parts), "raw"
    passes = optical_passes(seen, plan.kept, plan.traced, plan.colours)
    _check_hexagonal(seen, passes[0], plan)
    image = gather(planes, passes, layout_gathered, plan.rays)
    views = as_views(image, seen) if layout_gathered == "raw" else image
    if _diffracts(camera, plan, "main_lens") and _attenuates(planes):
        views = blur_whole_lenslets(views, camera)
    if seen is not camera:
        raw = blur_on_sensor(LightField.trusted(views).to_raw(), seen, camera)
        views = as_views(raw, camera)
    weights = whole_views(camera, list(passes[0].stops), passes[0].round_aperture)
    return _record(views, camera, plan, seed, layout, weights)


def _check_hexagonal(camera: PlenopticCamera, optics: OpticalPass, plan: EffectPlan) -> None:
    """Refuse what hexagonal arrays do not simulate: light that leaves its own lenslet."""
    if camera.layout == "hexagonal" and (
        optics.every_lenslet or _diffracts(camera, plan, "lenslet")
    ):
        wrong = [name for name in CROSSING if name in plan.kept]
        raise InputError(
            f"Light that leaves its own lenslet is not simulated for a hexagonal array: force "
            f"{', '.join(wrong)} off."
        )


def planned_planes(scene: Scene, camera: PlenopticCamera, plan: EffectPlan) -> list[Plane]:
    """Cut a scene into the planes that a plan calls for, nearest to the main lens first.

    Raises
    ------
    InputError
        If a layer lies outside the field, or the plan is for another number of layers.
    """
    if len(plan.slabs) != len(scene.layers):
        raise InputError(
            f"A plan for {len(plan.slabs)} layers does not fit a scene of {len(scene.layers)}."
        )
    planes = slice_scene(
        scene,
        dict(zip(scene.layers, plan.slabs, strict=True)),
        absorption="self_absorption" in plan.kept,
        attenuating=set(plan.traced),
    )
    check_field(scene, camera)
    if _diffracts(camera, plan, "main_lens") and not _attenuates(planes):
        planes = blur_planes(planes, camera)
    return planes


def _diffracts(camera: PlenopticCamera, plan: EffectPlan, lens: str) -> bool:
    return camera.wavelength_nm is not None and f"{lens}_diffraction" in plan.kept


def _attenuates(planes: list[Plane]) -> bool:
    """Whether any plane occludes or attenuates light from behind."""
    return any(plane.transmission is not None for plane in planes)


def _record(views, camera, plan: EffectPlan, seed, layout: str, weights) -> LightField:
    """Let the sensor expose, and lay the views out in memory."""
    stages = plan.kept & set(STAGES)
    if camera.sensor is not None and stages:
        # Exposed in the order of the views, so that noise does not depend on the layout.
        ordered = np.ascontiguousarray(views)
        views = expose(ordered, camera.sensor, stages, np.random.default_rng(seed))
    if layout == "raw":
        views = as_views(LightField.trusted(views).to_raw(), camera)
    else:
        views = np.ascontiguousarray(views)
    return LightField.trusted(views, plan, weights)


def whole_views(
    camera: PlenopticCamera, stops: list[tuple[float, float]], round_aperture: bool
) -> np.ndarray | None:
    """Weights of views behind stops: 1 for uncut ones of one lenslet, 0 for others.

    A view is used if its part of each stop lies entirely inside, seen through the centre of the
    array, and if no light of a neighbouring lenslet reaches it. If no view is whole, those that see
    most of the aperture are used. round_aperture: whether the first stop is the aperture.

    Returns float32 of shape (v, u), or None if all are used.
    """
    shares = np.ones((camera.views, camera.views))
    for distance_mm, radius_mm in stops:
        rows, columns = (trace_stop(camera, distance_mm, axis) for axis in (0, 1))
        middle = [n // 2 for n in camera.lenslets]
        places = [
            footprint.centres_mm[:, lenslet, None]
            + np.linspace(-0.5, 0.5, 48) * footprint.pixel_width_mm
            for footprint, lenslet in zip((rows, columns), middle, strict=True)
        ]
        y, x = places[0][:, None, :, None], places[1][None, :, None, :]
        inside = np.hypot(y, x) <= radius_mm * (1 + 1e-9)
        shares = np.minimum(shares, inside.mean(axis=(2, 3)))
    used = shares == 1
    if round_aperture:
        used &= _own_light(camera, stops[0][1])
    if not used.any():
        used = shares == shares.max()
    return None if used.all() else used.astype(np.float32)


def _own_light(camera: PlenopticCamera, radius_mm: float) -> np.ndarray:
    """Whether no light of a neighbouring lenslet reaches a view, through an aperture too wide."""
    own = np.ones((camera.views, camera.views), bool)
    from_middle = np.arange(camera.views) - (camera.views - 1) / 2
    # Centres and half the width of the views' parts of the aperture, on one side by symmetry.
    at, half = np.abs(from_middle) * camera.view_step_mm, camera.view_step_mm / 2
    period = camera.micro_image_pitch_mm / camera.pixel_mm * camera.view_step_mm
    neighbours: tuple[tuple[float, float], ...] = ((0.0, 1.0), (1.0, 0.0), (1.0, 1.0))
    if camera.layout == "hexagonal":
        neighbours = ((0.0, 1.0), (ROW_SPACING["hexagonal"], 0.5))
    for down, right in neighbours:
        y, x = (np.maximum(np.abs(by * period - at) - half, 0.0) for by in (down, right))
        own &= np.hypot(y[:, None], x) >= radius_mm * (1 - 1e-9)
    return own
