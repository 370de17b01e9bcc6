"""Decisions of an effect plan: which effects are simulated, how finely, and by what method.

All effects that are left out may change the image, together, by at most a quarter of the tolerance.
The rest is divided among the numbers that are finite: slabs of thick layers, colours of a chromatic
lens, parts of pixels for diffraction, and rays. Each is doubled until some chosen pixels change by
less than its share.
"""

import math
from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from lf_flame.errors import InputError
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.scenes.scene import Scene
from lf_flame.simulation.planning.chosen_pixels import FEWEST_RAYS, ChosenPixels, refine
from lf_flame.simulation.planning.effects import EFFECTS, MATTER, RAYS
from lf_flame.simulation.planning.plan import (
    LEFT_OUT_SHARE,
    EffectPlan,
    PlannedEffect,
    is_stated,
    typical_bounds,
)
from lf_flame.simulation.planning.scene_bounds import SceneBounds, bound_scene

TOLERANCE = 1e-3
"""Tolerance of an image without noise, if none is stated."""

OF_NOISE = 0.25
"""Tolerance of a noisy image, if none is stated, in standard deviations of its noise: the error of
all pixels together then grows by a thirtieth at most."""

RAYS_OF_PARTS = 16
"""Largest number of rays along each axis of a part while the number of parts is found."""

MOST = {"slabs": 1024, "colours": 1024, "parts": 32, "rays": 2048}
"""Largest numbers of slabs of a layer, colours, parts of a pixel and rays along each axis."""


def plan_effects(
    scene: Scene,
    camera: PlenopticCamera,
    tolerance: float | None = None,
    effects: Mapping[str, bool] | None = None,
    typical: bool = False,
    *,
    stated: Collection[str] = (),
    rays: int | None = None,
) -> EffectPlan:
    """Decide which optical effects to simulate for a scene, and how finely.

    For each effect, an upper bound is computed on how much the image would change if the effect
    were left out. Effects are left out, smallest bound first, while the sum of their bounds is
    within a quarter of the tolerance; the others are kept. Some hundred pixels are then rendered
    with ever more slabs, colours, parts of pixels and rays, until they change by less than the rest
    of the tolerance.

    Parameters
    ----------
    scene : Scene
        Scene to render.
    camera : PlenopticCamera
        Camera that records it.
    tolerance : float, optional
        Largest acceptable error of the image: root mean square, relative to its brightest pixel.
        Default: 1e-3, or a quarter of the noise of the camera's sensor, if that is more.
    effects : mapping of str to bool, optional
        Effects to simulate (True) or to leave out (False) regardless of their bounds, by name
        (`lf_flame.simulation.planning.effects.EFFECTS`).
    typical : bool, optional
        Whether also to estimate the effects whose causes the camera does not state, such as noise
        without a sensor, at typical values; see `EffectPlan.typical`.
    stated : collection of str, optional
        Names of fields of the camera that were set on purpose, although to the default value;
        effects that they cause are not among the typical ones.
    rays : int, optional
        Number of rays of a pixel along each axis that is given. Default: found by the tolerance.

    Returns
    -------
    EffectPlan
        Effects that are kept and left out, with bounds and reasons; `print` shows it as a table.

    Raises
    ------
    InputError
        If the tolerance is not above 0, an effect is unknown, or the tolerance would need too many
        slabs, colours, parts of pixels or rays.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import PAPER_CAMERA, Layer, Scene, plan_effects
    >>> scene = Scene([Layer(np.ones((8, 8)), depth_mm=10.0, size_mm=(4.0, 4.0))])
    >>> sorted(plan_effects(scene, PAPER_CAMERA).kept)
    ['defocus']
    """
    forced = dict(effects or {})
    _check_request(tolerance, forced)
    bounds = bound_scene(scene, camera)
    noise = OF_NOISE * _noise(bounds, forced)
    by_noise = tolerance is None and noise > TOLERANCE
    if tolerance is None:
        tolerance = max(noise, TOLERANCE)
    bounds, planned = _decide(bounds, forced, LEFT_OUT_SHARE * tolerance, stated)
    kept = {effect.name for effect in planned if effect.kept}
    traced = _traced(bounds, {one.name for one in planned if one.kept and one.bound > 0})
    counts = find_counts(bounds.pixels, kept, traced, tolerance, rays)
    options = {"slabs": counts.slabs, "colours": counts.colours, "rays": counts.rays}
    seconds = counts.parts**2 * bounds.pixels.time(kept=kept, traced=traced, **options)
    return EffectPlan(
        tolerance, planned, traced=traced, **counts._asdict(), seconds=seconds,
        tolerance_by_noise=by_noise, typical=typical_bounds(bounds, stated) if typical else {},
    )  # fmt: skip


class Counts(NamedTuple):
    """Numbers into which a scene is divided: fields of an `EffectPlan`."""

    slabs: tuple[int, ...]
    colours: int
    parts: int
    rays: int | None


def find_counts(
    pixels: ChosenPixels,
    kept: Collection[str],
    traced: Collection[str],
    tolerance: float,
    rays: int | None = None,
    by_rays: bool = False,
) -> Counts:
    """Find the numbers of slabs, colours, parts of pixels and rays that a tolerance needs.

    rays: number that is given; parts of pixels are then not counted either. by_rays: whether rays
    are traced although no effect needs them.
    """
    layers = pixels.scene.layers
    thick = [k for k, layer in enumerate(layers) if layer.depth_extent_mm and "thickness" in kept]
    diffracts = "lenslet_diffraction" in kept and pixels.camera.wavelength_nm is not None
    chromatic, counted = "chromatic" in kept, rays is None and (bool(traced) or by_rays)
    diffracts = diffracts and rays is None
    number = len(thick) + chromatic + diffracts + counted
    share = (1 - LEFT_OUT_SHARE) * tolerance / max(number, 1)
    slabs, colours, parts, few = [1] * len(layers), 1, 1, rays
    weights = pixels.weights

    def image(**options: Any) -> np.ndarray:
        given: dict[str, Any] = {"slabs": slabs, "colours": colours, "rays": few} | options
        return pixels.render(kept, traced, **given)

    def count_rays(first: int) -> int:
        return refine(lambda n: image(rays=n), first, MOST["rays"], share, "rays", weights)

    if counted:
        few = count_rays(FEWEST_RAYS)
    for k in thick:

        def sliced(n: int, k: int = k) -> np.ndarray:
            return image(slabs=[*slabs[:k], n, *slabs[k + 1 :]])

        slabs[k] = refine(sliced, 1, MOST["slabs"], share, "slabs", weights)
    if chromatic:
        many = MOST["colours"]
        colours = refine(lambda n: image(colours=n), 1, many, share, "colours", weights)
    if counted and (thick or chromatic):  # from half of what was enough without them
        few = count_rays(max((few or 1) // 2, FEWEST_RAYS))
    if diffracts:

        def diffracted(n: int) -> np.ndarray:
            some = few and min(max(math.ceil(few / n), FEWEST_RAYS), RAYS_OF_PARTS)
            return pixels.diffracted(kept, traced, n, some)

        parts = refine(diffracted, 1, MOST["parts"], share, "parts of pixels")
        few = few and max(math.ceil(few / parts), FEWEST_RAYS)
    return Counts(tuple(slabs), colours, parts, few)


def _noise(bounds: SceneBounds, forced: Mapping[str, bool]) -> float:
    """Find the noise of the brightest pixel: standard deviation, relative to it."""
    sensor = bounds.camera.sensor
    if sensor is None or not bounds.peak > 0:
        return 0.0
    electrons = bounds.peak * sensor.exposure_e
    shot = math.sqrt(electrons) if forced.get("shot_noise", True) else 0.0
    read = sensor.read_noise_e if forced.get("read_noise", True) else 0.0
    return math.hypot(shot, read) / electrons


def _decide(
    bounds: SceneBounds, forced: dict[str, bool], allowance: float, stated: Collection[str]
) -> tuple[SceneBounds, tuple[PlannedEffect, ...]]:
    """Decide on all effects; also gives the bounds as the decision on defocus leaves them."""
    # Where defocus may be left out, the blur that softens other changes may be missing.
    defocus = EFFECTS["defocus"](bounds).bound
    bounds = replace(bounds, defocus=forced.get("defocus", defocus > allowance))
    estimates = {name: find(bounds) for name, find in EFFECTS.items()}
    kept = _choose({name: found.bound for name, found in estimates.items()}, forced, allowance)
    planned = tuple(
        PlannedEffect(
            name, found.bound, name in kept, name in forced, found.criterion,
            stated=is_stated(bounds.camera, name, stated) or found.bound > 0,
        )
        for name, found in estimates.items()
    )  # fmt: skip
    return bounds, planned


def _check_request(tolerance: float | None, forced: Mapping[str, bool]) -> None:
    """Refuse a tolerance that is not above 0, and effects that are unknown or no booleans."""
    if tolerance is not None and not (tolerance > 0 and math.isfinite(tolerance)):
        raise InputError(f"tolerance must be above 0, got {tolerance}.")
    unknown = [repr(name) for name in forced if name not in EFFECTS]
    if unknown:
        raise InputError(
            f"Unknown effect {', '.join(unknown)}; the known ones are {', '.join(EFFECTS)}."
        )
    for name, value in forced.items():
        if not isinstance(value, bool | np.bool_):
            raise InputError(f"Effect {name} must be forced by True or False, got {value!r}.")


def _choose(changes: dict[str, float], forced: dict[str, bool], allowance: float) -> set[str]:
    """Leave out effects, smallest bound first, while their sum is small enough; keep the rest."""
    kept = {name for name, on in forced.items() if on}
    used = 0.0
    for name in sorted((name for name in changes if name not in forced), key=changes.__getitem__):
        used += changes[name]
        if used > allowance:
            kept.add(name)
    if "f_number_mismatch" in kept:  # one round stop causes both effects
        if forced.get("round_aperture", True):
            kept.add("round_aperture")
        elif "f_number_mismatch" not in forced:
            kept.remove("f_number_mismatch")
        else:
            raise InputError(
                "f_number_mismatch cannot be forced on with round_aperture forced off: "
                "both are one round stop."
            )
    return kept


def _traced(bounds: SceneBounds, kept: Collection[str]) -> tuple[str, ...]:
    """Kept effects that treat the rays of one pixel's bundle differently."""
    # A flat layer that absorbs, with nothing behind it, only becomes darker.
    alone = all(
        not layer.depth_extent_mm and not bounds.behind[layer]
        for layer in bounds.layers
        if layer.optical_thickness.any()
    )
    return tuple(
        name
        for name in (*MATTER, *RAYS)
        if name in kept and not (name == "self_absorption" and alone)
    )
