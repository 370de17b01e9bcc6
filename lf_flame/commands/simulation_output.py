"""From a scene to the files of `lf-flame simulate`."""

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from lf_flame._common import figures, progress
from lf_flame._common.atomic_files import write_text
from lf_flame._common.config import to_json
from lf_flame._common.output_folders import OutputFolder, output_folder
from lf_flame.commands.options import tell
from lf_flame.formats import write_focal_stack
from lf_flame.formats.images import to_preview, white_level, write_image
from lf_flame.lightfield import LightField
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.refocus import shift_and_sum
from lf_flame.scenes.scene import Scene
from lf_flame.simulation.planning.decisions import plan_effects
from lf_flame.simulation.rendering import render_plan

LONG_S = 600
"""Time in seconds beyond which a simulation is announced."""

PER_SIDE = 5
"""Largest number of views along each axis of a sheet."""


def simulate(
    scene: Scene,
    camera: PlenopticCamera,
    out: Path,
    *,
    tolerance: float | None,
    effects: Mapping[str, bool],
    stated: Collection[str],
    integrator: str,
    seed: int,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Render a scene, refocus it at the depth of each layer, and write everything.

    Parameters
    ----------
    scene : Scene
    camera : PlenopticCamera
    out : Path
        Folder for ``raw.tif`` and ``raw.png`` (lenslet image), ``views.png`` (sheet of
        sub-aperture views), ``refocused.tif`` (stack) and ``refocused_N_DEPTHmm.png``,
        ``light_field.npz`` (arrays), ``plan.txt`` (the effect plan) and ``simulation.json``
        (the record).
    tolerance, effects, stated
        As in `lf_flame.plan_effects`.
    integrator, seed
        As in `lf_flame.render`.
    overwrite : bool, optional
        Whether to replace the folder of an earlier call.

    Returns
    -------
    dict
        Record of the scene and its image.
    """
    with output_folder(out, "simulation.json", overwrite=overwrite) as folder:
        with progress.stage("Looking which effects the scene calls for"):
            plan = plan_effects(scene, camera, tolerance, effects, stated=stated)
        if plan.seconds > LONG_S:
            tell(
                f"This takes about {plan.seconds / 60:.0f} minutes; a larger --tolerance than "
                f"{plan.tolerance:.2g} takes less."
            )
        light_field = render_plan(scene, camera, plan, integrator, seed=seed)
        _write(light_field, scene, camera, folder)
        folder.facts |= {"seed": seed}
    return folder.facts


def _write(
    light_field: LightField, scene: Scene, camera: PlenopticCamera, out: OutputFolder
) -> None:
    depths = np.array(scene.depths_mm)
    slopes = camera.depth_to_slope(depths)
    stack = shift_and_sum(light_field, slopes)
    white = white_level(light_field.views)
    _write_images(light_field, stack, slopes, depths, white, out)
    arrays: dict[str, Any] = {
        "views": light_field.views, "refocused": stack, "slopes": slopes, "depths_mm": depths
    }  # fmt: skip
    if light_field.weights is not None:
        arrays["weights"] = light_field.weights
    np.savez_compressed(out.path("light_field.npz"), **arrays)
    write_text(out.path("plan.txt"), f"{light_field.plan}\n")
    out.facts |= {
        "camera": to_json(camera),
        "depths_mm": depths.tolist(),
        "slopes": slopes.tolist(),
        "radiance_of_white_in_png": white,
        "plan": light_field.plan.to_json(),
    }


def _write_images(
    light_field: LightField,
    stack: np.ndarray,
    slopes: np.ndarray,
    depths: np.ndarray,
    white: float,
    out: OutputFolder,
) -> None:
    raw = light_field.to_raw()
    write_image(out.path("raw.tif"), raw)
    write_image(out.path("raw.png"), to_preview(raw, white), linear=True)
    write_focal_stack(stack, slopes, out.path("refocused.tif"))
    for number, (depth, image) in enumerate(zip(depths, stack, strict=True), 1):
        write_image(out.path(f"refocused_{number}_{depth:+g}mm.png"), to_preview(image, white))
    figures.save(_view_sheet(light_field.views), out.path("views.png"))


def _view_sheet(views: np.ndarray) -> Figure:
    """Draw sub-aperture views, shape (v, u, t, s), spread evenly over the aperture."""
    rows, columns = (
        np.unique(np.linspace(0, n - 1, min(n, PER_SIDE)).round().astype(int))
        for n in views.shape[:2]
    )
    height, width = views.shape[2:]
    aspect = np.clip(height / width, 0.1, 10)  # a line of lenslets would make an endless sheet
    figure, axes = figures.subplots(
        len(rows),
        len(columns),
        figsize=(2 * len(columns), 2 * len(rows) * aspect + 0.8),
        squeeze=False,
        layout="constrained",
    )
    for v, line in zip(rows, axes, strict=True):
        for u, axis in zip(columns, line, strict=True):
            axis.imshow(views[v, u], cmap="gray", vmin=0, vmax=max(views.max(), 1e-9))
            axis.set_title(f"v = {v}, u = {u}", fontsize=7, pad=2)
            axis.axis("off")
    figure.suptitle("Sub-aperture views", fontsize=10)
    return figure
